"""GoPro telemetry: any bytes in, samples or nothing out."""

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_sensors import gopro_file, klv

from spheremcap.errors import SpheremcapError
from spheremcap.merging.makers.gopro import payload_samples
from spheremcap.merging.sensors import read_sensors

KEYS = st.sampled_from(["DEVC", "STRM", "SCAL", "ACCL", "GYRO", "ORIN", "STNM"])
ITEM = st.builds(
    lambda key, kind, size, count, body: key.encode() + struct.pack(">cBH", kind, size, count) + body,
    KEYS,
    st.sampled_from([b"\0", b"s", b"S", b"l", b"f", b"d", b"j", b"c", b"b", b"?"]),
    st.integers(0, 26),
    st.integers(0, 4),
    st.binary(max_size=64),
)
NESTED = st.recursive(
    ITEM,
    lambda inner: st.builds(
        lambda key, items: klv(key, "\0", 1, b"".join(items)), KEYS, st.lists(inner, min_size=1, max_size=4)
    ),
    max_leaves=8,
)


def check(payload: bytes) -> int:
    found = list(payload_samples(payload))
    for quantity, values in found:
        assert quantity in ("linear_acceleration", "angular_velocity")
        assert values.shape[1:] == (3,)
        assert not np.isinf(values).any()
    return len(found)


@settings(max_examples=300, deadline=None)
@given(st.one_of(st.binary(max_size=200), st.lists(NESTED, max_size=3).map(b"".join)))
def test_any_payload_is_samples_or_nothing(payload: bytes) -> None:
    check(payload)


@settings(max_examples=100, deadline=None)
@given(
    scale=st.binary(max_size=8), order=st.binary(max_size=4), raw=st.binary(max_size=36), kind=st.sampled_from("sSlfb")
)
def test_any_scale_order_and_data(scale: bytes, order: bytes, raw: bytes, kind: str) -> None:
    size = {"s": 2, "S": 2, "l": 4, "f": 4, "b": 1}[kind]
    whole = raw[: len(raw) // (3 * size) * 3 * size]
    stream = (
        klv("SCAL", kind, size, scale[: len(scale) // size * size])
        + (klv("ORIN", "c", 1, order) if order else b"")
        + klv("ACCL", kind, 3 * size, whole)
    )
    check(klv("DEVC", "\0", 1, klv("STRM", "\0", 1, stream)))


def test_a_scale_of_zero_or_of_two_numbers_leaves_the_stream_out() -> None:
    raw = klv("ACCL", "s", 6, struct.pack(">3h", 1, 2, 3))
    for scale, count in (((418,), 1), ((1, 2, 4), 1), ((0,), 0), ((1, 2), 0)):
        stream = klv("SCAL", "s", 2, struct.pack(f">{len(scale)}h", *scale)) + raw
        assert check(klv("DEVC", "\0", 1, klv("STRM", "\0", 1, stream))) == count


def test_payloads_that_nest_without_end_are_no_recursion() -> None:
    payload = b""
    for _ in range(8000):
        payload = b"DEVC" + struct.pack(">cBH", b"\0", 8, min((len(payload) + 7) // 8, 65535)) + payload
    assert check(payload) == 0


@settings(max_examples=40, deadline=None)
@given(payloads=st.lists(st.one_of(st.binary(min_size=1, max_size=60), NESTED), min_size=1, max_size=3))
def test_a_file_of_any_payloads(tmp_path_factory: pytest.TempPathFactory, payloads: list[bytes]) -> None:
    path = tmp_path_factory.mktemp("gopro") / "GX01.MP4"
    path.write_bytes(gopro_file(payloads))
    try:
        logs = read_sensors(path)
    except SpheremcapError:
        return
    assert all(len(log) for log in logs)
