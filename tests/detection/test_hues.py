"""Colours by name."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from spheremcap.detection.hues import GREYS, HUES_MEANT, is_meant, name_of

VIVID = (200.0, 180.0)
"""Saturation and value."""


@pytest.mark.parametrize(
    ("hue", "name"),
    [(0, "red"), (7, "red"), (14, "orange"), (25, "yellow"), (57, "green"), (92, "cyan"), (112, "blue"),
     (138, "purple"), (163, "magenta"), (176, "red"), (179.9, "red")],
)  # fmt: skip
def test_hues_have_the_names_that_people_give_them(hue, name):
    assert name_of((hue, *VIVID)) == name
    assert is_meant(name, (hue, *VIVID))


@pytest.mark.parametrize(("value", "name"), [(30, "black"), (100, "grey"), (220, "white")])
def test_what_has_hardly_any_colour_is_a_grey(value, name):
    assert name_of((57, 10, value)) == name
    assert not is_meant("green", (57, 10, value))
    assert all(is_meant(grey, (57, 10, value)) for grey in GREYS)
    assert not is_meant("white", (57, *VIVID))


def test_a_dark_picture_has_colours_too_but_black_has_none():
    assert name_of((50, 72, 62)) == "green"
    assert name_of((41, 49, 111)) == "green"
    assert name_of((120, 200, 10)) == "black"


@given(st.floats(0, 179.99))
def test_whatever_a_hue_is_called_is_what_may_be_meant_by_it(hue):
    assert is_meant(name_of((hue, *VIVID)), (hue, *VIVID))


def test_a_range_may_go_over_the_end_of_the_circle():
    for hue, inside in ((169, False), (170, True), (179, True), (0, True), (10, True), (11, False), (90, False)):
        assert is_meant((170, 10), (hue, *VIVID)) is inside
        assert is_meant((10.5, 169.5), (hue, *VIVID)) is not inside
    assert not is_meant((0, 180), (57, 10, 100))
    assert set(HUES_MEANT).isdisjoint(GREYS)
