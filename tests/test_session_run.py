"""All markers over one source: seeds, requests, smoothing, and what a session costs."""

from dataclasses import fields, replace
from functools import lru_cache

import numpy as np
import pytest

from scenes import CAMERA, COUNTED, GREEN, ORANGE, PERIOD_NS, RADIUS_M, Ball, bgr_frame, picture, truth
from spheremcap.chain import ChainConfig
from spheremcap.core.circle import Circle
from spheremcap.core.estimate import Status
from spheremcap.core.frame import BgrFrame
from spheremcap.core.marker import Hidden, Keep, MarkerSpec, Seed
from spheremcap.core.time import NS_PER_S
from spheremcap.errors import UsageError
from spheremcap.session import HIDDEN, Session, SessionConfig

MARKERS = (MarkerSpec("wrist", 2 * RADIUS_M), MarkerSpec("elbow", 2 * RADIUS_M))
GONE = range(12, 20)  # the wrist's


def wrist(i):
    w = 2 * np.pi * 3.0 * i * PERIOD_NS / NS_PER_S
    return Ball((-0.08 + 0.05 * float(np.sin(w)), 0.06 * float(np.cos(w)), 0.9), ORANGE)


def elbow(i):
    w = 2 * np.pi * 2.0 * i * PERIOD_NS / NS_PER_S
    return Ball((0.1 + 0.03 * float(np.cos(w)), 0.05 * float(np.sin(w)), 0.8), GREEN)


BALLS = {"wrist": wrist, "elbow": elbow}


@lru_cache(maxsize=200)
def image(i, hidden=False):
    return picture(*([] if hidden else [wrist(i)]), elbow(i), noise_seed=i)


def frames(count, hidden=()):
    for i in range(count):
        yield bgr_frame(image(i, i in hidden), i)


def seed(name, index=0):
    return Seed(name, index, truth(BALLS[name](index)))


BOTH = (seed("wrist"), seed("elbow"))


def lone(*more, **how):
    """The wrist alone, where a second marker would only cost time."""
    return session((seed("wrist"), *more), markers=MARKERS[:1], **how)


def session(seeds=BOTH, lag=60, markers=MARKERS, **how):
    how = {"chain": ChainConfig(policy=COUNTED)} | how
    return Session(CAMERA, markers, seeds, config=SessionConfig(smoother_lag_frames=lag), **how)


def of(results, name):
    return [e for r in results for e in r.estimates if e.marker == name]


@lru_cache(maxsize=1)
def plain_run():
    return tuple(session(lag=10).run(frames(30)))


@lru_cache(maxsize=1)
def hidden_run():
    return tuple(session().run(frames(28, GONE)))


# -- frames and markers ----------------------------------------------------------------------------


def test_every_frame_gives_one_result_in_order_with_every_marker():
    results = plain_run()
    assert [r.frame_index for r in results] == list(range(30))
    assert [r.stamp_ns for r in results] == [i * PERIOD_NS for i in range(30)]
    for result in results:
        assert [e.marker for e in result.estimates] == ["wrist", "elbow"]


def test_each_marker_is_followed_on_its_own():
    for name, ball in BALLS.items():
        estimates = of(plain_run(), name)
        assert [e.status for e in estimates] == [Status.SEEDED] + [Status.VERIFIED] * 29
        assert max(e.circle.distance(truth(ball(e.frame_index))) for e in estimates) < 0.35


def test_a_second_marker_changes_nothing_for_the_first():
    alone = of(session((seed("wrist"),), markers=MARKERS[:1]).run(frames(8)), "wrist")
    together = of(session().run(frames(8)), "wrist")
    assert [e.circle for e in alone] == [e.circle for e in together]


def test_each_frame_is_taken_from_the_source_once_and_none_ahead_of_need():
    taken = []

    def source():
        for frame in frames(18):
            taken.append(frame.index)
            yield frame

    run = lone(lag=5).run(source())
    next(run)
    assert len(taken) == 10  # two lags: what the smoother waits for
    rest = list(run)
    assert taken == list(range(18))
    assert len(rest) == 17


def test_no_more_frames_are_pending_than_two_lags():
    ahead = 0
    taken = 0

    def source():
        nonlocal taken
        for frame in frames(22):
            taken += 1
            yield frame

    for given, _ in enumerate(lone(lag=4).run(source())):
        ahead = max(ahead, taken - given)
    assert ahead <= 8


@pytest.mark.parametrize(("rate_hz", "most"), [(25, 14), (60, 31)])
def test_no_more_than_half_a_second_is_pending(rate_hz, most):
    taken, pending = [], []

    def source():
        for i in range(2 * most):
            taken.append(i)
            yield BgrFrame(i, i * NS_PER_S // rate_hz, image(0))

    for given, result in enumerate(lone(lag=60).run(source())):
        assert result.frame_index == given
        pending.append(len(taken) - given)
    assert max(pending) == most
    assert len(pending) == 2 * most


def test_a_frame_is_not_held_back_with_its_result():
    """Memory stays flat: results do not keep the pictures."""
    import gc
    import weakref

    alive = []

    def source():
        for frame in frames(16):
            own = BgrFrame(frame.index, frame.stamp_ns, frame.image.copy())
            alive.append(weakref.ref(own))
            yield own

    kept = list(lone(lag=3).run(source()))
    gc.collect()
    assert len(kept) == 16
    assert sum(ref() is not None for ref in alive) <= 3


def test_two_runs_are_the_same():
    a, b = (list(session(lag=4).run(frames(11))) for _ in range(2))
    for x, y in zip(a, b, strict=True):
        assert [(e.status, e.circle, e.vote_sum) for e in x.estimates] == [
            (e.status, e.circle, e.vote_sum) for e in y.estimates
        ]
        for p, q in zip(x.smoothed, y.smoothed, strict=True):
            np.testing.assert_array_equal(p.xyz_cam_m, q.xyz_cam_m)


@pytest.mark.parametrize("threads", [2, 5])
def test_the_number_of_threads_changes_nothing(threads):
    """Looks run side by side; deciding and learning go in order, nearest first."""

    def run(count):
        return list(session(threads=count, keep_view=lambda e: True).run(frames(24, GONE)))

    for a, b in zip(run(1), run(threads), strict=True):
        assert a.requests == b.requests
        for kind in ("estimates", "smoothed", "views"):
            for x, y in zip(getattr(a, kind), getattr(b, kind), strict=True):
                for field in fields(x):
                    own, other = getattr(x, field.name), getattr(y, field.name)
                    if isinstance(own, np.ndarray):
                        np.testing.assert_array_equal(own, other, field.name)
                    elif field.name != "responses":
                        assert own == other, field.name


def test_the_markers_of_a_camera_learn_its_optics_together():
    both = session()
    first, second = (lane.chain for lane in both._lanes.values())
    assert first.optics is second.optics
    assert session()._lanes["wrist"].chain.optics is not first.optics


def test_an_empty_source_with_no_seed_due_says_what_is_missing():
    with pytest.raises(UsageError, match="the source has 0 frames"):
        list(session().run([]))


# -- seeds -----------------------------------------------------------------------------------------


def test_a_marker_appears_with_its_first_seed():
    results = list(session((seed("wrist"), seed("elbow", 6))).run(frames(12)))
    assert [len(r.estimates) for r in results] == [1] * 6 + [2] * 6
    assert of(results, "elbow")[0].status is Status.SEEDED


def test_a_later_seed_is_a_correction():
    astray = Seed("wrist", 0, truth(elbow(0)))  # a wrong click, on the other marker
    results = list(session((astray, seed("wrist", 8), seed("elbow"))).run(frames(16)))
    estimates = of(results, "wrist")
    assert estimates[8].status is Status.SEEDED
    for estimate in estimates[8:]:
        assert estimate.status.measured
        assert estimate.circle.distance(truth(wrist(estimate.frame_index))) < 0.35


def test_a_seed_on_nothing_in_particular_does_not_end_the_run():
    astray = Seed("wrist", 0, Circle(30.0, 215.0, 13.0))
    assert len(list(lone().run(frames(3)))) == 3
    assert len(list(session((astray,), markers=MARKERS[:1]).run(frames(3)))) == 3


def test_seeds_may_be_given_in_any_order():
    results = list(session((seed("wrist", 8), seed("elbow"), seed("wrist"))).run(frames(12)))
    seeded = [e.frame_index for e in of(results, "wrist") if e.status is Status.SEEDED]
    assert seeded == [0, 8]


def test_a_correction_brings_a_lost_marker_back():
    results = list(lone(seed("wrist", 19)).run(frames(24, range(12, 19))))
    statuses = [e.status for e in of(results, "wrist")]
    assert statuses[18] is Status.LOST
    assert statuses[19] is Status.SEEDED
    assert all(s is Status.VERIFIED for s in statuses[20:])


def test_a_seed_of_an_unknown_marker_names_it_and_the_known_ones():
    with pytest.raises(UsageError, match=r"'knee'.*wrist, elbow"):
        session((*BOTH, Seed("knee", 0, Circle(50, 50, 10))))


def test_a_marker_without_a_seed_says_how_to_give_one():
    with pytest.raises(UsageError, match=r"'elbow' has no seed.*--seed elbow@FRAME=X,Y,R"):
        session((seed("wrist"),))


@pytest.mark.parametrize("circle", [Circle(-5, 50, 10), Circle(50, 240, 10), Circle(400, 50, 10), Circle(50, 50, 0.5)])
@pytest.mark.parametrize("index", [0, 20_000])
def test_a_seed_outside_the_picture_is_an_error_that_says_where(circle, index):
    """At the start, not when its frame comes: a typo in a late correction must not cost the run."""
    seeds = (seed("wrist"), Seed("wrist", 20_000, circle)) if index else (Seed("wrist", 0, circle),)
    match = rf"seed of wrist on frame {index}: circle x=.* outside the 320x240 picture"
    with pytest.raises(UsageError, match=match):
        session((*seeds, seed("elbow")))


def test_two_seeds_of_one_marker_on_one_frame_are_an_error_at_the_start():
    again = Seed("wrist", 8, truth(wrist(8)).shifted(2, 0))
    with pytest.raises(UsageError, match="two seeds of wrist on frame 8: keep the right one"):
        session((*BOTH, seed("wrist", 8), again))


def test_a_seed_on_a_frame_that_did_not_come_is_asked_for_again_and_not_taken_on_another():
    """Frames 4 and 5 are lost; the marker has moved on by frame 6, where its circle of frame 5 is wrong."""
    came = [frame for frame in frames(12) if frame.index not in (4, 5)]
    results = list(session((*BOTH, seed("wrist", 5))).run(came))
    assert all(e.status is Status.VERIFIED for e in of(results, "wrist")[1:])
    requests = [(r.frame_index, q) for r in results for q in r.requests]
    assert len(requests) == 1
    index, request = requests[0]
    assert (index, request.marker, request.frame_index, request.raised_at_frame_index) == (6, "wrist", 6, 6)
    assert request.stamp_ns == request.raised_stamp_ns == 6 * PERIOD_NS
    assert "frame 5 did not come" in request.reason


def test_a_marker_whose_only_seed_did_not_come_waits_for_a_person():
    came = [frame for frame in frames(12) if frame.index != 3]
    results = list(session((seed("wrist", 3), seed("elbow"), seed("wrist", 9))).run(came))
    assert [(r.frame_index, q.marker) for r in results for q in r.requests] == [(4, "wrist")]
    assert [e.frame_index for e in of(results, "wrist")] == [9, 10, 11]


def test_a_persons_seed_wins_over_another_marker_at_its_place():
    """The elbow's chain has gone astray and sits on the wrist; the person who says that the wrist is there is right."""
    astray = Seed("elbow", 0, truth(wrist(0)))
    together = MarkerSpec("wrist", 2 * RADIUS_M), MarkerSpec("elbow", 2 * RADIUS_M)
    results = list(Session(CAMERA, together, (astray, seed("wrist", 4))).run(frames(8)))
    assert of(results, "elbow")[3].status is Status.VERIFIED
    first = of(results, "wrist")[0]
    assert (first.frame_index, first.status) == (4, Status.SEEDED)
    assert first.circle.distance(truth(wrist(4))) < 0.35
    there = of(results, "elbow")[4]
    assert not there.status.measured
    assert there.reasons == ("covered",)


def test_a_seed_after_the_last_frame_is_an_error_that_says_how_many_there_are():
    with pytest.raises(UsageError, match=r"seed of wrist on frame 99: the source has 5 frames \(0 to 4\)"):
        list(session((*BOTH, seed("wrist", 99))).run(frames(5)))


# -- requests --------------------------------------------------------------------------------------


def test_a_lost_marker_raises_one_request_for_its_first_unverified_frame():
    results = hidden_run()
    requests = [q for r in results for q in r.requests]
    assert len(requests) == 1
    request = requests[0]
    lost = next(e for e in of(results, "wrist") if e.status is Status.LOST)
    assert request.marker == "wrist"
    assert (request.frame_index, request.stamp_ns) == (12, 12 * PERIOD_NS)
    assert (request.raised_at_frame_index, request.raised_stamp_ns) == (lost.frame_index, lost.stamp_ns)
    assert lost.frame_index == 16  # five in a row
    assert "5 frames in a row without a verified circle" in request.reason
    seen = of(results, "wrist")[12:17]
    assert set(request.reasons) == {name for e in seen for name in e.reasons}
    assert all(name in request.reason for name in request.reasons)
    assert results[16].requests == (request,)


def test_the_other_marker_does_not_notice():
    assert all(e.status.measured for e in of(hidden_run(), "elbow"))


def test_the_lost_marker_is_found_again_without_a_person():
    after = of(hidden_run(), "wrist")[GONE.stop + 3 :]
    assert all(e.status is Status.VERIFIED for e in after)


def test_a_second_loss_is_a_second_request():
    results = list(lone().run(frames(32, {*range(8, 15), *range(24, 31)})))
    requests = [q for r in results for q in r.requests]
    assert [q.frame_index for q in requests] == [8, 24]


def test_a_short_gap_asks_nobody():
    results = list(lone().run(frames(18, range(12, 15))))
    assert [q for r in results for q in r.requests] == []


# -- smoothing -------------------------------------------------------------------------------------


@pytest.mark.parametrize("lag", [1, 4, 5, 60])
def test_every_tracked_frame_has_one_smoothed_pose_on_its_own_result(lag):
    for result in session(lag=lag).run(frames(13)):
        assert sorted(p.marker for p in result.smoothed) == ["elbow", "wrist"]
        for pose in result.smoothed:
            assert (pose.frame_index, pose.stamp_ns) == (result.frame_index, result.stamp_ns)
            assert pose.xyz_cam_m.shape == (3,)
            assert pose.covariance_m2.shape == (3, 3)
            assert pose.velocity_cam_mps.shape == (3,)


def test_smoothing_comes_nearer_to_the_truth_than_measuring():
    measured, smoothed, velocity = [], [], []
    for result in plain_run()[3:-3]:
        i = result.frame_index
        for estimate in result.estimates:
            measured.append(np.linalg.norm(estimate.xyz_cam_m - BALLS[estimate.marker](i).xyz))
        for pose in result.smoothed:
            ball = BALLS[pose.marker]
            smoothed.append(np.linalg.norm(pose.xyz_cam_m - ball(i).xyz))
            true = (np.array(ball(i + 1).xyz) - ball(i - 1).xyz) / (2 * PERIOD_NS / NS_PER_S)
            velocity.append(np.linalg.norm(pose.velocity_cam_mps - true))
    assert np.sqrt(np.mean(np.square(smoothed))) < np.sqrt(np.mean(np.square(measured)))
    assert np.median(velocity) < 0.3


def test_a_lost_stretch_has_no_smoothed_pose_and_a_bridged_one_has():
    for result in hidden_run():
        status = next(e.status for e in result.estimates if e.marker == "wrist")
        poses = [p for p in result.smoothed if p.marker == "wrist"]
        assert len(poses) == (0 if status in (Status.LOST, Status.OUT_OF_VIEW) else 1)


def test_smoothing_does_not_reach_across_a_correction():
    """A seed starts a new stretch: what comes after it cannot change what was before."""
    far = Seed("wrist", 10, truth(elbow(10)))  # the person points at something else
    plain = list(lone().run(frames(10)))
    corrected = list(lone(far).run(frames(14)))
    for a, b in zip(plain, corrected[:10], strict=True):
        np.testing.assert_allclose(a.smoothed[0].xyz_cam_m, b.smoothed[0].xyz_cam_m, atol=1e-12)


def test_without_a_calibrated_camera_there_are_no_poses():
    results = list(session(metric=False).run(frames(6)))
    assert all(r.smoothed == () for r in results)
    assert all(e.xyz_cam_m is None for r in results for e in r.estimates)


# -- pictures for people ---------------------------------------------------------------------------


def test_the_smoothed_covariance_has_the_focal_lengths_share():
    loose = replace(CAMERA, focal_sd=0.03)
    runs = [list(Session(camera, MARKERS[:1], (seed("wrist"),)).run(frames(8))) for camera in (CAMERA, loose)]
    for plain, unsure in zip(*runs, strict=True):
        (a,), (b,) = plain.smoothed, unsure.smoothed
        np.testing.assert_allclose(b.xyz_cam_m, a.xyz_cam_m)
        expected = a.covariance_m2 + 0.03**2 * np.outer(a.xyz_cam_m, a.xyz_cam_m)
        np.testing.assert_allclose(b.covariance_m2, expected, rtol=1e-6)


def test_views_are_kept_where_they_are_asked_for():
    results = list(session(keep_view=lambda e: e.marker == "elbow" and e.frame_index % 3 == 0).run(frames(8)))
    assert [[v.marker for v in r.views] for r in results] == [[], [], [], ["elbow"], [], [], ["elbow"], []]


def test_a_lost_marker_is_not_found_where_another_one_is():
    """Two of one colour; the far one is covered for good while the near one comes close to where it was."""
    far = Ball((0.02, 0.0, 0.95), ORANGE)

    def near(i):
        return Ball((0.02 - 0.15 + 0.006 * min(i, 22), 0.03, 0.85), ORANGE)

    def drawn(i):
        gone = i > 5
        return picture(*([] if gone else [far]), near(i), noise_seed=i)

    seeds = (Seed("wrist", 0, truth(far)), Seed("elbow", 0, truth(near(0))))
    results = list(session(seeds).run(bgr_frame(drawn(i), i) for i in range(60)))
    gone = [e for e in of(results, "wrist") if e.frame_index > 5]
    assert not any(e.status.measured for e in gone)
    assert gone[-1].status is Status.LOST
    assert all(e.status.measured for e in of(results, "elbow"))


def test_a_repeated_time_stamp_does_not_end_the_run():
    """Logs have them; the shutter's readout time is not given, so the interval between frames counts."""
    stamped = [BgrFrame(i, (i - (i in (1, 6))) * PERIOD_NS, image(i)) for i in range(12)]
    estimates = of(lone().run(iter(stamped)), "wrist")
    assert [e.status.measured for e in estimates].count(True) >= 10


def test_a_request_names_the_first_unverified_frame_when_numbers_have_gaps():
    """Every second frame of the source: the numbers go up by two."""
    given = (BgrFrame(2 * i, i * PERIOD_NS, image(i, i >= 8)) for i in range(20))
    requests = [q for r in lone().run(given) for q in r.requests]
    assert len(requests) == 1
    assert requests[0].frame_index == 16


# -- hidden ----------------------------------------------------------------------------------------


def test_a_marker_that_a_person_calls_hidden_is_not_looked_for():
    """It is in plain view: who says that it is not is believed, on these frames and no others."""
    told = Hidden("wrist", 12, 19)
    results = list(session((*BOTH, told)).run(frames(30)))
    for estimate in of(results, "wrist"):
        if 12 <= estimate.frame_index <= 19:
            assert (estimate.status, estimate.reasons) == (Status.OUT_OF_VIEW, (HIDDEN,))
            assert estimate.answer_frame == 12
            assert (estimate.circle, estimate.claim, estimate.xyz_cam_m, estimate.votes) == (None, None, None, ())
        else:
            assert HIDDEN not in estimate.reasons
            assert estimate.answer_frame is None
    assert [e.status for e in of(results, "wrist")[23:]] == [Status.VERIFIED] * 7
    again = next(e for e in of(results, "wrist")[20:] if e.status.measured)
    assert again.proposer == "acquire"  # nothing was learnt of where it went meanwhile
    assert not [q for r in results for q in r.requests]
    assert not [p for r in results[12:20] for p in r.smoothed if p.marker == "wrist"]
    assert all(e.status.measured for e in of(results, "elbow"))


def test_one_that_is_not_found_after_it_was_hidden_is_asked_for_from_there_on():
    results = list(lone(Hidden("wrist", 8, 20)).run(frames(30, range(8, 30))))
    requests = [q for r in results for q in r.requests]
    assert [(q.frame_index, q.raised_at_frame_index) for q in requests] == [(21, 21)]
    assert "not found where it is no longer hidden" in requests[0].reason


def test_a_circle_where_a_person_says_hidden_is_refused():
    for frame, told in ((12, Hidden("wrist", 12, 19)), (19, Hidden("wrist", 12, 19))):
        with pytest.raises(UsageError, match=f"wrist has a circle on frame {frame} and is hidden from frame 12 to 19"):
            session((*BOTH, seed("wrist", frame), told))
    session((*BOTH, seed("wrist", 11), seed("wrist", 20), seed("elbow", 15), Hidden("wrist", 12, 19)))


def test_what_is_kept_changes_nothing():
    kept = list(session((*BOTH, Keep("wrist", 2, 9)), lag=4).run(frames(11)))
    assert [[(e.status, e.circle) for e in r.estimates] for r in kept] == [
        [(e.status, e.circle) for e in r.estimates] for r in session(lag=4).run(frames(11))
    ]


def test_a_session_is_told_what_markers_of_another_one_hide():
    """The wrist's place is taken on frame 5 by one that is nearer than itself, on frame 6 by one that is farther."""
    asked = []

    def others(frame_index, range_m):
        asked.append((frame_index, range_m))
        near = {5: 0.5, 6: 1.5}.get(frame_index, 9.0)
        return [truth(wrist(frame_index))] if near < range_m else []

    results = list(lone(others=others).run(frames(9)))
    assert [e.reasons for e in of(results, "wrist")] == [("covered",) if i == 5 else () for i in range(9)]
    assert [i for i, _ in asked] == list(range(1, 9))
    assert all(0.8 < range_m < 1.0 for _, range_m in asked)


def test_the_latest_result_is_that_of_the_frame_just_taken():
    one = lone(lag=3)
    seen = []

    def source():
        for frame in frames(8):
            yield frame
            seen.append((one.latest.frame_index, one.latest.estimates[0].circle))

    results = list(one.run(source()))
    assert seen == [(r.frame_index, r.estimates[0].circle) for r in results]
