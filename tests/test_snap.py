"""A person's circle as the chain would start from it."""

import math
import time

import cv2
import numpy as np
import pytest

from scenes import BLUE, CAMERA, GREEN, ORANGE, Cover, ball_at, bgr_frame, picture, truth, yuv_frame
from spheremcap import api
from spheremcap.chain import ChainConfig, MarkerChain
from spheremcap.config import Settings
from spheremcap.core.camera import Camera
from spheremcap.core.circle import Circle
from spheremcap.core.frame import Patch, Window
from spheremcap.core.marker import MarkerSpec
from spheremcap.detection.appearance import contrast
from spheremcap.detection.colour import box_mask
from spheremcap.errors import UsageError

BALL = ball_at(150.3, 117.8, 18)
CIRCLE = truth(BALL)
SETTINGS = Settings()


def test_a_snap_is_what_the_chain_starts_from():
    frame = yuv_frame(picture(BALL))
    clicked = CIRCLE.shifted(1.5, -1).resized(19)
    snap = api.snap(frame, clicked, SETTINGS, CAMERA)
    chain = MarkerChain(MarkerSpec("marker"), CAMERA, ChainConfig())
    seeded = chain.seed(frame, clicked)
    assert snap.circle == seeded.circle
    assert snap.circle_sd_px == seeded.circle_sd_px
    assert snap.visible == seeded.visible > 0.9
    assert snap.against == seeded.reasons == ()
    np.testing.assert_array_equal(snap.xyz_cam_m, seeded.xyz_cam_m)
    np.testing.assert_array_equal(snap.limits, chain.colours(Patch(frame, snap.window), snap.circle))
    assert snap.circle.distance(CIRCLE) < 0.3
    assert abs(snap.circle.r_px - CIRCLE.r_px) < 0.3


def test_the_mask_is_of_its_window_and_selects_the_marker():
    frame = bgr_frame(picture(BALL))
    snap = api.snap(frame, CIRCLE, SETTINGS, CAMERA)
    window = snap.window
    assert snap.mask.shape == (window.height, window.width)
    np.testing.assert_array_equal(snap.mask, box_mask(frame.patch(window), snap.limits))
    assert window.holds(CIRCLE.x_px - 2.9 * CIRCLE.r_px, CIRCLE.y_px)
    rows, columns = np.indices(snap.mask.shape)
    inside = np.hypot(columns + window.x - CIRCLE.x_px, rows + window.y - CIRCLE.y_px) < 0.8 * CIRCLE.r_px
    assert (snap.mask[inside] > 0).mean() > 0.85
    assert (snap.mask[~inside] > 0).mean() < 0.1


def test_the_window_ends_at_the_pictures_border():
    snap = api.snap(bgr_frame(picture(ball_at(12, 200, 15))), Circle(12, 200, 15), SETTINGS)
    assert snap.window.x == 0
    assert snap.window.y + snap.window.height == CAMERA.height_px


def test_metres_come_with_a_camera_only_and_with_its_own_uncertainty():
    frame = bgr_frame(picture(BALL))
    distance_m = float(np.linalg.norm(BALL.xyz))
    snap = api.snap(frame, CIRCLE, SETTINGS, CAMERA, diameter_m=0.04)
    assert snap.distance_m == pytest.approx(distance_m, rel=0.01)
    assert snap.distance_m == pytest.approx(float(np.linalg.norm(snap.xyz_cam_m)))
    unsure = Camera(320, 240, 600.0, 600.0, 159.5, 119.5, focal_sd=0.1)
    guessed = api.snap(frame, CIRCLE, SETTINGS, unsure)
    assert guessed.distance_sd_m == pytest.approx(0.1 * distance_m, rel=0.05)
    assert 0 < snap.distance_sd_m < 0.3 * guessed.distance_sd_m
    half = api.snap(frame, CIRCLE, SETTINGS, CAMERA, diameter_m=0.02)
    assert half.distance_m == pytest.approx(distance_m / 2, rel=0.01)
    without = api.snap(frame, CIRCLE, SETTINGS)
    assert without.xyz_cam_m is without.distance_m is without.distance_sd_m is None
    assert without.circle.distance(CIRCLE) < 0.3


def test_where_there_is_no_sphere_the_circle_stays_and_that_is_said():
    plain = bgr_frame(np.full((240, 320, 3), 120, np.uint8))
    snap = api.snap(plain, Circle(100, 100, 20), SETTINGS, CAMERA)
    assert snap.circle == Circle(100, 100, 20)
    assert snap.visible == 0
    assert snap.against == ("no outline",)
    assert snap.contrast == pytest.approx(0, abs=0.1)


def test_a_sphere_of_which_little_shows_is_said_to_be():
    half_hidden = picture(BALL, covers=(Cover(146, 90, 200, 150),))
    snap = api.snap(bgr_frame(half_hidden), CIRCLE, SETTINGS, CAMERA)
    assert 0 < snap.visible < 0.5
    assert snap.against == ("little outline",)


@pytest.mark.parametrize("circle", [Circle(-30, 100, 10), Circle(100, 260, 10), Circle(100, 100, 0.5)])
def test_a_circle_outside_the_picture_is_refused(circle):
    with pytest.raises(UsageError, match="outside the 320x240 picture"):
        api.snap(bgr_frame(picture(BALL), index=7), circle, SETTINGS, CAMERA)


def test_contrast_is_the_colour_difference_of_ring_and_disc():
    image = np.full((100, 100, 3), (60, 60, 60), np.uint8)
    cv2.circle(image, (50, 50), 15, (200, 60, 60), -1)
    lab = cv2.cvtColor(np.float32([[[60, 60, 60], [200, 60, 60]]]) / 255, cv2.COLOR_BGR2Lab)[0]
    patch = Patch(bgr_frame(image), Window(0, 0, 100, 100))
    assert contrast(patch, Circle(50, 50, 15)) == pytest.approx(np.linalg.norm(lab[0] - lab[1]), rel=1e-4)
    assert contrast(patch, Circle(20, 20, 8)) == 0
    assert math.isnan(contrast(patch, Circle(50, 50, 500)))  # no ring in the picture
    image[:, :50] = (200, 60, 60)  # a third of the ring at most is of another colour
    cv2.rectangle(image, (66, 0), (99, 99), (60, 60, 60), -1)
    assert contrast(Patch(bgr_frame(image), Window(0, 0, 100, 100)), Circle(40, 50, 15)) == 0


def test_contrast_rises_with_the_difference():
    found = [api.snap(bgr_frame(picture(ball_at(150, 118, 18, rgb=rgb))), CIRCLE, SETTINGS).contrast
             for rgb in ((118, 112, 104), ORANGE, GREEN, BLUE)]  # fmt: skip
    assert found[0] < min(found[1:])


def test_a_snap_is_quick_once_warm():
    frame = yuv_frame(picture(BALL))
    api.snap(frame, CIRCLE, SETTINGS, CAMERA)
    taken = []
    for _ in range(5):
        started = time.perf_counter()
        api.snap(frame, CIRCLE.shifted(1, 1), SETTINGS, CAMERA)
        taken.append(time.perf_counter() - started)
    assert min(taken) < 0.05
