"""A frame gives patches, not pictures: planes stay as decoded until a window of them is asked for."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from spheremcap.core.circle import Circle

BgrImage = npt.NDArray[np.uint8]
"""(height, width, 3), blue-green-red, 0..255, gamma-encoded as in the video."""


@dataclass(frozen=True, slots=True)
class Window:
    """A rectangle of whole pixels: columns x..x+width-1, rows y..y+height-1. It may reach out of the picture."""

    x: int
    y: int
    width: int
    height: int

    @classmethod
    def around(cls, circle: Circle, half_px: float) -> "Window":
        """The smallest window that holds the square of half side `half_px` around the circle's centre."""
        x0, y0 = int(np.floor(circle.x_px - half_px)), int(np.floor(circle.y_px - half_px))
        x1, y1 = int(np.ceil(circle.x_px + half_px)), int(np.ceil(circle.y_px + half_px))
        return cls(x0, y0, x1 - x0 + 1, y1 - y0 + 1)

    def clipped(self, width_px: int, height_px: int) -> "Window":
        """The part inside a picture of this size; width or height 0 when nothing is inside."""
        x0, y0 = min(max(self.x, 0), width_px), min(max(self.y, 0), height_px)
        x1 = min(max(self.x + self.width, x0), width_px)
        y1 = min(max(self.y + self.height, y0), height_px)
        return Window(x0, y0, x1 - x0, y1 - y0)

    def holds(self, x_px: float, y_px: float) -> bool:
        """Whether the point lies on a pixel of the window."""
        return -0.5 <= x_px - self.x < self.width - 0.5 and -0.5 <= y_px - self.y < self.height - 0.5


@dataclass(frozen=True, slots=True)
class EncodedPicture:
    """One picture as a viewer gets it: `format` is h264 or h265 (one Annex B access unit) or jpeg."""

    data: bytes
    format: str
    key: bool


Plane = npt.NDArray[np.uint8]


class Planes(NamedTuple):
    """A picture's planes as they are in memory, read-only: luma `y` (height_px, width_px), chroma `u` and `v`, and
    `grid` (16,): chroma's step and origin in luma pixels (x step, y step, x origin, y origin), then the (3, 4) affine
    map from (y, u, v) to 8-bit (B, G, R), row by row. A BGR picture has its channels for planes."""

    y: Plane
    u: Plane
    v: Plane
    grid: npt.NDArray[np.float64]


_BGR_GRID = np.array([1, 1, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0], np.float64)


class Frame:
    """One picture of the source: when it was taken, how large it is, and any window of it as BGR.

    `index` counts pictures in presentation order from 0; `stamp_ns` is int nanoseconds on the recording's time
    line. Subclasses give `patch`; nothing else is asked of a source, but one that has more than a BGR picture gives
    `planes` too. `encoded` is the picture's own packet when the source can hand it on without encoding again.
    """

    encoded: EncodedPicture | None = None

    def __init__(self, index: int, stamp_ns: int, width_px: int, height_px: int) -> None:
        self.index = index
        self.stamp_ns = stamp_ns
        self.width_px = width_px
        self.height_px = height_px

    def patch(self, window: Window) -> BgrImage:
        """The window as (window.height, window.width, 3) BGR; outside the picture the border pixel repeats."""
        raise NotImplementedError

    def reduced(self, step: int) -> BgrImage:
        """The whole picture at 1/`step` size, sampled every `step`-th pixel from (step//2, step//2)."""
        return np.ascontiguousarray(self.full[step // 2 :: step, step // 2 :: step])

    @cached_property
    def planes(self) -> Planes:
        """What the compiled stages sample from; here the channels of the whole picture as BGR."""
        full = _read_only(self.full)
        return Planes(full[:, :, 0], full[:, :, 1], full[:, :, 2], _BGR_GRID)

    @cached_property
    def full(self) -> BgrImage:
        """The whole picture as (height_px, width_px, 3) BGR: costs a full conversion, so ask for a patch first."""
        return self.patch(Window(0, 0, self.width_px, self.height_px))


class BgrFrame(Frame):
    """A frame that is already a BGR picture, from wherever the caller has it."""

    def __init__(self, index: int, stamp_ns: int, image: BgrImage) -> None:
        if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
            raise ValueError(f"a BgrFrame takes (height, width, 3) uint8, not {image.shape} {image.dtype}")
        super().__init__(index, stamp_ns, image.shape[1], image.shape[0])
        self.image = _read_only(image)

    def patch(self, window: Window) -> BgrImage:
        return crop(self.image, window)

    @cached_property
    def full(self) -> BgrImage:
        return self.image


def _read_only(array: Plane) -> Plane:
    view = array.view()
    view.flags.writeable = False
    return view


def crop(plane: npt.NDArray[np.uint8], window: Window) -> npt.NDArray[np.uint8]:
    """Cut `window` out of a picture or plane; where it reaches outside, the border pixel repeats."""
    height, width = plane.shape[:2]
    inside = window.clipped(width, height)
    if (inside.width, inside.height) == (window.width, window.height):
        return plane[inside.y : inside.y + inside.height, inside.x : inside.x + inside.width].copy()
    rows = np.clip(np.arange(window.y, window.y + window.height), 0, height - 1)
    columns = np.clip(np.arange(window.x, window.x + window.width), 0, width - 1)
    return np.ascontiguousarray(plane[rows[:, None], columns])


class Patch:
    """A part of a frame at some scale, with the colour spaces the stages need, each made once when first asked for.

    `bgr` is (height, width, 3) uint8; its pixel (i, j) is the picture at (x0_px + j step_px, y0_px + i step_px).
    """

    def __init__(self, frame: Frame, window: Window) -> None:
        """The pixels of a window as they are."""
        self._place(frame, window.x, window.y, 1.0, frame.patch(window))

    @classmethod
    def scaled(cls, frame: Frame, bgr: BgrImage, x0_px: float, y0_px: float, step_px: float) -> "Patch":
        """Pixels that were cut from the frame at another scale (`core.sampling.cut_bgr`)."""
        self = cls.__new__(cls)
        self._place(frame, x0_px, y0_px, step_px, bgr)
        return self

    def _place(self, frame: Frame, x0_px: float, y0_px: float, step_px: float, bgr: BgrImage) -> None:
        self.x0_px, self.y0_px, self.step_px, self.bgr = float(x0_px), float(y0_px), step_px, bgr
        self._size_px = frame.width_px, frame.height_px

    @cached_property
    def picture(self) -> tuple[int, int, int, int]:
        """The part inside the picture as (x0, y0, x1, y1), half open, in patch coordinates."""
        height, width = self.bgr.shape[:2]
        x1 = math.floor((self._size_px[0] - 1 - self.x0_px) / self.step_px) + 1
        y1 = math.floor((self._size_px[1] - 1 - self.y0_px) / self.step_px) + 1
        x0, y0 = math.ceil(-self.x0_px / self.step_px), math.ceil(-self.y0_px / self.step_px)
        return min(max(x0, 0), width), min(max(y0, 0), height), min(max(x1, 0), width), min(max(y1, 0), height)

    @property
    def window(self) -> Window:
        """The picture's pixels that the patch covers."""
        height, width = self.bgr.shape[:2]
        x0, y0 = round(self.x0_px), round(self.y0_px)
        x1, y1 = round(self.x0_px + (width - 1) * self.step_px), round(self.y0_px + (height - 1) * self.step_px)
        return Window(x0, y0, x1 - x0 + 1, y1 - y0 + 1)

    @cached_property
    def hsv(self) -> npt.NDArray[np.uint8]:
        """(h, w, 3): hue 0..179 in steps of 2 degrees, saturation and value 0..255 (OpenCV's convention)."""
        return cv2.cvtColor(self.bgr, cv2.COLOR_BGR2HSV)  # type: ignore[return-value]

    @cached_property
    def gray(self) -> npt.NDArray[np.uint8]:
        """(h, w) luma 0..255."""
        return cv2.cvtColor(self.bgr, cv2.COLOR_BGR2GRAY)  # type: ignore[return-value]

    def local(self, circle: Circle) -> Circle:
        """A circle of the picture in patch coordinates."""
        step = self.step_px
        return Circle((circle.x_px - self.x0_px) / step, (circle.y_px - self.y0_px) / step, circle.r_px / step)

    def in_picture(self, circle: Circle) -> Circle:
        """A circle in patch coordinates as one of the picture."""
        step = self.step_px
        return Circle(self.x0_px + circle.x_px * step, self.y0_px + circle.y_px * step, circle.r_px * step)


_KR_KB = {"bt601": (0.299, 0.114), "bt709": (0.2126, 0.0722), "bt2020": (0.2627, 0.0593)}


def yuv_to_bgr_matrix(matrix: str, full_range: bool) -> npt.NDArray[np.float64]:
    """The (3, 4) affine map from 8-bit (Y, U, V) to 8-bit (B, G, R), by ITU-R BT.601, BT.709 or BT.2020.

    Limited range has luma 16..235 and chroma 16..240; full range uses 0..255 for both.
    """
    kr, kb = _KR_KB[matrix]
    kg = 1.0 - kr - kb
    luma, chroma, black = (1.0, 1.0, 0.0) if full_range else (255 / 219, 255 / 224, 16.0)
    cr = 2 * (1 - kr) * chroma
    cb = 2 * (1 - kb) * chroma
    rows = np.array(
        [[luma, cb, 0.0], [luma, -cb * kb / kg, -cr * kr / kg], [luma, 0.0, cr]],
    )
    offset = -rows @ np.array([black, 128.0, 128.0])
    return np.concatenate([rows, offset[:, None]], axis=1)


class YuvFrame(Frame):
    """A decoded video frame kept in its planes; only the windows asked for are turned into BGR.

    `y` is (height_px, width_px) uint8. `uv` is (rows, columns, 2) uint8 or two planes `(u, v)`; its sample (i, j)
    lies at luma column `uv_origin_px[0] + j * uv_step_px[0]`, and rows alike. A rotated picture is passed as
    rotated views (numpy.rot90), with the origin of the rotated chroma grid. `to_bgr` is from yuv_to_bgr_matrix.
    """

    def __init__(
        self,
        index: int,
        stamp_ns: int,
        y: npt.NDArray[np.uint8],
        uv: tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]],
        uv_step_px: tuple[int, int],
        uv_origin_px: tuple[float, float],
        to_bgr: npt.NDArray[np.float64],
    ) -> None:
        super().__init__(index, stamp_ns, y.shape[1], y.shape[0])
        self.y = y
        self.uv = uv
        self.uv_step_px = uv_step_px
        self.uv_origin_px = uv_origin_px
        self.to_bgr = to_bgr

    @cached_property
    def planes(self) -> Planes:
        grid = np.concatenate([self.uv_step_px, self.uv_origin_px, self.to_bgr.ravel()]).astype(np.float64)
        u, v = self.uv
        return Planes(_read_only(self.y), _read_only(u), _read_only(v), grid)

    def patch(self, window: Window) -> BgrImage:
        (sx, sy), (ox, oy) = self.uv_step_px, self.uv_origin_px
        # Chroma samples that surround the window, one more on each side for the interpolation.
        j0, i0 = int(np.floor((window.x - ox) / sx)), int(np.floor((window.y - oy) / sy))
        j1 = int(np.ceil((window.x + window.width - 1 - ox) / sx))
        i1 = int(np.ceil((window.y + window.height - 1 - oy) / sy))
        around = Window(j0, i0, j1 - j0 + 1, i1 - i0 + 1)
        chroma = [crop(plane, around) for plane in self.uv]
        if (sx, sy) != (1, 1) or (ox, oy) != (0.0, 0.0):
            # Output pixel (x, y) of the window lies at chroma coordinate (window.x + x - ox) / sx - j0.
            sample = np.array(
                [[1 / sx, 0, (window.x - ox) / sx - j0], [0, 1 / sy, (window.y - oy) / sy - i0]], np.float64
            )
            flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
            size = (window.width, window.height)
            chroma = [cv2.warpAffine(c, sample, size, flags=flags, borderMode=cv2.BORDER_REPLICATE) for c in chroma]  # type: ignore[misc]
        yuv = cv2.merge([crop(self.y, window), *chroma])
        return cv2.transform(yuv, self.to_bgr)  # type: ignore[return-value]

    def reduced(self, step: int) -> BgrImage:
        start = step // 2
        y = self.y[start::step, start::step]
        columns = np.arange(start, self.width_px, step)
        rows = np.arange(start, self.height_px, step)
        (sx, sy), (ox, oy) = self.uv_step_px, self.uv_origin_px
        j = np.clip(np.rint((columns - ox) / sx).astype(int), 0, self.uv[0].shape[1] - 1)
        i = np.clip(np.rint((rows - oy) / sy).astype(int), 0, self.uv[0].shape[0] - 1)
        chroma = [plane[i[:, None], j] for plane in self.uv]
        yuv = cv2.merge([np.ascontiguousarray(y), *chroma])
        return cv2.transform(yuv, self.to_bgr)  # type: ignore[return-value]
