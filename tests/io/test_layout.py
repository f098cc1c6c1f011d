"""A recording's layout: of its own topics, as the viewers' types want it, nothing that is not there."""

import json
import re

import cv2
import numpy as np
import pytest
from panel_types import COLOUR, check_layout
from recording_data import CAMERA, MARKERS, PERIOD_NS, START_NS, h264_pictures, result

from spheremcap.core.estimate import Status
from spheremcap.core.frame import EncodedPicture
from spheremcap.errors import UsageError
from spheremcap.io.contents import contents
from spheremcap.io.layout import layout, layout_path, write_layout
from spheremcap.io.mcap_log import McapLog, RunInfo
from spheremcap.io.messages import MARKER_RGB
from spheremcap.io.topics import Topics
from spheremcap.merging.dataset import Source, merge


def pictures(count, kind):
    if kind == "h264":
        return h264_pictures(count)
    data = cv2.imencode(".jpg", np.zeros((120, 160, 3), np.uint8))[1].tobytes()
    return [EncodedPicture(data, "jpeg", True)] * count


def write(path, *, camera=CAMERA, topics=None, kind="h264", count=12, views=True, markers=MARKERS):
    run = RunInfo(more=(topics or Topics()).facts() | {"name": (topics or Topics()).root})
    with McapLog(path, camera=camera, markers=markers, run=run, topics=topics, picture_px=(160, 120)) as log:
        log.log("INFO", "a line", START_NS)
        for index, picture in zip(range(count), pictures(count, kind), strict=True):
            log.write(result(index, view=views and index == 0), picture)
    return path


def panels(found, kind):
    return {name: panel for name, panel in found["configById"].items() if name.startswith(f"{kind}!")}


HEAD = ",".join(
    ["Time (s)", *(f"Accelerometer {axis} (m/s^2)" for axis in "XYZ"), *(f"Gyroscope {axis} (rad/s)" for axis in "XYZ")]
)


@pytest.fixture(scope="module")
def imu(tmp_path_factory):
    path = tmp_path_factory.mktemp("imu") / "imu.csv"
    rows = [f"{(START_NS + k * 5_000_000) / 1e9:.6f},0.1,{k},9.8,0.01,0.02,0.03" for k in range(20)]
    path.write_text(HEAD + "\n" + "\n".join(rows) + "\n")
    return path


def test_a_recording_shows_all_that_it_has_and_nothing_else(tmp_path):
    path = write(tmp_path / "a.mcap")
    found = layout(contents(path))
    check_layout(found)
    (picture,) = [p for n, p in panels(found, "Image").items() if "picture" in n]
    assert picture["imageMode"] == {
        "imageTopic": "/camera/video", "synchronize": False, "calibrationTopic": "/camera/calibration",
        "annotations": {"/camera/annotations": {"visible": True}},
    }  # fmt: skip
    assert picture["topics"]["/scene"] == {"visible": False}
    (space,) = panels(found, "3D").values()
    assert space["followTf"] == "world"
    # Positions are z = 1.5 m before the camera: x = 1.5 in the world, where x is forward.
    np.testing.assert_allclose(space["cameraState"]["targetOffset"][0], 1.5)
    assert space["topics"]["/scene"]["visible"]
    topics = contents(path).topics
    for plot in panels(found, "Plot").values():
        for line in plot["paths"]:
            assert re.fullmatch(COLOUR, line["color"])
            topic = re.split(r"[.{]", line["value"])[0]
            assert topic in topics or line["value"] in ("3", "4")
    assert "RawMessages!requests" in found["configById"]  # the first marker is LOST once


def test_one_colour_a_marker_and_one_an_axis(tmp_path):
    found = layout(contents(write(tmp_path / "a.mcap")))
    names = [marker.name for marker in MARKERS]
    votes = found["configById"]["Plot!votes"]["paths"]
    assert [line["label"] for line in votes] == [*names, "accepted", "rejected"]
    assert [line["value"] for line in votes[2:]] == ["4", "3"]
    own = ["#" + "".join(f"{round(255 * c):02x}" for c in MARKER_RGB[number]) for number in range(2)]
    assert [line["color"] for line in votes[:2]] == own
    assert [path["color"] for path in found["configById"]["StateTransitions!status"]["paths"]] == own
    lines = found["configById"]["Plot!position_left_wrist"]["paths"]
    assert [line["label"] for line in lines] == [f"{a} {name}" for name in ("measured", "smoothed") for a in "xyz"]
    assert len({line["color"] for line in lines}) == 6
    assert not any(line["showLine"] for line in lines)  # no line across what was not measured


def test_colours_go_by_the_order_in_which_the_run_lists_its_markers(tmp_path):
    (camera,) = contents(write(tmp_path / "a.mcap")).cameras
    assert camera.markers == tuple(marker.name for marker in MARKERS) != tuple(sorted(m.name for m in MARKERS))


def test_without_a_camera_there_are_pixels_and_no_space(tmp_path):
    bare = [[Status.VERIFIED]] * 6
    path = tmp_path / "bare.mcap"
    with McapLog(path, camera=None, markers=MARKERS[:1], picture_px=(160, 120)) as log:
        for index, picture in zip(range(6), pictures(6, "jpeg"), strict=True):
            full = result(index, bare[index])
            log.write(_without_metres(full), picture)
    found = layout(contents(path))
    check_layout(found)
    assert not panels(found, "3D")
    (picture,) = panels(found, "Image").values()
    assert picture["imageMode"]["imageTopic"] == "/camera/image"
    assert "calibrationTopic" not in picture["imageMode"]
    values = [line["value"] for line in found["configById"]["Plot!position_left_wrist"]["paths"]]
    assert values[0] == "/markers/left_wrist/state{status==31}.circle.x_px"
    assert values[3] == "/markers/left_wrist/state.circle.x_px"


def test_several_cameras_and_sensors_each_have_their_panels(tmp_path, imu):
    first = write(tmp_path / "first.mcap")
    second = write(tmp_path / "second.mcap", kind="jpeg")
    out = tmp_path / "all.mcap"
    merge([Source(first), Source(second, prefix="/right"), Source(imu)], out)
    found = layout(contents(out))
    check_layout(found)
    shown = {p["imageMode"]["imageTopic"] for n, p in panels(found, "Image").items() if n.endswith("picture")}
    assert shown == {"/camera/video", "/right/camera/image"}
    assert len(panels(found, "3D")) == 2
    assert [path["label"] for path in found["configById"]["StateTransitions!status"]["paths"]] == [
        f"{camera}/{marker.name}" for camera in ("camera", "right/camera") for marker in MARKERS
    ]
    lines = found["configById"]["Plot!sensor_imu"]["paths"]
    assert [line["value"] for line in lines if line["enabled"]] == [
        f"/sensors/imu.angular_velocity.{axis}" for axis in "xyz"
    ]
    assert "x linear_acceleration" in [line["label"] for line in lines]  # not ticked: it has another unit


def test_the_layout_of_240_pictures_a_second_is_slow(tmp_path):
    path = write(tmp_path / "a.mcap")
    assert contents(path).rate_hz == pytest.approx(1e9 / PERIOD_NS)
    assert layout(contents(path))["playbackConfig"] == {"speed": 0.25}


def test_it_is_written_whole_beside_and_never_over_something(tmp_path):
    path = write(tmp_path / "session.mcap")
    assert layout_path(path).name == "session.layout.json"
    write_layout(path, layout_path(path))
    text = layout_path(path).read_text()
    check_layout(json.loads(text))
    with pytest.raises(UsageError, match="exists already"):
        write_layout(path, layout_path(path))
    write_layout(path, layout_path(path), overwrite=True)
    assert layout_path(path).read_text() == text


def test_a_recording_of_nothing_that_we_show_says_so(tmp_path, imu):
    from mcap.writer import Writer

    path = tmp_path / "other.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/chat", "json", 0)
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
    with pytest.raises(UsageError, match="nothing in it that a layout could show"):
        write_layout(path, tmp_path / "x.json")
    assert not (tmp_path / "x.json").exists()


def test_numbers_are_looked_for_in_protobuf_alone(tmp_path):
    """A topic of somebody else's under a name that we use, in JSON."""
    from mcap.writer import Writer

    path = tmp_path / "other.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.add_message(writer.register_channel("/sync/wheel", "json", 0), 1, b'{"residual_m": 1.5}', 1)
        writer.finish()
    (found,) = contents(path).residuals
    assert (found.topic, found.numbers) == ("/sync/wheel", ())


def _without_metres(frame):
    from dataclasses import replace

    bare = tuple(
        replace(e, xyz_cam_m=None, covariance_m2=None, velocity_cam_mps=None) for e in frame.estimates
    )  # fmt: skip
    return replace(frame, estimates=bare, smoothed=())
