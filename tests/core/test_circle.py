import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spheremcap.core.circle import Circle

coordinate = st.floats(-500, 500)
radius = st.floats(0.5, 200)
circles = st.builds(Circle, coordinate, coordinate, radius)


def counted(a: Circle, b: Circle, step: float) -> float:
    """The thesis' variant of the shared area: count the sample points that lie in both."""
    half = a.r_px + step
    x, y = np.meshgrid(np.arange(a.x_px - half, a.x_px + half, step), np.arange(a.y_px - half, a.y_px + half, step))
    both = (np.hypot(x - a.x_px, y - a.y_px) < a.r_px) & (np.hypot(x - b.x_px, y - b.y_px) < b.r_px)
    return float(both.sum()) * step * step


@pytest.mark.parametrize(
    "other",
    [
        Circle(52.0, 40.0, 20.0),  # nearly the same
        Circle(65.0, 47.5, 20.0),  # same size, half off
        Circle(62.0, 31.0, 11.0),  # smaller, over the edge
        Circle(50.0, 53.0, 35.0),  # larger, the centre inside it
        Circle(54.0, 42.0, 8.0),  # wholly inside
        Circle(50.0, 88.0, 19.0),  # a thin lens
        Circle(70.0, 70.0, 5.0),  # apart
    ],
)
def test_shared_area_in_closed_form_is_what_counting_finds(other):
    circle = Circle(50.0, 40.0, 20.0)
    assert circle.shared_area(other) == pytest.approx(counted(circle, other, 0.05), abs=2.0)


@given(circles, circles)
def test_shared_area_is_symmetric_and_never_more_than_the_smaller_circle(a, b):
    shared = a.shared_area(b)
    assert shared == pytest.approx(b.shared_area(a), rel=1e-9, abs=1e-6)
    assert 0 <= shared <= min(a.area_px2, b.area_px2) * (1 + 1e-12)


@given(circles, circles)
def test_dice_is_one_minus_the_error_of_equation_2_19(a, b):
    shared, total = a.shared_area(b), a.area_px2 + b.area_px2
    error = 2 * (total - shared) / total - 1  # as the thesis prints it
    assert a.dice(b) == pytest.approx(1 - error, abs=1e-9)


@given(circles)
def test_a_circle_agrees_with_itself_wholly_and_with_a_touching_one_not_at_all(circle):
    assert circle.dice(circle) == pytest.approx(1)
    assert circle.dice(circle.shifted(2.001 * circle.r_px, 0)) == 0


def test_the_overlap_falls_steadily_as_the_circles_part():
    circle = Circle(0, 0, 10)
    overlaps = [circle.dice(circle.shifted(d, 0)) for d in np.linspace(0, 20, 201)]
    assert (np.diff(overlaps) < 0).all()


def test_the_dice_of_one_millimetre_errors_is_what_the_method_states():
    # docs/method.md 3: Dice 97.3 % still allows 0.85 px of centre error at r = 20.
    assert Circle(0, 0, 20).dice(Circle(0.85, 0, 20)) == pytest.approx(0.973, abs=5e-4)


def test_two_points_overlap_in_nothing():
    assert Circle(1, 1, 0).dice(Circle(1, 1, 0)) == 0


def test_distance_and_shift():
    circle = Circle(1.5, -2, 4)
    moved = circle.shifted(3, 4)
    assert moved == Circle(4.5, 2, 4)
    assert circle.distance(moved) == 5
    assert circle.area_px2 == pytest.approx(16 * math.pi)
