"""What one circle of a person changes: followed both ways, until it meets what was there, and not a frame further."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from scenes import CAMERA, COUNTED, ORANGE, PERIOD_NS, RADIUS_M, Ball, bgr_frame, picture, truth
from spheremcap.attended import Attended
from spheremcap.chain import ChainConfig
from spheremcap.core.circle import Circle
from spheremcap.core.estimate import FrameResult, OperatorRequest, Status
from spheremcap.core.marker import Hidden, Keep, MarkerSpec, Seed
from spheremcap.core.time import NS_PER_S
from spheremcap.session import HIDDEN, Session, SessionConfig
from spheremcap.stretch import BACKWARDS, Stretch, Terms, base_seeds, correct

MARKERS = (MarkerSpec("wrist", 2 * RADIUS_M), MarkerSpec("elbow", 2 * RADIUS_M))
COUNT = 60


def wrist(i):
    w = 2 * np.pi * 3.0 * i * PERIOD_NS / NS_PER_S
    return Ball((-0.08 + 0.05 * float(np.sin(w)), 0.06 * float(np.cos(w)), 0.9), ORANGE)


def elbow(i):
    w = 2 * np.pi * 2.0 * i * PERIOD_NS / NS_PER_S
    return Ball((0.1 + 0.03 * float(np.cos(w)), 0.05 * float(np.sin(w)), 0.8), ORANGE)


BALLS = {"wrist": wrist, "elbow": elbow}


@lru_cache(maxsize=300)
def image(i, hidden):
    return picture(*([] if hidden else [wrist(i)]), elbow(i), noise_seed=i)


class Film:
    """The wrist is out of sight on the frames `gone`; those of `lost` cannot be decoded. Counts what was asked for."""

    def __init__(self, gone=(), lost=(), count=COUNT):
        self.gone, self.lost, self.count = gone, lost, count
        self.asked = []

    def at(self, index):
        assert 0 <= index < self.count
        self.asked.append(index)
        return None if index in self.lost else bgr_frame(image(index, index in self.gone), index)

    def frames(self):
        return [frame for frame in map(self.at, range(self.count)) if frame is not None]


def seed(name, index=0, of=None):
    return Seed(name, index, truth(BALLS[of or name](index)))


CHAIN = ChainConfig(policy=COUNTED)
BOTH = (seed("wrist"), seed("elbow"))


class Base:
    """A run with the markers' first circles only."""

    def __init__(self, film, answers, metric=True):
        first = base_seeds(answers)
        specs = [spec for spec in MARKERS if spec.name in {s.marker for s in first}]
        self.terms = Terms(CAMERA, metric, tuple(specs), CHAIN, SessionConfig(), 0.0, None, 0, film.count - 1)
        session = Session(CAMERA, specs, first, CHAIN, SessionConfig(), metric=metric)
        self.results = {r.frame_index: r for r in session.run(film.frames())}
        film.asked.clear()

    def __call__(self, index):
        result = self.results.get(index)
        return {} if result is None else {e.marker: e for e in result.estimates}


def corrected(film, *answers, marker="wrist", base=None, **how):
    base = base or Base(film, answers)
    return correct(marker, answers, replace(base.terms, **how), base, film.at), base


def near(estimate, ball=wrist, px=0.5):
    return estimate.circle is not None and estimate.circle.distance(truth(ball(estimate.frame_index))) < px


# -- where a stretch begins and ends ----------------------------------------------------------------


def test_a_marker_that_was_lost_is_there_again_before_and_behind_the_answer():
    """The base has lost the wrist for good: it was taken for what it is not when it came back."""
    film = Film(gone=range(10, 25))
    answers = (*BOTH, seed("wrist", 40))
    base = Base(film, answers)
    base.results = {i: r if i < 12 else without(r, "wrist") for i, r in base.results.items()}
    found, _ = corrected(film, *answers, base=base)
    (stretch,) = found.stretches
    assert (stretch.frames[0], stretch.frames[-1]) == (25, COUNT - 1)
    for result in stretch:
        (estimate,) = result.estimates
        assert estimate.status is (Status.SEEDED if result.frame_index == 40 else Status.VERIFIED)
        assert near(estimate)
        assert (BACKWARDS in estimate.reasons) == (result.frame_index < 40)
        assert (estimate.answer_frame, estimate.marker) == (40, "wrist")
        assert estimate.stamp_ns == result.stamp_ns == result.frame_index * PERIOD_NS
    assert stretch.before.startswith("lost on frame")
    assert stretch.after == "the last frame"


def without(result, marker, status=Status.LOST):
    """A result in which this marker is lost."""
    made = tuple(
        replace(e, status=status, circle=None, xyz_cam_m=None) if e.marker == marker else e for e in result.estimates
    )
    return replace(result, estimates=made)


def test_it_ends_where_it_meets_the_track_on_either_side():
    film = Film()
    answers = (*BOTH, seed("wrist", 30))
    base = Base(film, answers)
    base.results = {i: without(r, "wrist") if 20 <= i < 40 else r for i, r in base.results.items()}
    (stretch,) = corrected(film, *answers, base=base)[0].stretches
    assert list(stretch.frames) == list(range(20, 40))
    assert (stretch.before, stretch.after) == ("meets the track on frame 19", "meets the track on frame 40")
    assert (min(film.asked), max(film.asked)) == (15, 44)  # five frames in a row, and no more are looked at


def test_a_circle_where_the_track_was_right_changes_one_frame():
    (stretch,) = corrected(Film(), *BOTH, seed("wrist", 30))[0].stretches
    assert list(stretch.frames) == [30]
    assert stretch.estimate(30).status is Status.SEEDED


def test_four_frames_of_agreement_are_no_meeting():
    film = Film()
    answers = (*BOTH, seed("wrist", 30))
    base = Base(film, answers)
    base.results = {i: r if i % 5 else without(r, "wrist") for i, r in base.results.items()}
    (stretch,) = corrected(film, *answers, base=base)[0].stretches
    assert list(stretch.frames) == list(range(1, COUNT))
    assert (stretch.before, stretch.after) == ("the circle before, on frame 0", "the last frame")


@pytest.mark.parametrize(("off_radii", "meets"), [(0.25, True), (0.45, False)])
def test_two_circles_beside_each_other_are_no_meeting(off_radii, meets):
    film = Film()
    answers = (*BOTH, seed("wrist", 30))
    base = Base(film, answers)
    base.results = {i: shifted(r, "wrist", off_radii) for i, r in base.results.items()}
    (stretch,) = corrected(film, *answers, base=base)[0].stretches
    assert (len(stretch) == 1) == meets


def shifted(result, marker, radii):
    made = tuple(
        replace(e, circle=e.circle.shifted(radii * e.circle.r_px, 0)) if e.marker == marker else e
        for e in result.estimates
    )
    return replace(result, estimates=made)


def test_what_is_only_estimated_is_no_meeting():
    film = Film()
    answers = (*BOTH, seed("wrist", 30))
    base = Base(film, answers)

    def standing_in(result):
        made = tuple(replace(e, status=Status.ESTIMATED) if e.marker == "wrist" else e for e in result.estimates)
        return replace(result, estimates=made)

    base.results = {i: standing_in(r) for i, r in base.results.items()}
    (stretch,) = corrected(film, *answers, base=base)[0].stretches
    assert list(stretch.frames) == list(range(1, COUNT))


def test_between_two_circles_each_has_its_frames():
    """The base is on the elbow all along; backwards from the second, the first one's stretch is met."""
    film = Film()
    answers = (seed("wrist", of="elbow"), seed("elbow"), seed("wrist", 20), seed("wrist", 40))
    found, _ = corrected(film, *answers)
    first, second = found.stretches
    assert (first.frames[0], first.frames[-1]) == (1, 39)
    assert first.after == "the next circle, on frame 40"
    assert list(second.frames) == list(range(40, COUNT))
    assert second.before == "meets the track on frame 39"
    assert all(near(found.at(i).estimate(i)) for i in range(1, COUNT))


def test_the_later_of_two_circles_corrects_what_the_earlier_one_made():
    """The first answer was a wrong click, on the elbow: what was made of it stands only up to its own frame."""
    film = Film()
    answers = (*BOTH, seed("wrist", 20, of="elbow"), seed("wrist", 40))
    found, _ = corrected(film, *answers)
    assert near(found.at(20).estimate(20), elbow)
    assert all(near(found.at(i).estimate(i)) for i in range(21, 40))
    assert found.stretches[1].before == "the circle before, on frame 20"


def test_a_circle_before_the_first_one_is_an_answer_too():
    film = Film()
    answers = (seed("elbow"), seed("wrist", 20), seed("wrist", 8))
    found, base = corrected(film, *answers)
    assert "wrist" not in base(19)
    (stretch,) = found.stretches
    assert list(stretch.frames) == list(range(20))
    assert stretch.before == "the first frame"
    assert stretch.after == "the next circle, on frame 20"


def test_no_frame_outside_the_recording_is_asked_for():
    film = Film()
    base = Base(film, (*BOTH, seed("wrist", 30)))
    base.results = {i: without(r, "wrist") for i, r in base.results.items()}
    film.asked.clear()
    (stretch,) = corrected(film, *BOTH, seed("wrist", 30), base=base, last_index=44)[0].stretches
    assert (max(film.asked), stretch.frames[-1]) == (44, 44)


def test_a_stop_ends_it():
    film, left = Film(), [7]

    def go_on():
        left[0] -= 1
        return left[0] >= 0

    base = Base(film, BOTH)
    correct("wrist", (*BOTH, seed("wrist", 30)), base.terms, base, film.at, go_on)
    assert len(film.asked) <= 12


def test_frames_that_cannot_be_decoded_are_left_out_and_an_answer_on_one_says_so():
    film = Film(lost=(25, 35))
    answers = (*BOTH, seed("wrist", 30), seed("wrist", 35))
    base = Base(film, answers)
    base.results = {i: without(r, "wrist") for i, r in base.results.items()}
    first, second = corrected(film, *answers, base=base)[0].stretches
    assert list(first.frames) == [i for i in range(1, 35) if i != 25]
    assert len(second) == 0
    assert second.before == second.after == "frame 35 cannot be decoded"


# -- hidden ----------------------------------------------------------------------------------------


def test_hidden_frames_are_nobodys_and_a_stretch_goes_on_behind_them():
    film = Film(gone=range(36, 44))
    hidden = Hidden("wrist", 36, 43, "anna")
    answers = (seed("wrist", of="elbow"), seed("elbow"), seed("wrist", 30), hidden)
    found, _ = corrected(film, *answers)
    (stretch,) = found.stretches
    assert found.at(36) is found.at(43) is hidden
    assert (found.at(35), found.at(44)) == (stretch, stretch)
    assert stretch.estimate(40).reasons == (HIDDEN,)
    assert stretch.estimate(40).answer_frame == 36
    assert all(near(stretch.estimate(i)) for i in (*range(2, 36), *range(48, COUNT)))


def test_backwards_it_ends_behind_what_is_hidden():
    film = Film()
    answers = (seed("wrist", of="elbow"), seed("elbow"), seed("wrist", 30), Hidden("wrist", 12, 20))
    (stretch,) = corrected(film, *answers)[0].stretches
    assert stretch.frames[0] == 21
    assert stretch.before == "hidden on frame 20"


def test_between_what_is_hidden_and_a_stretch_the_base_is_not_believed():
    """The wrist is said to be hidden up to two frames before it is seen; the base has taken the elbow for it."""
    film = Film(gone=range(12, 25))
    hidden = Hidden("wrist", 12, 22)
    answers = (seed("wrist", of="elbow"), seed("elbow"), seed("wrist", 30), hidden)
    found, base = corrected(film, *answers)
    (stretch,) = found.stretches
    assert base(23)["wrist"].status is Status.VERIFIED  # else there was nothing to correct
    assert (stretch.frames[0], stretch.before) == (23, "hidden on frame 22")
    for index in (23, 24):
        assert found.at(index) is stretch
        assert not stretch.estimate(index).status.measured
        assert BACKWARDS in stretch.estimate(index).reasons
    assert all(near(stretch.estimate(index)) for index in range(25, COUNT))


def test_hidden_frames_of_another_marker_and_kept_ones_change_nothing():
    film = Film()
    answers = (*BOTH, seed("wrist", 30), Hidden("elbow", 0, COUNT), Keep("wrist", 0, COUNT))
    found, _ = corrected(film, *answers)
    assert found.hidden == ()
    assert [list(s.frames) for s in found.stretches] == [[30]]


# -- time runs backwards ---------------------------------------------------------------------------


def test_backwards_velocities_are_those_of_forward_time():
    film = Film()
    answers = (seed("wrist", of="elbow"), seed("elbow"), seed("wrist", 30))
    (stretch,) = corrected(film, *answers)[0].stretches
    for i in (*range(5, 25), *range(36, 55)):
        true = (np.array(wrist(i + 1).xyz) - wrist(i - 1).xyz) / (2 * PERIOD_NS / NS_PER_S)
        (pose,) = stretch[i].smoothed
        assert (pose.frame_index, pose.stamp_ns) == (i, i * PERIOD_NS)
        assert np.linalg.norm(pose.velocity_cam_mps[:2] - true[:2]) < 0.25, i
        assert np.linalg.norm(stretch.estimate(i).velocity_cam_mps[:2] - true[:2]) < 0.6, i
        assert np.linalg.norm(pose.xyz_cam_m - wrist(i).xyz) < 0.006


def test_the_readout_changes_its_sign_with_time():
    """A shutter that rolls downwards stretches what goes down: read the wrong way round, it is too near or too far."""
    readout_s = 0.8 * PERIOD_NS / NS_PER_S
    speed_mps = 3.0

    def falling(i):
        return Ball((-0.02, -0.12 + speed_mps * i * PERIOD_NS / NS_PER_S, 0.9))

    def rolled(i):
        """Row by row as the shutter reads them; the stamp is that of the middle row's reading."""
        rows = np.arange(CAMERA.height_px)
        late = np.round((rows / (CAMERA.height_px - 1) - 0.5) * 8).astype(int) / 8  # in readouts
        image = np.empty((CAMERA.height_px, CAMERA.width_px, 3), np.uint8)
        for part in np.unique(late):
            moment = falling(i + part * readout_s * NS_PER_S / PERIOD_NS)
            image[late == part] = picture(moment, noise_seed=i)[late == part]
        return image

    frames = {i: bgr_frame(rolled(i), i) for i in range(15)}
    terms = Terms(CAMERA, True, MARKERS[:1], CHAIN, SessionConfig(), 0.0, readout_s, 0, 14)
    answers = (Seed("wrist", 20, Circle(50, 50, 10)), Seed("wrist", 14, truth(falling(14))))
    (stretch,) = correct("wrist", answers, terms, lambda i: {}, frames.get).stretches
    errors = [stretch.estimate(i).xyz_cam_m[2] - falling(i).xyz[2] for i in range(2, 11)]
    wrong = correct("wrist", answers, replace(terms, readout_s=-readout_s), lambda i: {}, frames.get).stretches[0]
    others = [wrong.estimate(i).xyz_cam_m[2] - falling(i).xyz[2] for i in range(2, 11) if i in wrong]
    assert abs(np.mean(errors)) < 0.5 * abs(np.mean(others))


# -- other markers ---------------------------------------------------------------------------------


def test_markers_whose_names_were_swapped_are_put_right_one_by_one():
    """Each base sits on the other one's ball, which is nearer or farther: a person's word goes first."""
    film = Film()
    answers = (seed("wrist", of="elbow"), seed("elbow", of="wrist"), seed("wrist", 30), seed("elbow", 30))
    base = Base(film, answers)
    for name, ball in BALLS.items():
        (stretch,) = corrected(film, *answers, marker=name, base=base)[0].stretches
        assert all(near(stretch.estimate(i), ball) for i in range(1, COUNT) if i in stretch)
        assert list(stretch.frames) == list(range(1, COUNT))


@pytest.mark.parametrize("metric", [True, False])
def test_a_lost_marker_is_not_found_where_another_one_is(metric):
    """Both balls are alike, and the wrist goes out of sight for good: the elbow stays the elbow."""
    film = Film(gone=range(30, COUNT))
    answers = (seed("elbow"), seed("wrist", 50, of="elbow"), seed("wrist", 20))
    base = Base(film, answers, metric=metric)
    (stretch,) = corrected(film, *answers, base=base)[0].stretches
    after = [stretch.estimate(i) for i in range(30, 50)]
    assert not any(e.status.measured for e in after)
    assert after[-1].status is Status.LOST


# -- where results wait ----------------------------------------------------------------------------


def test_results_are_given_back_as_they_came_in_any_order():
    film = Film()
    (stretch,) = corrected(film, seed("wrist", of="elbow"), seed("elbow"), seed("wrist", 30))[0].stretches
    assert isinstance(stretch, Stretch)
    assert [r.frame_index for r in stretch] == list(stretch.frames) == sorted(stretch.frames)
    assert stretch[40].frame_index == 40
    assert stretch[12].frame_index == 12
    assert 12 in stretch
    stretch.leave([12])
    assert 12 not in stretch
    assert len(list(stretch)) == len(stretch) == len(stretch.frames)


def test_the_same_answers_give_the_same_stretches():
    def told():
        film = Film(gone=range(36, 44))
        found, _ = corrected(film, *BOTH, seed("wrist", 50), seed("wrist", 20))
        return [(s.before, s.after, [(e.status, e.circle, e.reasons) for r in s for e in r.estimates])
                for s in found.stretches]  # fmt: skip

    assert told() == told()


# -- a run that a person attends -------------------------------------------------------------------


def asked_of(film, answers, lost_at):
    """The frames at which a person is asked for the wrist, whose base is lost anew at each of these."""
    terms = Terms(CAMERA, True, MARKERS[:1], CHAIN, SessionConfig(), 0.0, None, 0, film.count - 1)
    asked = []

    def ask(one):
        asked.append(one.request.raised_at_frame_index)
        return []

    attended = Attended(terms, film.at, ask, answers)
    for i in range(12):
        request = OperatorRequest("wrist", i - 1, 0, i, 0, "lost")
        attended.after(film.at(i), FrameResult(i, i * PERIOD_NS, (), (), (request,) if i in lost_at else ()))
    return asked


def test_nobody_is_asked_where_somebody_said_that_it_is_hidden():
    assert asked_of(Film(), [], (3, 6, 9)) == [3, 6, 9]
    assert asked_of(Film(), [Hidden("wrist", 4, 6)], (3, 6, 9)) == [3, 9]
    assert asked_of(Film(), [Hidden("elbow", 4, 6)], (3, 6, 9)) == [3, 6, 9]


def test_nobody_is_asked_for_the_base_of_a_marker_that_is_followed_from_a_circle():
    assert asked_of(Film(), [seed("wrist", 4)], (3, 6, 9)) == [3]
