"""Colours by name: what a person calls a hue, and which hues a person may mean by a name."""

from collections.abc import Mapping

from spheremcap.detection.colour import HUES

Hsv = tuple[float, float, float]
"""Hue 0..180 in steps of 2 degrees, saturation and value 0..255."""

_LEAST_SATURATION, _LEAST_CHROMA = 35.0, 12.0  # of a colour with a hue; chroma is saturation by value, 0..255
_BLACK_VALUE, _WHITE_VALUE = 60.0, 150.0  # of one without

_ENDS: Mapping[str, float] = {
    "red": 10, "orange": 19, "yellow": 35, "green": 82, "cyan": 100, "blue": 128, "purple": 148, "magenta": 172,
}  # fmt: skip
"""Each name's last hue, in order; what comes after the last is red again."""

HUES_MEANT: Mapping[str, tuple[float, float]] = {
    "red": (165, 12),
    "orange": (3, 24),
    "yellow": (17, 40),
    "green": (33, 90),
    "cyan": (78, 105),
    "blue": (95, 135),
    "purple": (122, 155),
    "magenta": (142, 178),
}
"""First and last hue that may be meant by a name, on the circle: neighbours overlap, as light and cameras differ."""

GREYS = ("white", "grey", "black")


def name_of(hsv: Hsv) -> str:
    """What a colour is called."""
    hue, saturation, value = hsv
    if saturation < _LEAST_SATURATION or saturation * value / 255 < _LEAST_CHROMA:
        return "black" if value < _BLACK_VALUE else "white" if value > _WHITE_VALUE else "grey"
    return next((name for name, end in _ENDS.items() if hue < end), "red")


def is_meant(colour: str | tuple[float, float], hsv: Hsv) -> bool:
    """Whether a colour may be the one of this name, or has a hue between these two, on the circle."""
    if isinstance(colour, str) and colour in GREYS:
        # Which of the three it is depends on the light.
        return name_of(hsv) in GREYS
    first, last = HUES_MEANT[colour] if isinstance(colour, str) else colour
    return name_of(hsv) not in GREYS and (hsv[0] - first) % HUES <= (last - first) % HUES
