"""Debug pictures: what the stages saw of a marker, and whole frames with every circle burnt in.

JPEG at a fixed quality, so that the same frame gives the same bytes. Colours are those of the annotations.
"""

import math
from collections.abc import Iterable, Sequence

import cv2
import numpy as np
import numpy.typing as npt

from spheremcap.core.circle import Circle
from spheremcap.core.estimate import MarkerEstimate, Status
from spheremcap.core.frame import BgrImage, EncodedPicture, Window
from spheremcap.core.view import ResponseMap, StageView
from spheremcap.io.messages import STATUS_RGB

Bgr = tuple[int, int, int]

PANEL_PX = 240
MAP_PX = 120
WIDTH_PX = 3 * PANEL_PX
JPEG_QUALITY = 50
LINE_PX = 17
_HEADER_PX = 2 * LINE_PX + 6
_MAPS_A_ROW = WIDTH_PX // MAP_PX

_GREY: Bgr = (190, 190, 190)
_WHITE: Bgr = (255, 255, 255)
_HOUGH: Bgr = (255, 160, 60)
_CLAIM: Bgr = (255, 90, 255)
_VIRIDIS: BgrImage = cv2.applyColorMap(np.arange(256, dtype=np.uint8), cv2.COLORMAP_VIRIDIS).reshape(256, 3)  # type: ignore[assignment]
"""The colour of each grey level, (256, 3): `applyColorMap` makes it anew at every call."""


def stage_picture(view: StageView, estimate: MarkerEstimate | None) -> EncodedPicture:
    """One marker on one frame, for a person who asks why it was doubted.

    From the top: status, votes, verdict and what spoke against the claim; the searched patch with Hough's
    circles, the claim and the final circle; the colour mask; the edge points, red (weight 0) to green (weight
    1); the six response maps, bright where the matcher sees its best, the peak marked, with the matcher's
    score and its overlap V with the claim.
    """
    return _jpeg(draw_stages(view, estimate))


def overview_step(width_px: int) -> int:
    """Every how many pixels a whole frame of this width is sampled for its overview."""
    return max(1, round(width_px / 640))


def overview_picture(image: BgrImage, step: int, estimates: Iterable[MarkerEstimate]) -> EncodedPicture:
    """A whole frame, sampled every `step`-th pixel from step // 2, with all circles and names burnt in."""
    canvas = image.copy()
    scale, offset = 1 / step, -(step // 2) / step
    for estimate in estimates:
        colour = _status_bgr(estimate.status)
        circle = estimate.circle or estimate.claim
        if circle is None:
            continue
        if estimate.claim is not None and not estimate.status.measured:
            _ring(canvas, estimate.claim, (0, 0), scale, offset, _CLAIM)
        if estimate.circle is not None:
            _ring(canvas, estimate.circle, (0, 0), scale, offset, colour, 2)
        x = int((circle.x_px + circle.r_px) * scale) + 2
        y = int((circle.y_px - circle.r_px) * scale)
        _text(canvas, f"{estimate.marker} {estimate.status.value}", (x, max(y, 12)), colour)
    return _jpeg(canvas)


def request_picture(image: BgrImage, estimates: Iterable[MarkerEstimate]) -> bytes:
    """A whole frame as PNG, in its own pixels, with a thin circle where each of the estimates has its marker."""
    canvas = image.copy()
    for estimate in estimates:
        if estimate.circle is not None:
            _ring(canvas, estimate.circle, (0, 0), 1.0, 0.0, _status_bgr(estimate.status))
    return bytes(cv2.imencode(".png", canvas)[1].tobytes())


def draw_stages(view: StageView, estimate: MarkerEstimate | None) -> BgrImage:
    """The picture of `stage_picture` before encoding, (rows, 720, 3) BGR."""
    status = None if estimate is None else estimate.status
    final = None if estimate is None else estimate.circle
    claim = None if estimate is None else estimate.claim
    colour = _WHITE if status is None else _status_bgr(status)

    maps_top, map_height = _HEADER_PX + PANEL_PX + _caption_px(1), MAP_PX + _caption_px(3)
    canvas: BgrImage = np.zeros((maps_top + map_height * -(-len(view.responses) // _MAPS_A_ROW), WIDTH_PX, 3), np.uint8)
    _header(canvas[:_HEADER_PX], view, estimate, colour)
    panels = [canvas[_HEADER_PX:maps_top, left : left + PANEL_PX] for left in range(0, WIDTH_PX, PANEL_PX)]

    patch = _Panel(panels[0], view.patch, view.window)
    for rank, circle in enumerate(view.hough):
        patch.ring(circle, _HOUGH, 1 if rank else 2)
    grey = None if view.mask is None else cv2.cvtColor(view.mask, cv2.COLOR_GRAY2BGR)
    mask = _Panel(panels[1], grey, view.window)  # type: ignore[arg-type]
    plain = _Panel(panels[2], view.patch, view.window)
    if claim is not None and (status is None or not status.measured):
        patch.ring(claim, _CLAIM, 1)
        plain.ring(claim, _CLAIM, 1)
    if final is not None:
        patch.ring(final, colour, 1)
        mask.ring(final, colour, 1)
    plain.dots(view.edges_px, view.edge_weights)

    covered = "not run" if view.mask is None else f"{np.count_nonzero(view.mask) / max(view.mask.size, 1):.0%}"
    _caption(panels[0], PANEL_PX, [f"patch {view.window.width}x{view.window.height}, Hough {len(view.hough)} (blue)"])
    _caption(panels[1], PANEL_PX, [f"colour mask {covered}"])
    _caption(panels[2], PANEL_PX, [f"edges {len(view.edges_px)}, weight red to green"])

    votes = {} if estimate is None else {vote.matcher: vote for vote in estimate.votes}
    for number, response in enumerate(view.responses):
        row, column = divmod(number, _MAPS_A_ROW)
        top, left = maps_top + row * map_height, column * MAP_PX
        tile = canvas[top : top + map_height, left : left + MAP_PX]
        _draw_map(tile[:MAP_PX], response)
        vote = votes.get(response.matcher)
        said = ["no vote"] if vote is None else [f"score {vote.score:.4g}", f"V {vote.overlap:.3f}"]
        _caption(tile, MAP_PX, [response.matcher, *said])
    return canvas


class _Panel:
    """A patch scaled to fit the upper PANEL_PX of a canvas, centred on grey; things are drawn on it in image pixels."""

    def __init__(self, canvas: BgrImage, image: BgrImage | None, window: Window) -> None:
        self._origin = (window.x, window.y)
        self._scale, self._inside = _fit(canvas[:PANEL_PX], image, PANEL_PX)

    def ring(self, circle: Circle, colour: Bgr, thickness: int) -> None:
        _ring(self._inside, circle, self._origin, self._scale, (self._scale - 1) / 2, colour, thickness)

    def dots(self, points_px: npt.NDArray[np.float64], weights: npt.NDArray[np.float64]) -> None:
        places = (points_px - self._origin + 0.5) * self._scale - 0.5
        for (x, y), weight in zip(places.tolist(), np.clip(weights, 0, 1).tolist(), strict=True):
            colour = (60, int(255 * weight), int(255 * (1 - weight)))
            cv2.circle(self._inside, (round(x), round(y)), 2, colour, -1, cv2.LINE_AA)


def _fit(
    canvas: BgrImage, image: BgrImage | None, side_px: int, enlarge: int = cv2.INTER_NEAREST
) -> tuple[float, BgrImage]:
    """Put `image` into the middle of grey `canvas`, scaled to fit; give the scale and the part that it fills.

    Enlarged pixels stay squares where it matters which they are; as JPEG that takes twice the bytes.
    """
    canvas[:] = 40
    if image is None or image.size == 0:
        return 1.0, canvas
    height, width = image.shape[:2]
    scale = side_px / max(height, width)
    rows, columns = max(1, round(height * scale)), max(1, round(width * scale))
    how = enlarge if scale > 1 else cv2.INTER_AREA
    y, x = (side_px - rows) // 2, (side_px - columns) // 2
    inside = canvas[y : y + rows, x : x + columns]
    inside[:] = cv2.resize(image, (columns, rows), interpolation=how)
    return scale, inside


def _ring(
    canvas: BgrImage,
    circle: Circle,
    origin: tuple[int, int],
    scale: float,
    offset: float,
    colour: Bgr,
    thickness: int = 1,
) -> None:
    """Draw a circle of image pixels to a sixteenth of a canvas pixel."""
    x, y = ((circle.x_px - origin[0]) * scale + offset, (circle.y_px - origin[1]) * scale + offset)
    r = circle.r_px * scale
    if not math.isfinite(x + y + r) or max(abs(x), abs(y), r) > 10_000:
        return
    centre = (round(x * 16), round(y * 16))
    cv2.circle(canvas, centre, max(1, round(r * 16)), colour, thickness, cv2.LINE_AA, 4)


def _header(canvas: BgrImage, view: StageView, estimate: MarkerEstimate | None, colour: Bgr) -> None:
    if estimate is None:
        _text(canvas, view.marker, (6, LINE_PX - 2), colour, 0.5)
        return
    votes = "no votes" if estimate.vote_sum is None else f"votes {estimate.vote_sum:.2f} of 6"
    verdict = "no verdict" if estimate.verdict is None else f"verdict {estimate.verdict.value}"
    claimed = f"claim by {estimate.proposer}" if estimate.proposer else "no claim"
    line = f"{view.marker}  frame {estimate.frame_index}  {estimate.status.value}  {votes}  {verdict}  {claimed}"
    _text(canvas, line, (6, LINE_PX - 2), colour, 0.45)
    parts = []
    if estimate.reasons:
        parts.append(f"doubted: {', '.join(estimate.reasons)}")
    if estimate.circle is not None:
        parts.append("circle {:.2f} {:.2f} r {:.2f} px".format(*_xyr(estimate.circle)))
    if estimate.claim is not None and not estimate.status.measured:
        parts.append("claim (pink) {:.2f} {:.2f} r {:.2f} px".format(*_xyr(estimate.claim)))
    if estimate.visible is not None:
        parts.append(f"outline visible {estimate.visible:.0%}")
    if estimate.xyz_cam_m is not None:
        parts.append("xyz {:.3f} {:.3f} {:.3f} m".format(*estimate.xyz_cam_m.tolist()))
    _text(canvas, "   ".join(parts), (6, 2 * LINE_PX), _GREY, 0.4)


def _xyr(circle: Circle) -> tuple[float, float, float]:
    return circle.x_px, circle.y_px, circle.r_px


def _draw_map(canvas: BgrImage, response: ResponseMap) -> None:
    """The map in colour, stretched between its extremes, its best value bright and marked by a cross."""
    values = response.values.astype(np.float64)
    if not np.isfinite(values).all():
        np.nan_to_num(values, copy=False, posinf=0.0, neginf=0.0)
    if values.size == 0:
        canvas[:] = 40
        return
    low, high = float(values.min()), float(values.max())
    level = (values - low) / (high - low) if high > low else np.zeros_like(values)
    grey = np.rint(255 * (1 - level if response.best_is_low else level)).astype(np.uint8)
    scale, inside = _fit(canvas, _VIRIDIS.take(grey, axis=0), MAP_PX, cv2.INTER_LINEAR)
    x, y = (round((p + 0.5) * scale - 0.5) for p in response.peak)
    cv2.drawMarker(inside, (x, y), (0, 0, 0), cv2.MARKER_CROSS, 15, 3)
    cv2.drawMarker(inside, (x, y), (60, 60, 255), cv2.MARKER_CROSS, 13, 1)


def _caption_px(lines: int) -> int:
    return LINE_PX * lines + 4


def _caption(canvas: BgrImage, side_px: int, lines: Sequence[str]) -> None:
    """A thin frame around the upper `side_px` of a canvas, and lines of text under it."""
    canvas[0] = canvas[side_px - 1] = canvas[:side_px, 0] = canvas[:side_px, -1] = 90
    for row, line in enumerate(lines):
        below = canvas[side_px:]
        _text(below, line, (4, LINE_PX * (row + 1) - 4), _WHITE if row == 0 else _GREY, 0.4)


def _text(canvas: BgrImage, text: str, place: tuple[int, int], colour: Bgr, size: float = 0.45) -> None:
    (width, height), below = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, size, 1)
    x, y = place
    cv2.rectangle(canvas, (x - 2, y - height - 2), (x + width + 2, y + below), (0, 0, 0), -1)
    cv2.putText(canvas, text, place, cv2.FONT_HERSHEY_SIMPLEX, size, colour, 1, cv2.LINE_AA)


def _status_bgr(status: Status) -> Bgr:
    r, g, b = STATUS_RGB[status]
    return round(255 * b), round(255 * g), round(255 * r)


def _jpeg(image: BgrImage) -> EncodedPicture:
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return EncodedPicture(data.tobytes(), "jpeg", True)
