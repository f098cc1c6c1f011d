"""What is drawn over the picture: half pixels, stamps, colours, and labels that stay inside."""

from dataclasses import replace

import pytest
from recording_data import estimate, stamp

from spheremcap.core.circle import Circle
from spheremcap.core.estimate import Status
from spheremcap.io import _pb, messages
from spheremcap.io.annotations import Annotations
from spheremcap.io.messages import MARKER_RGB, STATUS_RGB

DRAWN = Annotations({"left_wrist": 0, "a": 0, "b": 1}, (160, 120))

_VIEWERS = ("#4e98e2", "#f5774d", "#f7df71", "#5cd6a9", "#61cbff", "#a395e2", "#cad660")
"""The first of the 28 colours that the viewers' State Transitions panel gives the numbers 0, 1, 2, ... modulo 28."""


def test_they_count_from_the_pixel_corner_and_give_diameters():
    shown = estimate("left_wrist", 4, Status.VERIFIED)
    message = DRAWN.of(stamp(4), [shown])
    (circle,) = message.circles
    assert (circle.position.x, circle.position.y) == (shown.circle.x_px + 0.5, shown.circle.y_px + 0.5)
    assert circle.diameter == 2 * shown.circle.r_px
    assert message.texts[0].text.startswith("left_wrist VERIFIED")


def test_the_searched_window_is_drawn_only_where_nothing_was_verified():
    assert not DRAWN.of(stamp(4), [estimate("a", 4, Status.VERIFIED)]).points
    shown = estimate("a", 4, Status.LOST)
    (outline,) = DRAWN.of(stamp(4), [shown]).points
    window = shown.search
    assert [(p.x, p.y) for p in outline.points][::2] == [
        (window.x, window.y),
        (window.x + window.width, window.y + window.height),
    ]
    assert outline.thickness == 1


@pytest.mark.parametrize("status", list(Status))
def test_every_item_bears_the_pictures_stamp_and_can_be_seen(status):
    message = DRAWN.of(stamp(9), [estimate("a", 9, status), estimate("b", 9, status)])
    items = [*message.circles, *message.points, *message.texts]
    assert {messages.stamp_of(item.timestamp) for item in [message, *items]} == {stamp(9)}
    assert len(message.texts) == 2
    assert all(item.outline_color.a > 0 for item in [*message.circles, *message.points])
    assert all(text.text_color.a > 0 for text in message.texts)


def test_a_rejected_claim_is_drawn_thinly_and_faintly_beside_the_filters_thin_circle():
    message = DRAWN.of(stamp(1), [estimate("a", 1, Status.ESTIMATED)])
    assert [circle.thickness for circle in message.circles] == [1.0, 1.0]
    assert [circle.outline_color.a < 1 for circle in message.circles] == [False, True]
    assert DRAWN.of(stamp(1), [estimate("a", 1, Status.VERIFIED)]).circles[0].thickness == 2.0


def test_a_circle_has_its_markers_colour_and_a_label_its_statuss():
    message = DRAWN.of(stamp(1), [estimate("b", 1, Status.VERIFIED)])
    circle, text = message.circles[0].outline_color, message.texts[0].text_color
    assert (circle.r, circle.g, circle.b) == MARKER_RGB[1]
    assert (text.r, text.g, text.b) == STATUS_RGB[Status.VERIFIED]


def test_status_colours_are_those_of_the_state_panel():
    for status, rgb in STATUS_RGB.items():
        number = _pb.MarkerState.Status.Value(status.value) % 28
        drawn = "#" + "".join(f"{round(255 * c):02x}" for c in rgb)
        assert drawn == _VIEWERS[number], status


@pytest.mark.parametrize("place", [(2, 3), (158, 3), (158, 118), (2, 118), (80, 60)])
@pytest.mark.parametrize("status", [Status.VERIFIED, Status.LOST])
def test_labels_stay_inside_the_picture(place, status):
    shown = estimate("a", 1, status)
    x, y = place
    circle = Circle(x, y, 9.25)
    shown = replace(shown, claim=circle, circle=circle if shown.circle is not None else None)
    large = Annotations({"a": 0}, (160, 120))
    (text,) = large.of(stamp(1), [shown]).texts
    width = 0.62 * text.font_size * len(text.text)
    assert text.position.x >= 0.06 * 160
    assert text.position.x + width <= 0.94 * 160 + 1e-9 or text.position.x == pytest.approx(0.06 * 160)
    assert 0.06 * 120 + text.font_size <= text.position.y <= 0.94 * 120


def test_what_is_nowhere_is_listed_at_the_left_edge():
    gone = [estimate(name, 1, Status.OUT_OF_VIEW) for name in ("a", "b")]
    texts = DRAWN.of(stamp(1), gone).texts
    assert texts[0].position.x == texts[1].position.x < 30
    assert texts[1].position.y - texts[0].position.y >= texts[0].font_size
