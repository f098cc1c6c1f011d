"""The layout of a recording that was analysed: both hands' strokes and arms, and the chair."""

from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from panel_types import check_layout
from session_data import START_NS, event, stamp, write_session

from spheremcap.core.stroke import EventKind, Stroke
from spheremcap.io import _pb
from spheremcap.io.contents import contents
from spheremcap.io.layout import layout
from spheremcap.merging.dataset import Source, merge

EDGE = {
    "parent_frame_id": "camera_optical", "child_frame_id": "chair", "translation": {"z": 1.3},
    "rotation": {"x": 0.5, "y": 0.5, "z": -0.5, "w": 0.5},
}  # fmt: skip


def analysed(path, sides=("left", "right")):
    """What is known of an arm changes: the elbow is not seen at first."""
    beside = [
        ("/analysis/chair", START_NS, _pb.ChairFrame(**EDGE, upright=True)),
        ("/analysis/tf", START_NS, FrameTransforms(transforms=[EDGE])),
    ]
    strokes = []
    for side in sides:
        samples = [_pb.ArmSample(speed_mps=3.0, gap_mm=1.0), _pb.ArmSample(speed_mps=3.1, elbow_deg=120.0)]
        if side == "left":
            samples = samples[:1]
        beside += [(f"/analysis/{side}/arm", stamp(k), sample) for k, sample in enumerate(samples)]
        strokes += [event(EventKind.CONTACT, stamp(2), side), event(EventKind.RELEASE, stamp(4), side)]
        strokes.append(Stroke(stamp(2), side, f"{side}_wrist", 0))
    return write_session(path, range(12), strokes=strokes, analysed=beside)


def values(panel):
    return [line["value"] for line in panel["paths"]]


def test_it_has_both_hands_strokes_and_arms_and_the_chair(tmp_path):
    path = analysed(tmp_path / "a.mcap")
    found = layout(contents(path))
    check_layout(found)
    panels = found["configById"]
    assert [(row["value"], row["label"]) for row in panels["StateTransitions!status"]["paths"][:2]] == [
        (f"/analysis/{side}/events.kind", f"{side} hand") for side in ("left", "right")
    ]
    for side in ("left", "right"):
        assert panels[f"Table!{side}/strokes"]["topicPath"] == f"/analysis/{side}/strokes"
    both = [f"/analysis/{side}/arm" for side in ("left", "right")]
    assert values(panels["Plot!arms_speed_mps"]) == [f"{topic}.speed_mps" for topic in both]
    assert values(panels["Plot!arms_gap_mm"]) == [f"{topic}.gap_mm" for topic in both]
    assert values(panels["Plot!arms_elbow_deg"]) == ["/analysis/right/arm.elbow_deg"]  # the left one is never seen
    assert len({line["color"] for line in panels["Plot!arms_speed_mps"]["paths"]}) == 2
    space = panels["3D!space"]
    assert space["transforms"]["frame:chair"] == {"visible": True}
    assert space["followTf"] == "world"
    topics = contents(path).topics
    shown = [panel["topicPath"] for panel in panels.values() if "topicPath" in panel]
    shown += [
        value.rpartition(".")[0] for name in panels if name.startswith("Plot!arms") for value in values(panels[name])
    ]
    assert set(shown) <= topics


def test_contact_and_release_have_the_numbers_that_viewers_colour():
    assert (_pb.StrokeEvent.Kind.Value("CONTACT"), _pb.StrokeEvent.Kind.Value("RELEASE")) == (31, 29)


def test_one_hand_is_shown_alone(tmp_path):
    panels = layout(contents(analysed(tmp_path / "a.mcap", ["left"])))["configById"]
    assert "Table!right/strokes" not in panels
    rows = values(panels["StateTransitions!status"])
    assert [row for row in rows if "analysis" in row] == ["/analysis/left/events.kind"]
    assert "Plot!arms_elbow_deg" not in panels


def test_without_an_analysis_nothing_of_it_is_there(tmp_path):
    path = write_session(tmp_path / "a.mcap", range(12))
    found = contents(path)
    assert (found.hands, [camera.chair for camera in found.cameras]) == ((), [""])
    panels = layout(found)["configById"]
    assert list(panels["3D!space"]["transforms"]) == ["frame:camera_optical_debug"]
    assert not [name for name in panels if "arms" in name or "strokes" in name]


def test_a_prefix_of_a_merge_goes_before_the_hands_names(tmp_path):
    path = analysed(tmp_path / "a.mcap")
    out = tmp_path / "all.mcap"
    merge([Source(path, prefix="/second")], out)
    found = contents(out)
    assert [hand.name for hand in found.hands] == ["second/left", "second/right"]
    assert found.hands[0].events == "/second/analysis/left/events"
    (camera,) = found.cameras
    assert camera.chair.endswith("chair")
    check_layout(layout(found))
