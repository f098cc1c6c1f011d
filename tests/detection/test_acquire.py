import numpy as np
import pytest

from scenes import BLUE, CAMERA, GREEN, ORANGE, Cover, ball_at, bgr_frame, picture, truth, yuv_frame
from spheremcap.core.circle import Circle
from spheremcap.core.frame import Frame, Patch, Window
from spheremcap.detection.acquire import AcquireConfig, Candidate, acquire
from spheremcap.detection.colour import ColourConfig, colour_circle, disc_pixels, learn_box

EVERYWHERE = Window(0, 0, CAMERA.width_px, CAMERA.height_px)


def box_of(ball):
    circle = truth(ball)
    patch = Patch(bgr_frame(picture(ball)), Window.around(circle, 2 * circle.r_px))
    return learn_box(disc_pixels(patch, circle, 0.8), ColourConfig())


def found_in(image, ball, region=EVERYWHERE, frame_of=bgr_frame, last=None):
    return acquire(frame_of(image), box_of(ball), 1.0, last or truth(ball), region, AcquireConfig())


@pytest.mark.parametrize("frame_of", [bgr_frame, yuv_frame])
@pytest.mark.parametrize("rgb", [ORANGE, GREEN, BLUE])
@pytest.mark.parametrize("r", [8, 14, 28])
def test_a_disc_is_found_anywhere_with_no_prior(r, rgb, frame_of):
    known = ball_at(160, 120, r, rgb=rgb)
    for x, y in ((40, 45), (280, 200), (200.5, 60.2)):
        ball = ball_at(x, y, r, rgb=rgb)
        found = found_in(picture(ball, noise_seed=3), known, frame_of=frame_of)
        assert found
        assert found[0].circle.distance(truth(ball)) < 0.35 * r + 1
        assert 0.6 < found[0].circle.r_px / r < 1.5


def test_the_disc_comes_before_a_bar_of_its_colour():
    known = ball_at(160, 120, 14)
    ball = ball_at(70, 60, 14)
    image = picture(ball, covers=(Cover(180, 100, 290, 112, ORANGE),))
    found = found_in(image, known)
    assert found[0].circle.distance(truth(ball)) < 5


def test_a_bar_of_its_length_does_not_come_before_a_disc_that_has_shrunk():
    known = ball_at(160, 120, 14)
    ball = ball_at(70, 60, 10)
    image = picture(ball, covers=(Cover(200, 150, 230, 162, ORANGE),))
    found = found_in(image, known)
    assert found[0].circle.distance(truth(ball)) < 5


def test_size_tells_two_discs_of_one_colour_apart():
    known = ball_at(160, 120, 12)
    right, large = ball_at(70, 60, 12), ball_at(230, 150, 21)
    found = found_in(picture(large, right), known)
    assert found[0].circle.distance(truth(right)) < 5


def test_only_the_region_is_searched():
    ball = ball_at(70, 60, 14)
    image = picture(ball)
    assert found_in(image, ball, Window(150, 0, 170, 240)) == []
    assert found_in(image, ball, Window(30, 20, 90, 90))[0].circle.distance(truth(ball)) < 5


@pytest.mark.parametrize("r", [9, 14, 28])
def test_where_the_region_begins_does_not_move_what_is_found(r):
    """The centre lies on the ball whichever pixels the steps fall on."""
    ball = ball_at(160.4, 118.7, r)
    frame, box, circle = bgr_frame(picture(ball)), box_of(ball), truth(ball)
    centres = []
    for k in range(9):
        region = Window(80 + k, 40 + k // 2, 150, 150)
        found = acquire(frame, box, 1.0, circle, region, AcquireConfig())
        centres.append((found[0].circle.x_px - circle.x_px, found[0].circle.y_px - circle.y_px))
    patch = Patch(frame, Window.around(circle, 2 * r))
    fine = colour_circle(box.mask(patch.hsv), patch, circle)
    bias = np.array([fine.x_px - circle.x_px, fine.y_px - circle.y_px])
    assert np.abs(np.mean(centres, axis=0) - bias).max() < 0.05 * r
    assert np.ptp(centres, axis=0).max() < 0.25 * r


def test_no_picture_is_converted_as_a_whole():
    class Planes(Frame):
        """A frame whose planes are at hand, and nothing else."""

        planes = bgr_frame(picture(ball_at(70, 60, 14))).planes

    ball = ball_at(70, 60, 14)
    found = acquire(Planes(0, 0, 320, 240), box_of(ball), 1.0, truth(ball), EVERYWHERE, AcquireConfig())
    assert found[0].circle.distance(truth(ball)) < 5


def test_a_region_out_of_the_picture_finds_nothing():
    assert found_in(picture(ball_at(70, 60, 14)), ball_at(70, 60, 14), Window(-200, -200, 100, 100)) == []


def test_no_disc_no_candidates_and_never_more_than_asked_for():
    known = ball_at(160, 120, 12)
    assert found_in(picture(), known) == []
    many = [ball_at(30 + 45 * k, 60 + 70 * (k % 2), 12) for k in range(7)]
    assert len(found_in(picture(*many), known)) == AcquireConfig().most


def test_a_far_larger_or_smaller_disc_is_no_candidate():
    ball = ball_at(160, 120, 40)
    assert found_in(picture(ball), ball, last=Circle(160, 120, 10)) == []


def test_of_a_disc_that_is_half_hidden_the_whole_is_among_the_candidates():
    """Whichever half: its own side is where the blob ends, the other is cut off."""
    known = ball_at(160, 120, 28)
    circle = truth(known)
    for cover in (Cover(160, 60, 230, 180), Cover(90, 60, 160, 180), Cover(90, 120, 230, 180), Cover(90, 60, 230, 120)):
        found = found_in(picture(known, covers=(cover,)), known)
        assert found[0].circle.distance(circle) > 0.3 * circle.r_px
        assert min(whole.distance(circle) for whole in found[0].wholes(circle.r_px)) < 0.15 * circle.r_px


def test_a_blob_as_large_as_the_marker_is_the_whole():
    whole = Candidate(Circle(100.0, 80.0, 20.0), 20.0, 17.0)
    assert whole.wholes(20.0) == [Circle(100.0, 80.0, 20.0)]
    assert whole.wholes(18.0) == [Circle(100.0, 80.0, 18.0)]
    assert len(whole.wholes(22.0)) == 3  # 5 pixels of its height may be hidden, above or below
