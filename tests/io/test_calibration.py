"""One reading of calibrations: messages of every kind and YAML say the same camera, or the same error."""

import math
from pathlib import Path
from typing import Any

import pytest
import yaml
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import Writer
from mcap_protobuf.schema import build_file_descriptor_set

from clips import write_recording
from spheremcap.core.camera import Camera
from spheremcap.errors import SettingsError, SourceError
from spheremcap.io import recording
from spheremcap.io.calibration import camera_of, fields_of, focal_sd_of, read_camera_info, write_camera_info
from spheremcap.io.mcap_images import McapImageSource

K = [550.0, 0, 159.5, 0, 551.0, 119.5, 0, 0, 1]
GOOD: dict[str, tuple[str, list[float], str, tuple[float, ...]]] = {
    "no distortion": ("plumb_bob", [0.0] * 5, "none", ()),
    "none said": ("", [], "none", ()),
    "no name": ("", [0.1, 0.2, 0, 0, 0], "plumb_bob", (0.1, 0.2, 0, 0)),
    "two": ("plumb_bob", [0.1, 0.2], "plumb_bob", (0.1, 0.2, 0, 0)),
    "three": ("plumb_bob", [0.1, 0.2, 0.3], "plumb_bob", (0.1, 0.2, 0.3, 0)),
    "five": ("plumb_bob", [0.1, 0.2, 0, 0, 0.3], "plumb_bob", (0.1, 0.2, 0, 0, 0.3)),
    "six": ("rational_polynomial", [0.1, 0.2, 0, 0, 0.3, 0.4], "plumb_bob", (0.1, 0.2, 0, 0, 0.3, 0.4, 0, 0)),
    "eight": ("rational_polynomial", [0.1] * 8, "plumb_bob", (0.1,) * 8),
    "fourteen, six of them zero": ("rational_polynomial", [0.1] * 8 + [0] * 6, "plumb_bob", (0.1,) * 8),
    "fisheye": ("equidistant", [0.1, 0.2, 0.3, 0.4], "fisheye", (0.1, 0.2, 0.3, 0.4)),
    "fisheye by another name": ("kannala_brandt", [0.1], "fisheye", (0.1, 0, 0, 0)),
}
BAD: dict[str, tuple[dict[str, Any], str]] = {
    "unknown model": ({"distortion_model": "omni", "D": [0.1]}, "'omni' is not supported"),
    "nine": ({"D": [0.1] * 9}, "9 coefficients"),
    "five of a fisheye": ({"distortion_model": "fisheye", "D": [0.1] * 5}, "5 coefficients"),
    "nan": ({"D": [math.nan, 0, 0, 0]}, "distortion coefficients"),
    "inf": ({"K": [math.inf, *K[1:]]}, "focal lengths"),
    "negative": ({"K": [-550, *K[1:]]}, "focal lengths"),
    "far away": ({"K": [550, 0, 1e9, *K[3:]]}, "principal point"),
    "eight numbers": ({"K": K[:8]}, "8 numbers"),
}


def message(**changes: Any) -> CameraCalibration:
    fields = {"width": 320, "height": 240, "K": K, "D": [], "distortion_model": "plumb_bob"} | changes
    return CameraCalibration(**fields)


def by_topic(folder: Path, given_: CameraCalibration, metadata: dict[str, str] | None = None) -> Path:
    """A recording with pictures, and this calibration beside them."""
    path = folder / "a.mcap"
    pictures = write_recording(folder / "b.mcap", ["/front/image"], calibrated=False)
    from spheremcap.io.mcap_records import McapRecords

    with path.open("wb") as file, McapRecords(pictures) as records:
        writer = Writer(file)
        writer.start()
        data = build_file_descriptor_set(CameraCalibration).SerializeToString()
        schema = writer.register_schema("foxglove.CameraCalibration", "protobuf", data)
        channel = writer.register_channel("/front/calibration", "protobuf", schema, metadata or {})
        writer.add_message(channel, 1, given_.SerializeToString(), 1)
        for raw in records.messages({"/front/image"}):
            own = records.schemas[raw.channel.schema_id]
            schema = writer.register_schema(own.name, own.encoding, own.data) if raw.sequence == 0 else schema
            channel = writer.register_channel("/front/image", "protobuf", schema) if raw.sequence == 0 else channel
            writer.add_message(channel, raw.log_time, raw.data, raw.publish_time, raw.sequence)
        writer.finish()
    return path


def by_yaml(folder: Path, given_: CameraCalibration, **more: float) -> Path:
    path = folder / "camera.yaml"
    data = {
        "image_width": given_.width, "image_height": given_.height, "camera_matrix": {"data": list(given_.K)},
        "distortion_coefficients": {"data": list(given_.D)}, "distortion_model": given_.distortion_model, **more,
    }  # fmt: skip
    path.write_text(yaml.safe_dump(data))
    return path


@pytest.mark.parametrize("name", GOOD)
def test_all_three_readers_give_the_same_camera(tmp_path: Path, name: str) -> None:
    model, d, camera_model, coefficients = GOOD[name]
    given_ = message(distortion_model=model, D=d)
    with McapImageSource(by_topic(tmp_path, given_)) as source:
        beside = source.calibration
    back, file = recording.open(tmp_path / "a.mcap").camera, read_camera_info(by_yaml(tmp_path, given_))
    for camera in (beside, back, file):
        assert camera is not None
        assert (camera.model, camera.distortion) == (camera_model, coefficients)
        assert (camera.width_px, camera.height_px, camera.fx_px, camera.fy_px) == (320, 240, 550, 551)
        assert (camera.cx_px, camera.cy_px, camera.focal_sd) == (159.5, 119.5, 0)


@pytest.mark.parametrize("name", BAD)
def test_all_three_readers_refuse_the_same_in_the_same_words(tmp_path: Path, name: str) -> None:
    changes, words = BAD[name]
    given_ = message(**changes)
    with McapImageSource(by_topic(tmp_path, given_)) as source, pytest.raises(SourceError, match=words):
        assert source.calibration
    opened = recording.open(tmp_path / "a.mcap")
    assert opened.camera is None
    assert words in str(opened.damage)
    with pytest.raises(SettingsError, match=words):
        read_camera_info(by_yaml(tmp_path, given_))


def test_the_focal_lengths_uncertainty_is_kept_by_all_three(tmp_path: Path) -> None:
    with McapImageSource(by_topic(tmp_path, message(), {"focal_sd": "0.03"})) as source:
        assert source.calibration is not None
        assert source.calibration.focal_sd == 0.03
    opened = recording.open(tmp_path / "a.mcap").camera
    assert opened is not None
    assert opened.focal_sd == 0.03
    assert read_camera_info(by_yaml(tmp_path, message(), focal_sd=0.03)).focal_sd == 0.03
    assert focal_sd_of({}) == 0
    with pytest.raises(ValueError, match="float"):
        focal_sd_of({"focal_sd": "small"})


def test_not_calibrated_is_no_camera_and_a_rectified_picture_has_its_own() -> None:
    assert camera_of({"width": 320, "height": 240, "k": [0.0] * 9}, "x") is None
    assert camera_of({"width": 0, "height": 240, "k": K}, "x") is None
    p = [500.0, 0, 160, 0, 0, 501, 120, 0, 0, 0, 1, 0]
    fields = {"width": 320, "height": 240, "k": K, "d": [0.1] * 5, "p": p}
    rectified = camera_of(fields, "x", rectified=True)
    assert rectified is not None
    assert (rectified.fx_px, rectified.fy_px, rectified.cx_px, rectified.model) == (500, 501, 160, "none")


coefficients = st.floats(-1, 1).map(lambda k: round(k, 3))


@given(
    st.one_of(
        st.tuples(st.just("plumb_bob"), st.sampled_from([4, 5, 8]).flatmap(lambda n: st.tuples(*[coefficients] * n))),
        st.tuples(st.just("fisheye"), st.tuples(*[coefficients] * 4)),
        st.just(("none", ())),
    ),
    st.floats(10, 5000),
)
def test_a_camera_written_is_the_camera_read(lens: tuple[Any, tuple[float, ...]], focal_px: float) -> None:
    camera = Camera(320, 240, focal_px, focal_px + 1, 159.5, 119.5, *lens)
    written = {name.lower(): value for name, value in fields_of(camera).items()}
    read = camera_of(written, "x")
    assert read is not None
    padded = [tuple(c.distortion) + (0.0,) * (8 - len(c.distortion)) for c in (camera, read)]
    assert padded[0] == padded[1]
    assert read.model == camera.model or not any(camera.distortion)
    assert (read.fx_px, read.fy_px, read.cx_px) == (camera.fx_px, camera.fy_px, camera.cx_px)


@pytest.mark.parametrize(
    ("model", "lens"),
    [("none", ()), ("plumb_bob", (0.1, 0.2, 0.01, 0.02)), ("plumb_bob", (0.1,) * 8), ("fisheye", (0.1, 0.2, 0.3, 0.4))],
)
def test_a_yaml_written_is_the_camera_read(tmp_path: Path, model: Any, lens: tuple[float, ...]) -> None:
    camera = Camera(320, 240, 550.123456789, 551, 159.5, 119.5, model, lens, 0.0123, "camera.yaml")
    write_camera_info(tmp_path / "camera.yaml", camera)
    assert read_camera_info(tmp_path / "camera.yaml") == camera
