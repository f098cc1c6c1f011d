"""What is drawn over the picture: circles, labels, searched windows, as foxglove.ImageAnnotations.

Viewers draw from the corner of the top-left pixel, our coordinates count from its centre: annotations (and only they)
are shifted by half a pixel. Every item bears the picture's own stamp, as viewers want it.
"""

# mypy: disable-error-code="arg-type"
# The schemas' stubs do not know that a dict will do.

from collections.abc import Iterable, Mapping
from typing import Any

from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.PointsAnnotation_pb2 import PointsAnnotation

from spheremcap.core.circle import Circle
from spheremcap.core.estimate import MarkerEstimate
from spheremcap.core.frame import Window
from spheremcap.io.messages import STATUS_RGB, Fields, Message, Rgb, color, marker_rgb, time_fields

_STATUS_COLOR = {status: color(rgb, 1.0) for status, rgb in STATUS_RGB.items()}
_FAINT_COLOR = {status: color(rgb, 0.45) for status, rgb in STATUS_RGB.items()}
_LABEL_BACKGROUND = color((0.0, 0.0, 0.0), 0.45)
_NO_MARKER: Rgb = (1.0, 1.0, 1.0)
_CHARACTER = 0.62
"""Width of a character by the font's size, in the viewers' fonts."""
_MARGIN = 0.06
"""Of the picture's width and height, where no label is: viewers straighten it by the calibration, and cut its edges."""


class Annotations:
    """Draws one camera's markers on its pictures.

    `markers` are the numbers of their colours by name, `size_px` is (width, height) of the pictures: labels stay
    inside, and are as large as can be read on the whole of it. With None they are where their markers are.
    """

    def __init__(self, markers: Mapping[str, int], size_px: tuple[int, int] | None) -> None:
        self._colors = {name: color(marker_rgb(number), 1.0) for name, number in markers.items()}
        self._size_px = size_px
        self._margins_px = (0.0, 0.0) if size_px is None else (_MARGIN * size_px[0], _MARGIN * size_px[1])
        self.font_px = 14.0 if size_px is None else max(10.0, size_px[0] / 70)

    def of(self, stamp_ns: int, estimates: Iterable[MarkerEstimate]) -> Message:
        """foxglove.ImageAnnotations of a frame.

        A circle has its marker's colour, thick where it is measured and thin where the filter stands in; its label,
        with status and votes, has the status's (`STATUS_RGB`). Only where nothing was verified the claim that failed
        and the searched window are drawn too. A marker without a circle keeps its label: at that window, or in a list
        down the left edge when there is none.
        """
        stamp = time_fields(stamp_ns)
        circles: list[Fields] = []
        outlines: list[Fields] = []
        labels: list[Fields] = []
        unplaced = 0
        for estimate in estimates:
            status, faint = estimate.status, _FAINT_COLOR[estimate.status]
            own = self._colors.get(estimate.marker) or color(_NO_MARKER, 1.0)
            if estimate.circle is not None:
                circles.append(_circle(stamp, estimate.circle, 2.0 if status.measured else 1.0, own))
            if not status.measured:
                if estimate.claim is not None:
                    circles.append(_circle(stamp, estimate.claim, 1.0, faint))
                if estimate.search is not None:
                    outlines.append(_outline(stamp, estimate.search, faint))
            text = f"{estimate.marker} {status.value}"
            if estimate.vote_sum is not None:
                text += f" {estimate.vote_sum:.1f}"
            place = self._place(estimate, len(text))
            if place is None:
                unplaced += 1
                left, top = self._margins_px
                place = (left + self.font_px / 2, top + unplaced * 1.5 * self.font_px)
            labels.append(
                {
                    "timestamp": stamp, "position": {"x": place[0], "y": place[1]}, "text": text,
                    "font_size": self.font_px, "text_color": _STATUS_COLOR[status],
                    "background_color": _LABEL_BACKGROUND,
                }
            )  # fmt: skip
        return ImageAnnotations(timestamp=stamp, circles=circles, points=outlines, texts=labels)

    def _place(self, estimate: MarkerEstimate, characters: int) -> tuple[float, float] | None:
        """Bottom left of the label, from the picture's corner: up and right of the circle, where there is room."""
        circle = estimate.circle or estimate.claim
        if circle is not None:
            x, y = circle.x_px + 0.5 + 0.8 * circle.r_px, circle.y_px + 0.5 - circle.r_px
        elif estimate.search is not None:
            x, y = float(estimate.search.x), float(estimate.search.y)
        else:
            return None
        if self._size_px is None:
            return x, y
        (width, height), (side, top) = self._size_px, self._margins_px
        return (
            max(side, min(x, width - side - _CHARACTER * self.font_px * characters)),
            min(max(y, top + 1.2 * self.font_px), height - top - 0.3 * self.font_px),
        )


def _circle(stamp: Fields, circle: Circle, thickness: float, outline: Fields) -> Fields:
    return {
        "timestamp": stamp, "position": {"x": circle.x_px + 0.5, "y": circle.y_px + 0.5},
        "diameter": 2 * circle.r_px, "thickness": thickness, "outline_color": outline,
    }  # fmt: skip


def _outline(stamp: Fields, window: Window, outline: Fields) -> dict[str, Any]:
    """The window's border; its corners are pixel corners, which is where viewers count from: no shift."""
    x0, y0, x1, y1 = window.x, window.y, window.x + window.width, window.y + window.height
    corners = [{"x": x0, "y": y0}, {"x": x1, "y": y0}, {"x": x1, "y": y1}, {"x": x0, "y": y1}]
    return {
        "timestamp": stamp, "type": PointsAnnotation.LINE_LOOP, "points": corners, "outline_color": outline,
        "thickness": 1.0,
    }  # fmt: skip
