"""What a person clicks of a wheelchair on the pictures of a camera that is fixed to it."""

from collections.abc import Sequence
from dataclasses import dataclass

from spheremcap.errors import UsageError

CLICKED = ("left_axle", "right_axle", "left_rim", "right_rim", "front")
"""What is clicked. Left and right are the athlete's. An axle is the centre of the wheel's hub; a rim is any point of
the push rim's circle (the middle line of its tube), at least `RIM_POINTS` of a side, spread over what is visible of it;
front is a point of the chair whose place in the chair's frame the settings of the analysis give, such as the front hub.
There are many clicks of a rim and one of everything else."""

RIMS = ("left_rim", "right_rim")
RIM_POINTS = 5
"""So many points give an ellipse."""


@dataclass(frozen=True, slots=True)
class ChairClick:
    """Where a person sees what `on` names (one of CLICKED), in pixels, on frame `frame_index` (presentation order)."""

    on: str
    frame_index: int
    x_px: float
    y_px: float


def check_clicks(clicks: Sequence[ChairClick], width_px: int, height_px: int) -> None:
    """Whether they can be clicks on pictures of this size. Raises UsageError that names the one that cannot."""
    numbers: dict[str, int] = {}
    for number, click in enumerate(clicks, 1):
        if click.on not in CLICKED:
            raise UsageError(f"click {number}: on is {click.on!r}; expected one of {', '.join(CLICKED)}")
        # An integer coordinate is a pixel's centre; written so that NaN is outside too.
        if not (-0.5 <= click.x_px <= width_px - 0.5 and -0.5 <= click.y_px <= height_px - 0.5):
            raise UsageError(
                f"click {number}: {click.on} at {click.x_px:g}, {click.y_px:g} is outside the {width_px}x{height_px} "
                "picture"
            )
        if click.on not in RIMS and numbers.setdefault(click.on, number) != number:
            raise UsageError(
                f"clicks {numbers[click.on]} and {number} are both of {click.on}, of which there is one: keep the "
                "right one"
            )
