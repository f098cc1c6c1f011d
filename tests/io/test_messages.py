"""From nouns to messages: units, half pixels, stamps; what is None stays unset."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from hypothesis import given
from hypothesis import strategies as st
from recording_data import MARKERS, START_NS, estimate, result, stamp

from spheremcap.core.camera import Camera
from spheremcap.core.estimate import MarkerEstimate, Status
from spheremcap.io import _pb, messages
from spheremcap.io.recording import _Numbers, state_row
from spheremcap.io.topics import Topics

REPO = Path(__file__).parents[2]


def test_committed_descriptors_are_what_protoc_makes_of_the_proto_files():
    spec = importlib.util.spec_from_file_location("generate", REPO / "proto/generate.py")
    generate = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(generate)
    assert FileDescriptorSet.FromString(generate.compiled()) == _pb.DESCRIPTORS


@given(st.integers(0, 2**63 - 1))
def test_stamps_go_through_protobuf_exactly(stamp_ns):
    assert messages.stamp_of(messages.timestamp(stamp_ns)) == stamp_ns


def test_what_is_none_stays_unset():
    bare = messages.state(MarkerEstimate("a", 0, START_NS, Status.LOST), None, "camera_optical")
    assert {field.name for field, _ in bare.ListFields()} == {"timestamp", "marker", "status", "frame_id"}
    votes = messages.votes(MarkerEstimate("a", 0, START_NS, Status.LOST))
    assert {field.name for field, _ in votes.ListFields()} == {"timestamp", "marker"}
    assert not _pb.ImuSample(frame_id="x").HasField("saturated")
    assert _pb.WheelSample(force_n={"x": 0.0}).force_n.HasField("x")
    assert not _pb.WheelSample(force_n={"x": 0.0}).force_n.HasField("y")


@pytest.mark.parametrize("status", list(Status))
def test_a_state_comes_back_as_it_went_in(status):
    frame = result(3, [status])
    (given_,) = frame.estimates
    smoothed = frame.smoothed[0] if frame.smoothed else None
    row = state_row(messages.state(given_, smoothed, "camera_optical").SerializeToString(), stamp(3))
    assert (row.marker, row.frame_index, row.status) == ("left_wrist", 3, status.value)
    assert row.verdict == (given_.verdict.value if given_.verdict else "")
    assert row.reasons == ";".join(given_.reasons)
    numbers = np.array(row.numbers)
    for name in ("xyz_cam_m", "covariance_m2", "velocity_cam_mps"):
        for prefix, source in (("", given_), ("smoothed_", smoothed)):
            got = numbers[getattr(_Numbers, prefix + name)]
            value = None if source is None else getattr(source, name)
            np.testing.assert_array_equal(got, np.full(got.shape, np.nan) if value is None else value.ravel())
    assert np.isnan(row.numbers[_Numbers.vote_sum]) == (given_.vote_sum is None)


@pytest.mark.parametrize(("number", "status"), [(1, "SEEDED"), (2, "VERIFIED"), (3, "ESTIMATED"), (4, "LOST")])
def test_states_of_before_viewers_coloured_them_are_still_read(number, status):
    assert state_row(_pb.MarkerState(marker="a", status=number).SerializeToString(), 0).status == status


def test_votes_hold_all_six_and_the_best():
    of = estimate("a", 2, Status.ESTIMATED)
    message = messages.votes(of)
    assert [v.matcher for v in message.votes] == [v.matcher for v in of.votes]
    assert (message.best, message.best_overlap, message.any_agrees) == ("ccorr", 0.98, True)
    assert message.sum == of.vote_sum
    assert _pb.MarkerVotes.Verdict.Name(message.verdict) == "DOUBTFUL"


@pytest.mark.parametrize(
    ("model", "given_", "name", "expected"),
    [
        ("none", (), "plumb_bob", [0.0] * 5),
        ("plumb_bob", (0.1, 0.2, 0.3, 0.4), "plumb_bob", [0.1, 0.2, 0.3, 0.4, 0.0]),
        ("plumb_bob", tuple(range(8)), "rational_polynomial", list(range(8))),
        ("fisheye", (0.1, 0.2, 0.3, 0.4), "kannala_brandt", [0.1, 0.2, 0.3, 0.4]),
    ],
)
def test_calibration_speaks_ros(model, given_, name, expected):
    camera = Camera(160, 120, 150.0, 151.0, 79.5, 59.5, model, given_)
    message = messages.calibration(START_NS, camera, "camera_optical")
    assert message.distortion_model == name
    assert list(message.D) == expected
    assert list(message.K) == [150, 0, 79.5, 0, 151, 59.5, 0, 0, 1]
    assert (len(message.R), len(message.P)) == (9, 12)


def test_the_optical_frame_looks_along_the_cameras_x_axis():
    rotation = messages.transforms(START_NS, Topics().edges()).transforms[1].rotation
    v, w = np.array([rotation.x, rotation.y, rotation.z]), rotation.w

    def turned(p):
        return p + 2 * np.cross(v, np.cross(v, p) + w * p)

    np.testing.assert_allclose(turned(np.array([0, 0, 1.0])), [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(turned(np.array([1.0, 0, 0])), [0, -1, 0], atol=1e-12)
    np.testing.assert_allclose(turned(np.array([0, 1.0, 0])), [0, 0, -1], atol=1e-12)


def test_the_scene_has_spheres_of_true_size_and_pale_estimates():
    trail = [[messages.point(np.zeros(3))], [messages.point(np.full(3, k)) for k in (0.0, 1.0)]]
    solid = messages.scene_entity(estimate("left_wrist", 1, Status.VERIFIED), MARKERS[0], 0, trail, "camera_optical")
    pale = messages.scene_entity(estimate("left_wrist", 1, Status.ESTIMATED), MARKERS[0], 0, [], "camera_optical")
    assert solid.spheres[0].size.x == 0.04
    assert solid.id == "left_wrist"
    assert [len(line.points) for line in solid.lines] == [2]
    assert 0 < pale.spheres[0].color.a < solid.spheres[0].color.a
    assert messages.scene_entity(estimate("a", 1, Status.LOST), MARKERS[0], 0, [], "camera_optical") is None
