"""Debug pictures: legible size, the same bytes each time, nothing breaks on odd views."""

import dataclasses

import cv2
import numpy as np
import pytest
from recording_data import estimate, result, stage_view

from spheremcap.core.circle import Circle
from spheremcap.core.estimate import Status
from spheremcap.core.frame import Window
from spheremcap.core.view import ResponseMap, StageView
from spheremcap.io import overlays


def decode(picture):
    assert picture.format == "jpeg"
    return cv2.imdecode(np.frombuffer(picture.data, np.uint8), cv2.IMREAD_COLOR)


@pytest.mark.parametrize("status", list(Status))
def test_a_stage_picture_is_three_panels_over_six_maps(status):
    of = estimate("left_wrist", 3, status)
    image = decode(overlays.stage_picture(stage_view(of), of))
    assert image.shape[1] == overlays.WIDTH_PX
    assert overlays.PANEL_PX + overlays.MAP_PX < image.shape[0] < 2 * overlays.PANEL_PX


def test_the_same_view_gives_the_same_bytes():
    of = estimate("left_wrist", 3, Status.VERIFIED)
    assert overlays.stage_picture(stage_view(of), of) == overlays.stage_picture(stage_view(of), of)


def test_what_spoke_against_a_claim_is_said():
    of = estimate("left_wrist", 3, Status.ESTIMATED)
    header = slice(0, 2 * overlays.LINE_PX + 6)
    said = overlays.draw_stages(stage_view(of), of)
    unsaid = overlays.draw_stages(stage_view(of), dataclasses.replace(of, reasons=()))
    assert (said[header] != unsaid[header]).any()
    assert (said[header.stop :] == unsaid[header.stop :]).all()


def test_the_final_circle_is_drawn_where_it_is():
    of = estimate("left_wrist", 3, Status.VERIFIED)
    view = stage_view(of)
    header = 2 * overlays.LINE_PX + 6
    panel = slice(overlays.PANEL_PX, 2 * overlays.PANEL_PX)
    mask = overlays.draw_stages(view, of)[header : header + overlays.PANEL_PX, panel].astype(int)
    green = (mask[..., 1] > 150) & (mask[..., 2] < 120)
    rows, columns = np.nonzero(green)
    scale = overlays.PANEL_PX / view.window.width
    x = (of.circle.x_px - view.window.x + 0.5) * scale - 0.5
    assert (columns.max() + columns.min()) / 2 == pytest.approx(x, abs=1)
    assert (columns.max() - columns.min()) / 2 == pytest.approx(of.circle.r_px * scale, abs=1.5)
    assert len(rows) > 50


def test_the_best_response_is_bright_for_sqdiff_too():
    values = np.ones((30, 40), np.float32)
    values[10, 25] = 0.0
    response = ResponseMap("sqdiff", values, True, (25, 10), Circle(0, 0, 5))
    image = np.zeros((overlays.MAP_PX, overlays.MAP_PX, 3), np.uint8)
    overlays._draw_map(image, response)
    image = image.astype(int)
    x, y = round(25.5 * 3 - 0.5), round(10.5 * 3 - 0.5) + 15
    assert tuple(image[y, x]) == (60, 60, 255)
    assert image[y + 20, x].sum() < image[y - 1 : y + 2, x - 1 : x + 2].sum(axis=2).max()


def test_odd_views_are_drawn_all_the_same():
    none = np.zeros((0, 2))
    constant = ResponseMap("ccorr", np.full((5, 5), np.nan, np.float32), False, (0, 0), Circle(0, 0, 1))
    empty = ResponseMap("ccoeff", np.zeros((0, 0), np.float32), False, (0, 0), Circle(0, 0, 1))
    wide = np.zeros((20, 900, 3), np.uint8)
    for patch, responses in ((wide, (constant, empty)), (wide[:0], ())):
        window = Window(-5, 3, patch.shape[1], patch.shape[0])
        view = StageView("a", window, patch, None, (Circle(1e9, 0, 5),), none, none[:, 0], responses)
        for of in (None, estimate("a", 1, Status.LOST)):
            assert decode(overlays.stage_picture(view, of)).shape[1] == overlays.WIDTH_PX


def test_the_overview_has_the_circles_burnt_in_at_its_own_size():
    image = np.full((60, 80, 3), 90, np.uint8)
    shown = result(1).estimates
    drawn = decode(overlays.overview_picture(image, 2, shown)).astype(int)
    assert drawn.shape == image.shape
    circle = shown[0].circle
    x, y = round((circle.x_px - 1) / 2), round((circle.y_px - 1 + circle.r_px) / 2)
    assert abs(drawn[y, x] - 90).max() > 30
    assert (image == 90).all()
