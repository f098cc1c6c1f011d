"""Debug pictures: what the stages saw of a marker, and whole frames with every circle burnt in.

JPEG at a fixed quality, so that the same frame gives the same bytes. Colours are those of the annotations.
"""

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
JPEG_QUALITY = 90
LINE_PX = 17

_GREY: Bgr = (190, 190, 190)
_WHITE: Bgr = (255, 255, 255)
_HOUGH: Bgr = (255, 160, 60)
_CLAIM: Bgr = (255, 90, 255)


def stage_picture(view: StageView, estimate: MarkerEstimate | None) -> EncodedPicture:
    """One marker on one frame, for a person who asks why it was doubted.

    From the top: status, votes and verdict; the searched patch with Hough's circles, the claim and the
    final circle; the colour mask; the edge points, red (weight 0) to green (weight 1); the six response
    maps, bright where the matcher sees its best, the peak marked, with the matcher's score and its overlap
    V with the claim.
    """
    return _jpeg(draw_stages(view, estimate))


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


def draw_stages(view: StageView, estimate: MarkerEstimate | None) -> BgrImage:
    """The picture of `stage_picture` before encoding, (rows, 720, 3) BGR."""
    status = None if estimate is None else estimate.status
    final = None if estimate is None else estimate.circle
    claim = None if estimate is None else estimate.claim
    colour = _WHITE if status is None else _status_bgr(status)

    patch = _Panel(view.patch, view.window)
    for rank, circle in enumerate(view.hough):
        patch.ring(circle, _HOUGH, 1 if rank else 2)
    plain = _Panel(view.patch, view.window)
    if claim is not None and (status is None or not status.measured):
        patch.ring(claim, _CLAIM, 1)
        plain.ring(claim, _CLAIM, 1)
    if final is not None:
        patch.ring(final, colour, 1)
    mask = _Panel(cv2.cvtColor(view.mask, cv2.COLOR_GRAY2BGR) if view.mask is not None else None, view.window)  # type: ignore[arg-type]
    if final is not None:
        mask.ring(final, colour, 1)
    plain.dots(view.edges_px, view.edge_weights)

    covered = "not run" if view.mask is None else f"{np.count_nonzero(view.mask) / max(view.mask.size, 1):.0%}"
    panels = [
        (patch, f"patch {view.window.width}x{view.window.height}, Hough {len(view.hough)} (blue)"),
        (mask, f"colour mask {covered}"),
        (plain, f"edges {len(view.edges_px)}, weight red to green"),
    ]
    top = np.hstack([_captioned(panel.canvas, [caption]) for panel, caption in panels])
    blocks = [_header(view, estimate, colour), top]
    if view.responses:
        blocks.append(_responses(view.responses, estimate))
    return np.vstack(blocks)


class _Panel:
    """A patch scaled to fit PANEL_PX, centred on grey, that things are drawn on in image pixels."""

    def __init__(self, image: BgrImage | None, window: Window) -> None:
        self.canvas: BgrImage = np.full((PANEL_PX, PANEL_PX, 3), 40, np.uint8)
        self._origin = (window.x, window.y)
        self._scale, self._inside = _fit(self.canvas, image, PANEL_PX)

    def ring(self, circle: Circle, colour: Bgr, thickness: int) -> None:
        _ring(self._inside, circle, self._origin, self._scale, (self._scale - 1) / 2, colour, thickness)

    def dots(self, points_px: npt.NDArray[np.float64], weights: npt.NDArray[np.float64]) -> None:
        places = (points_px - self._origin + 0.5) * self._scale - 0.5
        for (x, y), weight in zip(places.tolist(), np.clip(weights, 0, 1).tolist(), strict=True):
            colour = (60, int(255 * weight), int(255 * (1 - weight)))
            cv2.circle(self._inside, (round(x), round(y)), 2, colour, -1, cv2.LINE_AA)


def _fit(canvas: BgrImage, image: BgrImage | None, side_px: int) -> tuple[float, BgrImage]:
    """Put `image` into the middle of `canvas`, scaled to fit; give the scale and the part that it fills."""
    if image is None or image.size == 0:
        return 1.0, canvas
    height, width = image.shape[:2]
    scale = side_px / max(height, width)
    rows, columns = max(1, round(height * scale)), max(1, round(width * scale))
    how = cv2.INTER_NEAREST if scale > 1 else cv2.INTER_AREA
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
    if not np.isfinite([x, y, r]).all() or max(abs(x), abs(y), r) > 10_000:
        return
    centre = (round(x * 16), round(y * 16))
    cv2.circle(canvas, centre, max(1, round(r * 16)), colour, thickness, cv2.LINE_AA, 4)


def _header(view: StageView, estimate: MarkerEstimate | None, colour: Bgr) -> BgrImage:
    canvas: BgrImage = np.zeros((2 * LINE_PX + 6, WIDTH_PX, 3), np.uint8)
    if estimate is None:
        _text(canvas, view.marker, (6, LINE_PX - 2), colour, 0.5)
        return canvas
    votes = "no votes" if estimate.vote_sum is None else f"votes {estimate.vote_sum:.2f} of 6"
    verdict = "no verdict" if estimate.verdict is None else f"verdict {estimate.verdict.value}"
    claimed = f"claim by {estimate.proposer}" if estimate.proposer else "no claim"
    line = f"{view.marker}  frame {estimate.frame_index}  {estimate.status.value}  {votes}  {verdict}  {claimed}"
    _text(canvas, line, (6, LINE_PX - 2), colour, 0.45)
    parts = []
    if estimate.circle is not None:
        parts.append("circle {:.2f} {:.2f} r {:.2f} px".format(*_xyr(estimate.circle)))
    if estimate.claim is not None and not estimate.status.measured:
        parts.append("claim (pink) {:.2f} {:.2f} r {:.2f} px".format(*_xyr(estimate.claim)))
    if estimate.visible is not None:
        parts.append(f"outline visible {estimate.visible:.0%}")
    if estimate.xyz_cam_m is not None:
        parts.append("xyz {:.3f} {:.3f} {:.3f} m".format(*estimate.xyz_cam_m.tolist()))
    _text(canvas, "   ".join(parts), (6, 2 * LINE_PX), _GREY, 0.4)
    return canvas


def _xyr(circle: Circle) -> tuple[float, float, float]:
    return circle.x_px, circle.y_px, circle.r_px


def _responses(responses: Sequence[ResponseMap], estimate: MarkerEstimate | None) -> BgrImage:
    votes = {} if estimate is None else {vote.matcher: vote for vote in estimate.votes}
    tiles = []
    for response in responses:
        vote = votes.get(response.matcher)
        lines = [response.matcher]
        lines += ["no vote", ""] if vote is None else [f"score {vote.score:.4g}", f"V {vote.overlap:.3f}"]
        tiles.append(_captioned(_response_map(response), lines))
    blank = np.zeros_like(tiles[0])
    tiles += [blank] * (-len(tiles) % 6)
    return np.vstack([np.hstack(tiles[i : i + 6]) for i in range(0, len(tiles), 6)])


def _response_map(response: ResponseMap) -> BgrImage:
    """The map in colour, stretched between its extremes, its best value bright and marked by a cross."""
    canvas: BgrImage = np.full((MAP_PX, MAP_PX, 3), 40, np.uint8)
    values = np.nan_to_num(response.values.astype(np.float64), posinf=0.0, neginf=0.0)
    if values.size == 0:
        return canvas
    low, high = float(values.min()), float(values.max())
    level = (values - low) / (high - low) if high > low else np.zeros_like(values)
    grey = np.rint(255 * (1 - level if response.best_is_low else level)).astype(np.uint8)
    scale, inside = _fit(canvas, cv2.applyColorMap(grey, cv2.COLORMAP_VIRIDIS), MAP_PX)  # type: ignore[arg-type]
    x, y = (round((p + 0.5) * scale - 0.5) for p in response.peak)
    cv2.drawMarker(inside, (x, y), (0, 0, 0), cv2.MARKER_CROSS, 15, 3)
    cv2.drawMarker(inside, (x, y), (60, 60, 255), cv2.MARKER_CROSS, 13, 1)
    return canvas


def _captioned(panel: BgrImage, lines: Sequence[str]) -> BgrImage:
    """The panel in a thin frame, with lines of text under it."""
    text: BgrImage = np.zeros((LINE_PX * len(lines) + 4, panel.shape[1], 3), np.uint8)
    for row, line in enumerate(lines):
        _text(text, line, (4, LINE_PX * (row + 1) - 4), _WHITE if row == 0 else _GREY, 0.4)
    panel[[0, -1]] = panel[:, [0, -1]] = 90
    return np.vstack([panel, text])


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
