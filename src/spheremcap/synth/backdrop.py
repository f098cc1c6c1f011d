"""What is behind the markers: drifting photographs that scikit-image ships, a racer's body. 8-bit sRGB."""

from collections.abc import Sequence
from functools import cache

import cv2
import numpy as np
import numpy.typing as npt

from spheremcap.core.camera import Camera
from spheremcap.core.frame import BgrImage
from spheremcap.errors import UsageError
from spheremcap.synth.kinematics import JOINTS, wave
from spheremcap.synth.parts import Athlete, Backdrop, Hoop, Vibration
from spheremcap.synth.pixels import cut, mean_of_four

FloatArray = npt.NDArray[np.float64]
PHOTOGRAPHS = ("motorcycle", "rocket", "coffee", "chelsea", "astronaut", "brick", "grass", "gravel")
_MARGIN_PX = 96
_LIMB_M = 0.29
"""About how long a forearm or an upper arm is."""
_CIRCLE = np.array([(np.cos(phi), np.sin(phi)) for phi in np.arange(24) * (2 * np.pi / 24)])


@cache
def photograph(name: str) -> BgrImage:
    """A photograph from scikit-image's wheel (no download), (height, width, 3) BGR."""
    try:
        from skimage import data
    except ImportError:
        raise UsageError("the photographs come with scikit-image: pip install 'spheremcap[synth]'") from None
    given = getattr(data, "stereo_motorcycle" if name == "motorcycle" else name)()
    image = given[0] if isinstance(given, tuple) else given
    if image.ndim == 2:
        image = np.repeat(image[..., None], 3, axis=2)
    return np.ascontiguousarray(image[..., ::-1])


class Canvas:
    """A photograph enlarged and mirrored until it fills the picture and its drift, cut out where it is at a
    time.
    """

    def __init__(self, backdrop: Backdrop, camera: Camera, vibration: Vibration) -> None:
        self.backdrop, self.camera, self.vibration = backdrop, camera, vibration
        photo = photograph(backdrop.photograph)
        size = [round(backdrop.enlarge * side) for side in photo.shape[1::-1]]
        large = cv2.resize(photo, size, interpolation=cv2.INTER_CUBIC)
        # Enlarging leaves no fine detail: a little gravel at its own scale puts some back.
        gravel = photograph("gravel")[..., 0].astype(np.float32) - 128
        self.margin = tuple(int(_MARGIN_PX + abs(d)) for d in backdrop.drift_px)
        height, width = camera.height_px + 2 * self.margin[1], camera.width_px + 2 * self.margin[0]
        top, left = max(0, (height - size[1]) // 2), max(0, (width - size[0]) // 2)
        wide = cv2.copyMakeBorder(
            large,
            top,
            max(0, height - size[1] - top),
            left,
            max(0, width - size[0] - left),
            cv2.BORDER_REFLECT_101,
        )
        y, x = (wide.shape[0] - height) // 2, (wide.shape[1] - width) // 2
        wide = wide[y : y + height, x : x + width].astype(np.float32)
        tiles = np.tile(gravel, (height // 512 + 1, width // 512 + 1))[:height, :width]
        wide = wide * backdrop.brightness + 0.05 * tiles[..., None]
        self.image: BgrImage = np.clip(wide, 0, 255).astype(np.uint8)

    def shift_px(self, t_s: float) -> tuple[float, float]:
        """Where the canvas has moved to, in pixels: its own drift and the mount's rotation."""
        t = np.array([t_s])
        turn, _ = self.vibration.at(t)
        dx = wave(t, self.backdrop.drift_px[0], self.backdrop.drift_hz[0])[0] + self.camera.fx_px * turn[0, 1]
        dy = wave(t, self.backdrop.drift_px[1], self.backdrop.drift_hz[1], 1.0)[0] - self.camera.fy_px * turn[0, 0]
        return float(dx), float(dy)

    def view(self, t_s: float, exposure_s: float) -> BgrImage:
        """The picture's backdrop (height, width, 3) BGR; a shift of over half a pixel while exposed is
        blurred.
        """
        first, last = self.shift_px(t_s - exposure_s / 2), self.shift_px(t_s + exposure_s / 2)
        if max(abs(first[0] - last[0]), abs(first[1] - last[1])) < 0.5:
            places = self._place(*self.shift_px(t_s)) * 2
        else:
            (x0, y0), (x1, y1) = first, last
            places = ()
            for f in (0.25, 0.75):
                places += self._place(x0 + f * (x1 - x0), y0 + f * (y1 - y0))
        height, width = self.camera.height_px, self.camera.width_px
        return cut(self.image.reshape(len(self.image), -1), *places, width, height).reshape(height, width, 3)

    def _place(self, dx: float, dy: float) -> tuple[float, ...]:
        """Where on the canvas the picture's first pixel is when the canvas has moved by (dx, dy)."""
        x, y = self.margin[0] - dx, self.margin[1] - dy
        return min(max(x, 0.0), 2.0 * self.margin[0] - 1), min(max(y, 0.0), 2.0 * self.margin[1] - 1)


class Body:
    """The racer, drawn as tapered limbs with three tones each: scenery for the markers, not a model of an
    arm.
    """

    _INSTANTS = 4

    def __init__(self, athlete: Athlete, camera: Camera, vibration: Vibration, row_s: float) -> None:
        self.athlete, self.camera, self.vibration, self.row_s = athlete, camera, vibration, row_s

    def draw(self, picture: BgrImage, t_s: float, exposure_s: float) -> BgrImage:
        """The picture with the body over it, its blur as the mean of a few instants of the exposure."""
        times = t_s + exposure_s * ((np.arange(self._INSTANTS) + 0.5) / self._INSTANTS - 0.5)
        joints = {name: self._joint(name, times) for name in JOINTS}
        drawn = np.stack([picture] * self._INSTANTS)
        for k in range(self._INSTANTS):
            lines = [(self._line(hoop, float(times[k])), hoop) for hoop in self.athlete.hoops]
            self._draw(drawn[k], {name: (at[k], scale) for name, (at, scale) in joints.items()}, lines)
        return mean_of_four(drawn.reshape(self._INSTANTS, len(picture), -1)).reshape(picture.shape)

    def _joint(self, name: str, times_s: FloatArray) -> tuple[FloatArray, float]:
        """A joint's pixels (T, 2) when the row it is on is exposed, NaN beyond the lens, and the pixels in a metre
        there.
        """
        late = 0.0
        for _ in range(3):
            t = times_s + late
            xyz = self.vibration.move(self.athlete.joint(name)(t), t)
            pixels = self.camera.project(xyz)
            row = float(np.clip(pixels[:, 1].mean(), -500, 1500))
            late = (row - (self.camera.height_px - 1) / 2) * self.row_s
        return pixels, self.camera.fx_px / float(np.linalg.norm(xyz[0]))

    def _line(self, hoop: Hoop, t_s: float) -> FloatArray:
        """A hoop's pixels (N, 2); NaN beyond the lens."""
        return self.camera.project(self.vibration.move(hoop.xyz_m, np.full(len(hoop.xyz_m), t_s)))

    def _draw(
        self,
        picture: BgrImage,
        joints: dict[str, tuple[FloatArray, float]],
        lines: Sequence[tuple[FloatArray, Hoop]],
    ) -> None:
        skin, jersey = self.athlete.skin[::-1], self.athlete.jersey[::-1]
        (left, scale), (right, _) = joints["left_shoulder"], joints["right_shoulder"]
        neck = (left + right) / 2
        waist = np.array([[-0.14, 0.62], [0.14, 0.62]]) * scale
        trunk = np.stack([left, right, *(neck + waist)])
        for tone, wide in ((0.75, 1.0), (1.0, 0.8)):
            middle = trunk.mean(axis=0)
            _fill(picture, (trunk - middle) * (wide, 1.0) + middle, [c * tone for c in jersey])
        for line, hoop in lines:
            thick_px = hoop.thick_m * self.camera.fx_px / float(np.linalg.norm(hoop.xyz_m, axis=1).mean())
            _outline(picture, line, thick_px, hoop.colour[::-1])
        for side in ("left", "right"):
            shoulder, elbow, wrist = (joints[f"{side}_{j}"] for j in ("shoulder", "elbow", "wrist"))
            for (p, at_p), (q, at_q), thick, colour in (
                (shoulder, elbow, (0.058, 0.044), jersey), (elbow, wrist, (0.044, 0.032), skin),
            ):  # fmt: skip
                for tone, wide in ((0.62, 1.0), (0.85, 0.78), (1.0, 0.45)):
                    _limb(
                        picture,
                        p,
                        q,
                        thick[0] * wide * at_p,
                        thick[1] * wide * at_q,
                        [c * tone for c in colour],
                    )
            for end, other, radius in ((shoulder, elbow, 0.056), (elbow, shoulder, 0.045), (wrist, elbow, 0.034)):
                if self.athlete.strap_m:
                    _strap(picture, end[0], other[0], radius * end[1], self.athlete.strap_m)
            forearm = wrist[0] - elbow[0]
            hand = wrist[0] + forearm / max(float(np.linalg.norm(forearm)), 1.0) * 0.06 * wrist[1]
            _limb(picture, wrist[0], hand, 0.036 * wrist[1], 0.042 * wrist[1], (34, 30, 30))
        if not np.isfinite(neck).all():  # beyond the lens
            return
        head = neck - (0.0, 0.13 * scale)
        axes = np.array([0.075, 0.1]) * scale * 1.15
        for centre, size, colour in (
            (head, axes, skin),
            (head - (0, 0.045 * scale), axes * (1.12, 0.72), (196, 190, 186)),
        ):
            cv2.ellipse(
                picture,
                _fixed(centre),
                _fixed(size),
                0,
                0,
                360,
                [float(c) for c in colour],
                -1,
                cv2.LINE_AA,
                4,
            )


def _fixed(point: FloatArray) -> tuple[int, int]:
    """A point in OpenCV's fixed-point pixels with four fractional bits."""
    x, y = np.rint(np.clip(point, -4000, 6000) * 16).astype(int)
    return int(x), int(y)


def _fill(picture: BgrImage, corners: FloatArray, colour: Sequence[float]) -> None:
    if not np.isfinite(corners).all():  # beyond the lens
        return
    points = np.rint(corners.clip(-4000, 6000) * 16).astype(np.int32)
    cv2.fillConvexPoly(picture, cv2.convexHull(points), colour, cv2.LINE_AA, 4)


def _outline(picture: BgrImage, line: FloatArray, thick_px: float, colour: Sequence[float]) -> None:
    """A closed line (N, 2) in pixels."""
    if np.isfinite(line).all():
        points = np.rint(line.clip(-4000, 6000) * 16).astype(np.int32)
        cv2.polylines(picture, [points], True, colour, max(1, round(thick_px)), cv2.LINE_AA, 4)


def _strap(picture: BgrImage, end: FloatArray, other: FloatArray, radius_px: float, wide_m: float) -> None:
    """A dark band square to the limb from `end` to `other` (2,), at its end; it is foreshortened as the limb is."""
    limb = other - end
    along = limb * (wide_m / 2 / _LIMB_M)
    across = np.array([-limb[1], limb[0]]) * (radius_px / max(float(np.linalg.norm(limb)), 1.0))
    for tone, wide in ((20, 1.06), (40, 0.6)):
        corners = [end + p * along + q * wide * across for p, q in ((1, 1), (1, -1), (-1, -1), (-1, 1))]
        _fill(picture, np.array(corners), [tone] * 3)


def _limb(picture: BgrImage, p: FloatArray, q: FloatArray, rp: float, rq: float, colour: Sequence[float]) -> None:
    """A tapered capsule from p to q (2,) with the radii rp and rq, in pixels."""
    _fill(picture, np.concatenate([p + rp * _CIRCLE, q + rq * _CIRCLE]), colour)
