"""NAL units: against a walker written to be read, on streams and on noise."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spheremcap.io.annex_b import is_key_picture, units

START = st.sampled_from([b"\0\0\1", b"\0\0\0\1"])
NOISE = st.lists(st.one_of(st.binary(max_size=12), START, st.just(b"\0\0"), st.just(b"\0")), max_size=20).map(b"".join)


def reference(data: bytes, format_: str) -> list[tuple[int, bytes]]:
    """Byte by byte: whatever stands between two start codes, without the zeros at its end."""
    found, at, begun = [], 0, False
    unit = bytearray()
    while at <= len(data):
        if data[at : at + 3] == b"\0\0\1" or at == len(data):
            stripped = bytes(unit).rstrip(b"\0")
            if begun and stripped:
                found.append((stripped[0] & 31 if format_ == "h264" else (stripped[0] >> 1) & 63, stripped))
            unit, begun, at = bytearray(), True, at + 3
        else:
            unit.append(data[at])
            at += 1
    return found


@settings(max_examples=400)
@given(NOISE, st.sampled_from(["h264", "h265"]))
def test_units_are_what_stands_between_start_codes(data: bytes, format_: str) -> None:
    assert list(units(data, format_)) == reference(data, format_)


@settings(max_examples=1000)
@given(NOISE)
def test_a_picture_is_key_by_its_first_slice(data: bytes) -> None:
    kinds = [kind for kind, _ in reference(data, "h264")]
    slices = [kind for kind in kinds if kind in (1, 5)]
    assert is_key_picture(data, "h264") == (slices[:1] == [5])
    kinds = [kind for kind, _ in reference(data, "h265")]
    slices = [kind for kind in kinds if kind <= 21]
    assert is_key_picture(data, "h265") == bool(slices and slices[0] >= 16)


@given(st.binary(max_size=40), st.sampled_from(["h264", "h265", "vp9", "av1"]))
def test_no_bytes_are_too_strange(data: bytes, format_: str) -> None:
    assert is_key_picture(data, format_) in (True, False)


@pytest.mark.parametrize("format_", ["h264", "h265"])
def test_a_unit_without_bytes_is_none(format_: str) -> None:
    assert list(units(b"\0\0\1\0\0\1", format_)) == []
    assert not is_key_picture(b"\0\0\1", format_)
