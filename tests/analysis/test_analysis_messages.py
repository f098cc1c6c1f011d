"""What an analysis writes: each hand's messages under its own topics, by time, and the chair where it is."""

from dataclasses import replace

import numpy as np
from test_session_page import session

from spheremcap.analysis.messages import messages_of


def told_of():
    """A session, and what is told of it."""
    found = session()
    arms = {
        side: replace(arm, values={name: arm.values[name] for name in ("speed_mps", "speed_sd_mps")})
        for side, arm in found.arms.items()
    }
    found = replace(found, arms=arms)
    return found, list(messages_of(found, "camera_optical"))


def test_each_hand_has_its_own_topics_and_all_are_by_time():
    found, told = told_of()
    stamps = [stamp_ns for stamp_ns, _, _ in told]
    assert stamps == sorted(stamps)
    for side in ("left", "right"):
        for what, count in (("events", len(found.hands[side].events)), ("strokes", len(found.hands[side].strokes))):
            sides = [message.side for _, topic, message in told if topic == f"/analysis/{side}/{what}"]
            assert sides == [side] * count
    arms = [message for _, topic, message in told if topic == "/analysis/left/arm"]
    assert len(arms) == len(found.stamp_ns)
    assert {message.frame_id for message in arms} == {"chair"}


def test_the_chairs_transform_takes_its_origin_and_axes_to_the_camera():
    """The camera looks straight back from 1 m before the axle, 0.5 m above it and 1 cm to the left."""
    _, told = told_of()
    edges = [message.transforms[0] for _, topic, message in told if topic == "/analysis/tf"]
    frames = [message for _, topic, message in told if topic == "/analysis/chair"]
    assert len(edges) == len(frames) == 3  # every two seconds of five
    for said in (edges[-1], frames[-1]):
        assert (said.parent_frame_id, said.child_frame_id) == ("camera_optical", "chair")
        t, q = said.translation, said.rotation
        np.testing.assert_allclose((t.x, t.y, t.z), (-0.01, 0.5, 1.0), atol=1e-12)
        np.testing.assert_allclose(np.abs((q.x, q.y, q.z, q.w)), 0.5, atol=1e-12)
    assert len(frames[0].covariance) == 36
