"""A printed board's corners in one picture, and the camera that pictures of it in many poses give.

The board's plane is z = 0 with the origin in its middle, x along a row of squares and y down the columns, metres. A
square's true size does not change a focal length: it only says how far away the board was.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import cv2
import numpy as np
import numpy.typing as npt

from spheremcap.core.camera import Camera
from spheremcap.core.stage import length_m
from spheremcap.errors import UsageError, short

FloatArray = npt.NDArray[np.float64]
Grey = npt.NDArray[np.uint8]
Model = Literal["plumb_bob", "rational", "fisheye"]

DICTIONARIES: dict[str, int] = dict(
    sorted(((n, getattr(cv2.aruco, n)) for n in dir(cv2.aruco) if n.startswith("DICT_")), key=lambda pair: pair[1])
)
"""OpenCV's numbers of the dictionaries, of a family the smallest first."""
_USUAL = "DICT_4X4_50"
_FORM = (
    "checkerboard:COLUMNSxROWS:SQUARE or charuco:COLUMNSxROWS:SQUARE:MARKER[:DICTIONARY], squares counted, as in "
    "checkerboard:10x7:25mm or charuco:7x5:30mm:22mm:DICT_4X4_50"
)
_MOST_SQUARES = 50
_MOST_VIEWS = 60
"""So many views are fitted: more add time, and hardly a new pose."""
_FEWEST_VIEWS = 10
_FEWEST_CORNERS, _FEWEST_MARKERS = 6, 4
_GROUPS, _STEPS = 20, 15
_CELLS = (8, 6)
"""Cells of the picture, across and down, that are counted as covered."""

# Where a calibration is refused. As simulated (`python benchmarks/board.py`): tilted by up to 10 degrees to all sides
# the focal length is known to 1 %, from the front only there is none; with corners in 64 % of the picture its edges are
# good to 5 px of 1280, in 31 % to 37.
_LEAST_COVERED = 0.6
_LEAST_TILT_DEG = 10.0
_TILT = "tilt the board by 30 to 45 degrees to all four sides"
_MOST_RMS = 1e-3  # of the picture's width
_MOST_FOCAL_SD = 0.01
_ODD, _TOLD = 3.0, 3.0


# --- what was printed ---


@dataclass(frozen=True)
class Board:
    """A printed board of `columns` x `rows` squares; `marker_m` and `dictionary` are a ChArUco board's, else 0
    and ""."""

    columns: int
    rows: int
    square_m: float
    marker_m: float = 0.0
    dictionary: str = ""
    legacy: bool = False
    """A ChArUco board with an even number of rows as OpenCV before 4.6 drew it, a white square in the corner."""

    @classmethod
    def of(cls, text: str) -> "Board":
        """The board that a text such as "charuco:7x5:30mm:22mm" describes. Raises UsageError."""
        kind, *rest = text.split(":")
        wanted = f"--board {short(text)}: expected {_FORM}"
        if (kind, len(rest)) not in (("checkerboard", 2), ("charuco", 3), ("charuco", 4)):
            raise UsageError(wanted)
        columns, by, rows = rest[0].partition("x")
        try:
            square_m, marker_m = [*map(length_m, rest[1:3]), 0.0][:2]
            board = cls(int(columns), int(rows), square_m, marker_m)
        except ValueError:
            raise UsageError(wanted) from None
        if not (by and min(board.columns, board.rows) >= 3 and max(board.columns, board.rows) <= _MOST_SQUARES):
            raise UsageError(f"--board {short(text)}: a board has 3 to {_MOST_SQUARES} squares each way")
        if not board.square_m > 0:
            raise UsageError(f"--board {short(text)}: a square of no size")
        if kind == "checkerboard":
            return board
        name = (rest[3] if len(rest) == 4 else _USUAL).upper()
        board = replace(board, dictionary=name if name.startswith("DICT_") else f"DICT_{name}")
        if board.dictionary not in DICTIONARIES:
            raise UsageError(f"--board: unknown dictionary {short(name)}; there are: {', '.join(DICTIONARIES)}")
        if not 0 < board.marker_m < board.square_m:
            raise UsageError(f"--board {short(text)}: a marker is smaller than its square, {rest[1]} here")
        held, needed = len(board.markers.bytesList), board.columns * board.rows // 2
        if needed > held:
            raise UsageError(
                f"--board: {board.dictionary} has {held} markers, {board.columns}x{board.rows} squares need {needed}: "
                "choose a larger dictionary"
            )
        return board

    def __str__(self) -> str:
        size, square = f"{self.columns}x{self.rows}", f"{self.square_m * 1e3:g}mm"
        if not self.dictionary:
            return f"checkerboard:{size}:{square}"
        return f"charuco:{size}:{square}:{self.marker_m * 1e3:g}mm:{self.dictionary}"

    @property
    def markers(self) -> cv2.aruco.Dictionary:
        """A ChArUco board's markers."""
        return cv2.aruco.getPredefinedDictionary(DICTIONARIES[self.dictionary])

    @cached_property
    def charuco(self) -> cv2.aruco.CharucoBoard:
        """A ChArUco board as OpenCV has it."""
        drawn = cv2.aruco.CharucoBoard((self.columns, self.rows), self.square_m, self.marker_m, self.markers)
        drawn.setLegacyPattern(self.legacy)
        return drawn

    @cached_property
    def _detector(self) -> cv2.aruco.CharucoDetector:
        return cv2.aruco.CharucoDetector(self.charuco)

    @cached_property
    def corners_m(self) -> FloatArray:
        """The inner corners (N, 3), row by row."""
        y, x = np.mgrid[1 : self.rows, 1 : self.columns]
        x, y = x - self.columns / 2, y - self.rows / 2
        return np.stack([x, y, np.zeros_like(x)], axis=2).reshape(-1, 3) * self.square_m

    def find(self, grey: Grey) -> tuple[FloatArray, FloatArray] | None:
        """The board's corners (N, 3) m that are seen, and where (N, 2) px; None where the board is not found.

        Of a checkerboard all are seen or none, of a ChArUco board as many as are in the picture.
        """
        if not self.dictionary:
            found, seen = cv2.findChessboardCornersSB(grey, (self.columns - 1, self.rows - 1))
            return (self.corners_m, np.asarray(seen, np.float64).reshape(-1, 2)) if found else None
        seen, ids, _, _ = self._detector.detectBoard(grey)
        if ids is None or len(ids) < _FEWEST_CORNERS:
            return None
        own = self.corners_m[np.asarray(ids).ravel()]
        if min(np.ptp(own[:, :2], axis=0)) < self.square_m / 2:  # all on one line
            return None
        return own, np.asarray(seen, np.float64).reshape(-1, 2)


def other_board(greys: Iterable[Grey], board: Board) -> Board | None:
    """Another board than `board`, which none of the pictures shows, that one of them does show; None if none is known.

    Of a checkerboard: one whose inner corners or sides were counted for squares. Of a ChArUco board: any size, and any
    dictionary.
    """
    c, r = board.columns, board.rows
    sizes = [(c + 1, r + 1), (r, c), (r + 1, c + 1), (c, r + 1), (c + 1, r), (c, r - 1), (c - 1, r), (c - 1, r - 1)]
    for grey in greys:
        if not board.dictionary:
            tried = [replace(board, columns=c, rows=r) for c, r in sizes if min(c, r) >= 3]
        else:
            tried = _other_charuco(grey, board)
        for other in tried:
            if other.find(grey) is not None:
                return other
    return None


def _other_charuco(grey: Grey, board: Board) -> list[Board]:
    """Boards with as many markers as the picture shows and more, smallest first; in the board's own dictionary, else in
    that of which the picture shows most."""
    shown = {board.dictionary: _shown(grey, board.dictionary)}
    if shown[board.dictionary] < _FEWEST_MARKERS:
        shown |= {name: _shown(grey, name) for name in DICTIONARIES}
    best = max(shown, key=lambda name: shown[name])  # the first, as larger ones of a family hold it
    least = shown[best]
    if least < _FEWEST_MARKERS:
        return []
    own = replace(board, dictionary=best)
    most = min(2 * least, len(own.markers.bytesList))
    sizes = [(c, r) for c in range(3, _MOST_SQUARES) for r in range(3, _MOST_SQUARES) if least <= c * r // 2 <= most]
    return [
        replace(own, columns=c, rows=r, legacy=legacy)
        for c, r in sorted(sizes, key=lambda size: size[0] * size[1])
        for legacy in ((False, True) if r % 2 == 0 else (False,))
    ]


def _shown(grey: Grey, dictionary: str) -> int:
    """How many different markers of a dictionary a picture shows."""
    known = cv2.aruco.getPredefinedDictionary(DICTIONARIES[dictionary])
    _, ids, _ = cv2.aruco.ArucoDetector(known).detectMarkers(grey)
    return 0 if ids is None else len(set(np.ravel(ids).tolist()))


# --- which views ---


@dataclass(frozen=True)
class View:
    """The board on one frame: corners `board_m` (N, 3) of its plane, seen at `image_px` (N, 2)."""

    frame_index: int
    board_m: FloatArray
    image_px: FloatArray

    def pose(self, board: Board, width_px: int) -> FloatArray | None:
        """Where, how large and how tilted the board is, (5,), without a camera: centre and logarithm of the size in
        the picture, and how much nearer one side is than the other. None where the corners fit no plane."""
        wide, high = board.columns * board.square_m, board.rows * board.square_m
        unit = self.board_m[:, :2] / (wide, high)
        h, _ = cv2.findHomography(unit, self.image_px / width_px)
        if h is None:
            return None
        size = np.abs(np.linalg.det(h[:2, :2] - np.outer(h[:2, 2], h[2, :2])))
        return np.array([*h[:2, 2], np.log(max(size, 1e-12)) / 4, *h[2, :2]])


def differing(views: Sequence[View], board: Board, width_px: int, most: int = _MOST_VIEWS) -> list[View]:
    """At most `most` of the views, in their order: each next one is that which differs most from all chosen."""
    posed = [(view, pose) for view in views if (pose := view.pose(board, width_px)) is not None]
    if not posed:
        return []
    poses = np.array([pose for _, pose in posed])
    chosen = [int(np.argmax(np.linalg.norm(poses - np.median(poses, axis=0), axis=1)))]
    far = np.linalg.norm(poses - poses[chosen[0]], axis=1)
    while len(chosen) < most and far.max() > 0.02:
        chosen.append(int(far.argmax()))
        far = np.minimum(far, np.linalg.norm(poses - poses[chosen[-1]], axis=1))
    return [posed[index][0] for index in sorted(chosen)]


# --- the camera ---


@dataclass(frozen=True)
class Calibrated:
    """A camera, and how well it is known. `camera.focal_sd` is the larger of the two focal lengths' relative ones.

    `sd` are standard deviations by name (fx, fy, cx, cy, then the distortion's), from leaving out a part of the views
    at a time: errors that all corners of a view share are in it, those that all views share (a board that is printed
    wider than high) are not. `residuals_px` (N, 2) is seen minus fitted at `image_px` (N, 2), all views one after
    another. `tilt_deg` are the angles between the board and the picture's plane, one a view. `covered` is the share of
    the picture's cells with a corner. `odd` counts views left out since they fit so much worse than the others.
    `bend_m` is how far the board is from flat, which was found with the camera.
    """

    camera: Camera
    values: dict[str, float]
    sd: dict[str, float]
    rms_px: float
    views: tuple[View, ...]
    image_px: FloatArray
    residuals_px: FloatArray
    tilt_deg: FloatArray
    covered: float
    odd: int
    bend_m: float


_NAMES: dict[Model, tuple[str, ...]] = {
    "plumb_bob": ("k1", "k2", "p1", "p2", "k3"),
    "rational": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "fisheye": ("k1", "k2", "k3", "k4"),
}


def solve(views: Sequence[View], width_px: int, height_px: int, model: Model) -> Calibrated | str:
    """The camera that the views give, or in a sentence why they give none: what was found, and what to film instead.

    Of plumb_bob's coefficients k3 is left out where it cannot be told from zero: it would bend the picture's edges.
    """
    size = (width_px, height_px)
    found = _solved_with(views, size, _NAMES[model])
    if model == "plumb_bob" and isinstance(found, Calibrated) and abs(found.values["k3"]) < _TOLD * found.sd["k3"]:
        return _solved_with(views, size, _NAMES[model][:-1])
    return found


def _solved_with(views: Sequence[View], size: tuple[int, int], names: tuple[str, ...]) -> Calibrated | str:
    """`solve`, with the distortion's coefficients of these names."""
    width_px, height_px = size
    if len(views) < _FEWEST_VIEWS:
        return (
            f"the board is seen in {len(views)} different poses, at least {_FEWEST_VIEWS} are needed: film it for half "
            "a minute, moving and tilting it slowly"
        )
    image_px = np.concatenate([view.image_px for view in views])
    covered = _covered(image_px, width_px, height_px)
    if covered < _LEAST_COVERED:
        return (
            f"the board's corners are in {covered:.0%} of the picture, of {_LEAST_COVERED:.0%} at least distortion can "
            "be told: film it in every corner of the picture too, or from nearer"
        )
    try:
        flat = _fitted(views, size, names)
        tilt = float(np.percentile(flat.tilt_deg, 90))
        if tilt < _LEAST_TILT_DEG:
            return (
                f"the board was tilted by {tilt:.0f} degrees at most, {_LEAST_TILT_DEG:.0f} at least are needed: from "
                f"the front a near board looks like a far one through a longer lens; {_TILT}"
            )
        fit = _refined(flat)
        rms = np.array([np.sqrt((r**2).sum(axis=1).mean()) for r in fit.residuals_px])
        kept = [view for view, own in zip(views, rms, strict=True) if own <= _ODD * np.median(rms)]
        odd = len(views) - len(kept)
        if odd:
            fit = _refined(_fitted(kept, size, names))
        sd = _deviations(fit)
    except (cv2.error, np.linalg.LinAlgError) as error:
        return f"no camera fits the views ({short(error)}): was the zoom always the same? {_TILT}"
    residuals_px = np.concatenate(fit.residuals_px)
    rms_px = float(np.sqrt((residuals_px**2).sum(axis=1).mean()))
    if not rms_px <= _MOST_RMS * width_px:
        return (
            f"the corners are {rms_px:.2f} px beside where a camera would see them, {_MOST_RMS * width_px:.2f} px are "
            "expected at most: is the board flat, stabilisation and zoom off, and the board moved slowly?"
        )
    numbers = fit.own[:-3]
    focal_sd = float(max(sd[0] / numbers[0], sd[1] / numbers[1]))
    if not focal_sd <= _MOST_FOCAL_SD:
        return (
            f"the focal length is known to {focal_sd:.1%}, {_MOST_FOCAL_SD:.0%} at most is of use: film more poses, "
            f"and fill the picture; {_TILT}"
        )
    try:
        camera = Camera(
            width_px, height_px, float(numbers[0]), float(numbers[1]), float(numbers[2]), float(numbers[3]),
            "fisheye" if names == _NAMES["fisheye"] else "plumb_bob", tuple(numbers[4:].tolist()), focal_sd, "a board",
        )  # fmt: skip
    except ValueError as error:
        return f"what fits the views is no camera ({error}): was the zoom always the same?"
    known = ("fx", "fy", "cx", "cy", *names)
    return Calibrated(
        camera, dict(zip(known, numbers.tolist(), strict=True)),
        dict(zip(known, sd[:-3].tolist(), strict=True)), rms_px,
        tuple(kept), np.concatenate([view.image_px for view in kept]), residuals_px, fit.tilt_deg, covered, odd,
        float(np.ptp(_bend(np.concatenate([view.board_m for view in kept]), fit.own[-3:])[:, 2])),
    )  # fmt: skip


def _covered(image_px: FloatArray, width_px: int, height_px: int) -> float:
    """The share of the picture's cells that have a corner."""
    cells = np.floor(image_px / (width_px, height_px) * _CELLS).astype(int)
    cells = np.clip(cells, 0, np.array(_CELLS) - 1)
    return len({tuple(cell) for cell in cells.tolist()}) / (_CELLS[0] * _CELLS[1])


@dataclass(frozen=True)
class _Fit:
    """`own` are fx, fy, cx, cy, the distortion's coefficients and the board's bend (3,), `poses` (V, 6) a turn
    (Rodrigues) and a shift of each view."""

    views: Sequence[View]
    names: tuple[str, ...]
    own: FloatArray
    poses: FloatArray

    @property
    def tilt_deg(self) -> FloatArray:
        """The angle between the board and the picture's plane, of each view."""
        return np.array([np.degrees(np.arccos(min(1.0, abs(cv2.Rodrigues(pose[:3])[0][2, 2])))) for pose in self.poses])

    @property
    def residuals_px(self) -> list[FloatArray]:
        return [
            view.image_px - self._seen(view, self.own, pose) for view, pose in zip(self.views, self.poses, strict=True)
        ]

    def parts(self) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
        """Of each view its residuals (2N,), and how what is seen changes with `own` and with the pose."""
        return [
            (
                (view.image_px - self._seen(view, self.own, pose)).ravel(),
                _slopes(lambda own, view=view, pose=pose: self._seen(view, own, pose), self.own),  # type: ignore[misc]
                _slopes(lambda pose, view=view: self._seen(view, self.own, pose), pose),  # type: ignore[misc]
            )
            for view, pose in zip(self.views, self.poses, strict=True)
        ]

    def _seen(self, view: View, own: FloatArray, pose: FloatArray) -> FloatArray:
        k = np.array([[own[0], 0, own[2]], [0, own[1], own[3]], [0, 0, 1]])
        bent_m = view.board_m + _bend(view.board_m, own[-3:])
        project = cv2.fisheye.projectPoints if self.names == _NAMES["fisheye"] else cv2.projectPoints
        seen: FloatArray = np.asarray(project(bent_m[:, None], pose[:3], pose[3:], k, own[4:-3])[0], np.float64)
        return seen.reshape(-1, 2)


_UNIT_M = 0.1


def _bend(board_m: FloatArray, bend_m: FloatArray) -> FloatArray:
    """How far the board's points (N, 3) are off its plane, (0, 0, z) each: a parabola along x, one along y, a twist,
    each in metres 0.1 m from the middle."""
    x, y = board_m[:, 0] / _UNIT_M, board_m[:, 1] / _UNIT_M
    bent: FloatArray = np.zeros((len(x), 3))
    bent[:, 2] = np.stack([x * x, y * y, x * y], axis=1) @ bend_m
    return bent


def _slopes(f: Callable[[FloatArray], FloatArray], at: FloatArray) -> FloatArray:
    """The derivatives of a function of (n,) in columns, by differences to both sides."""
    columns = []
    for index, value in enumerate(at):
        step = np.zeros(len(at))
        step[index] = 1e-6 * max(1.0, abs(value))
        columns.append((f(at + step) - f(at - step)).ravel() / (2 * step[index]))
    return np.asarray(np.stack(columns, axis=1), np.float64)


def _fitted(views: Sequence[View], size: tuple[int, int], names: tuple[str, ...]) -> _Fit:
    """OpenCV's camera for a flat board. Raises cv2.error."""
    if names == _NAMES["fisheye"]:
        own = [view.board_m[None] for view in views]
        seen = [view.image_px[None] for view in views]
        flags = cv2.CALIB_RECOMPUTE_EXTRINSIC | cv2.CALIB_FIX_SKEW
        _, k, d, turns, shifts = cv2.fisheye.calibrate(own, seen, size, np.eye(3), np.zeros(4), flags=flags)
    else:
        own = [view.board_m.astype(np.float32) for view in views]
        seen = [view.image_px.astype(np.float32) for view in views]
        flags = cv2.CALIB_RATIONAL_MODEL if "k4" in names else 0 if "k3" in names else cv2.CALIB_FIX_K3
        _, k, d, turns, shifts = cv2.calibrateCamera(own, seen, size, None, None, flags=flags)  # type: ignore[call-overload]
    coefficients = np.ravel(d)[: len(names)]
    poses = np.array([[*np.ravel(turn), *np.ravel(shift)] for turn, shift in zip(turns, shifts, strict=True)])
    return _Fit(views, names, np.array([k[0, 0], k[1, 1], k[0, 2], k[1, 2], *coefficients, 0, 0, 0]), poses)


def _normal(fit: _Fit) -> tuple[list[FloatArray], list[FloatArray], list[tuple[FloatArray, FloatArray, FloatArray]]]:
    """Of each view its part of the normal equations of `own`, its pose eliminated: matrix and right hand side."""
    parts = fit.parts()
    matrices, sides = [], []
    for residuals, by_own, by_pose in parts:
        q, _ = np.linalg.qr(by_pose)
        free = by_own - q @ (q.T @ by_own)
        matrices.append(free.T @ free)
        sides.append(free.T @ residuals)
    return matrices, sides, parts


def _refined(fit: _Fit) -> _Fit:
    """The fit with the board's bend (Gauss and Newton). Raises LinAlgError where the views do not determine it."""
    for _ in range(_STEPS):
        matrices, sides, parts = _normal(fit)
        step = _solved(sum(matrices), sum(sides))  # type: ignore[arg-type]
        moved = np.array([np.linalg.lstsq(by_pose, r - by_own @ step)[0] for r, by_own, by_pose in parts])
        fit = replace(fit, own=fit.own + step, poses=fit.poses + moved)
        if abs(step[0]) < 1e-6 * fit.own[0]:
            break
    return fit


def _solved(matrix: FloatArray, side: FloatArray) -> FloatArray:
    """The normal equations' solution, their unknowns scaled alike."""
    scale = 1 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    solution: FloatArray = scale * np.linalg.solve(matrix * scale * scale[:, None], scale * side)
    return solution


def _deviations(fit: _Fit) -> FloatArray:
    """Standard deviations of `own`, by the jackknife: how far a step goes when a part of the views is left out."""
    matrices, sides, _ = _normal(fit)
    groups = np.array_split(np.arange(len(sides)), min(len(sides), _GROUPS))
    whole, side = np.sum(matrices, axis=0), np.sum(sides, axis=0)
    steps = np.array([
        _solved(whole - np.sum([matrices[i] for i in group], axis=0), side - np.sum([sides[i] for i in group], axis=0))
        for group in groups
    ])  # fmt: skip
    sd: FloatArray = np.sqrt((len(groups) - 1) / len(groups) * ((steps - steps.mean(axis=0)) ** 2).sum(axis=0))
    return sd


# --- to look at ---

_DARK, _CELL, _EMPTY = (30, 30, 30), (60, 60, 60), (40, 40, 120)
_DOT, _ARROW, _CENTRE, _WHITE = (200, 160, 60), (90, 220, 255), (255, 90, 255), (255, 255, 255)
_LONG_PX = 15
"""So long is the arrow of a usual residual."""


def draw(found: Calibrated) -> npt.NDArray[np.uint8]:
    """Where in the picture corners were (dots; cells without any are red), by how much and whereto they are beside
    where the camera sees them (lines, enlarged), and the principal point (a cross). BGR, at most 1280 wide."""
    camera = found.camera
    scale = min(1.0, 1280 / camera.width_px)
    canvas = np.full((round(camera.height_px * scale) + 26, round(camera.width_px * scale), 3), _DARK, np.uint8)
    height, width = canvas.shape[0] - 26, canvas.shape[1]
    places = (found.image_px + 0.5) * scale - 0.5
    columns, rows = _CELLS
    for row in range(rows):
        for column in range(columns):
            x0, x1 = round(column * width / columns), round((column + 1) * width / columns)
            y0, y1 = round(row * height / rows), round((row + 1) * height / rows)
            inside = (places >= (x0 - 0.5, y0 - 0.5)) & (places < (x1 - 0.5, y1 - 0.5))
            if not inside.all(axis=1).any():
                cv2.rectangle(canvas, (x0, y0), (x1, y1), _EMPTY, -1)
            cv2.rectangle(canvas, (x0, y0), (x1, y1), _CELL, 1)
    enlarged = _LONG_PX / max(found.rms_px, 1e-3)
    for (x, y), (dx, dy) in zip(places.tolist(), (found.residuals_px * enlarged).tolist(), strict=True):
        start, end = (round(x * 16), round(y * 16)), (round((x + dx) * 16), round((y + dy) * 16))
        cv2.line(canvas, start, end, _ARROW, 1, cv2.LINE_AA, 4)
        cv2.circle(canvas, start, 24, _DOT, -1, cv2.LINE_AA, 4)
    centre = (round((camera.cx_px + 0.5) * scale - 0.5), round((camera.cy_px + 0.5) * scale - 0.5))
    cv2.drawMarker(canvas, centre, _CENTRE, cv2.MARKER_CROSS, 20, 1, cv2.LINE_AA)
    said = (
        f"{len(found.views)} views, rms {found.rms_px:.2f} px, lines {enlarged / scale:.0f} times as long as they are"
    )
    cv2.putText(canvas, said, (6, height + 18), cv2.FONT_HERSHEY_SIMPLEX, 0.5, _WHITE, 1, cv2.LINE_AA)
    return canvas
