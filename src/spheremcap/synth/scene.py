"""A scene gives pictures and their exact truth, frame by frame.

Time. A frame's stamp is the middle of the exposure of the picture's middle row, in ns from the first frame's;
it is what the container says. With a rolling shutter every other row is exposed earlier or later, so all of a
marker's truth (circle, ellipse, 3D centre, velocity) is of the instant at which the row of its own centre is
half exposed: position and circle belong together, as seen. Blur does not move it: it is the outline at
mid-exposure, not the streak.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import cv2
import numpy as np
import numpy.typing as npt

from spheremcap.core.circle import Circle
from spheremcap.core.frame import BgrImage, Window
from spheremcap.synth.backdrop import Body, Canvas, photograph
from spheremcap.synth.outline import polygon_ellipse, seen_outline
from spheremcap.synth.parts import Ball, Card, World
from spheremcap.synth.pixels import develop, paint_ball, paint_card, yuv420
from spheremcap.synth.raster import (
    Image,
    linear_bgr,
    to_linear,
    to_srgb,
)
from spheremcap.synth.truth import Container, MarkerTruth, Rendered

FloatArray = npt.NDArray[np.float64]
_STEP_PX = 0.45
_MOST_STEPS = 64
_WIDEST_RAD = float(np.radians(80))
_NOISE_SLACK = 48
MEGABITS = 60
"""Bit rate of an action camera at 1280x720 and 240 frames/s, in Mbit/s."""


@dataclass(frozen=True, slots=True)
class _Layer:
    """A ball or card on one frame: the box of pixels it touches while exposed, its range and motion."""

    what: Ball | Card
    box: tuple[int, int, int, int]  # x0, y0, x1, y1, exclusive at the end
    depth_m: float
    motion_px: float


class Scene(Rendered):
    """Renders a `World`: any frame on its own, the same bytes every time."""

    def __init__(self, world: World) -> None:
        self.world = world
        self.camera = world.camera
        self.row_s = world.sensor.readout_s / max(1, self.camera.height_px - 1)

    @property
    def container(self) -> Container:
        """How the session is written down."""
        world, sensor = self.world, self.world.sensor
        markers = tuple((ball.name, ball.diameter_m) for ball in world.markers)
        return Container(
            world.camera, sensor.exposure_s, sensor.readout_s, world.ticks, world.time_base, markers, MEGABITS
        )

    @property
    def beside(self) -> Mapping[str, str]:
        """More files of truth: a session of strokes has them."""
        return self.world.beside

    def planes(self, picture: BgrImage) -> npt.NDArray[np.uint8]:
        """The picture's 4:2:0 planes, chroma sited left."""
        return to_yuv420(picture)

    def _frame(self, index: int) -> tuple[BgrImage, int, list[MarkerTruth]]:
        layers = self._find_layers(index)
        return self._picture(index, layers), self.stamp_ns(index), self._truth(index, layers)

    # --- truth ---

    def truth(self, index: int) -> list[MarkerTruth]:
        """The truth of every marker on a frame, in the world's order."""
        return self._truth(index, self._find_layers(index))

    def _truth(self, index: int, layers: list[_Layer]) -> list[MarkerTruth]:
        return [self._marker_truth(ball, index, layers) for ball in self.world.markers]

    def position(self, ball: Ball, t_s: FloatArray) -> FloatArray:
        """A ball's centre (N, 3) in the shaking camera's optical frame at times (N,)."""
        t = np.asarray(t_s, np.float64)
        return self.world.vibration.move(ball.path(t), t)

    def _marker_truth(self, ball: Ball, index: int, layers: list[_Layer]) -> MarkerTruth:
        stamp_s = self._stamp_s(index)
        outline = self._outline(ball, stamp_s)
        if outline is None:
            t = np.array([stamp_s])
            return MarkerTruth(
                ball.name, None, None, None, self.position(ball, t)[0], self._velocity(ball, t), 0.0, False
            )
        t, pixel = self._when_seen(ball, stamp_s)
        ellipse, circle = polygon_ellipse(outline)
        width, height = self.camera.width_px, self.camera.height_px
        inside = -0.5 <= circle.x_px < width - 0.5 and -0.5 <= circle.y_px < height - 0.5
        visible = self._visible(ball, index, outline, circle, layers)
        xyz = self.position(ball, t)[0]
        return MarkerTruth(
            ball.name,
            circle,
            ellipse,
            (float(pixel[0]), float(pixel[1])),
            xyz,
            self._velocity(ball, t),
            visible,
            inside,
        )

    def _velocity(self, ball: Ball, t: FloatArray) -> FloatArray:
        step = 1e-5
        later, earlier = self.position(ball, t + step), self.position(ball, t - step)
        out: FloatArray = (later - earlier)[0] / (2 * step)
        return out

    def _when_seen(self, ball: Ball, stamp_s: float) -> tuple[FloatArray, FloatArray]:
        """When (1,) the row of the ball's projected centre is half exposed, and that pixel (2,)."""
        t = np.array([stamp_s])
        for _ in range(4):
            pixel = self.camera.project(self.position(ball, t))[0]
            t = np.array([stamp_s + (pixel[1] - (self.camera.height_px - 1) / 2) * self.row_s])
        return t, pixel

    def _outline(self, ball: Ball, stamp_s: float, samples: int = 256) -> FloatArray | None:
        """The ball's outline (samples, 2) in pixels as seen; None when the lens cannot see all of it."""
        centre = self.position(ball, np.array([stamp_s]))[0]
        distance = float(np.linalg.norm(centre))
        edge = np.arccos(np.clip(centre[2] / distance, -1, 1)) + np.arcsin(min(1.0, ball.diameter_m / 2 / distance))
        if edge > _WIDEST_RAD:
            return None
        outline = seen_outline(
            self.camera, lambda t: self.position(ball, t), ball.diameter_m / 2, stamp_s, self.row_s, samples
        )
        return outline if np.isfinite(outline).all() else None

    def _visible(self, ball: Ball, index: int, outline: FloatArray, circle: Circle, layers: list[_Layer]) -> float:
        own = next((layer for layer in layers if layer.what is ball), None)
        if own is None:
            return 0.0
        low, high = outline.min(axis=0), outline.max(axis=0)
        whole = low.min() >= -0.5 and high[0] <= self.camera.width_px - 0.5 and high[1] <= self.camera.height_px - 0.5
        nearer = [o for o in layers if o.depth_m < own.depth_m and _touch(o.box, own.box)]
        if whole and not nearer:
            return 1.0
        window = _grown(own.box, 0).clipped(self.camera.width_px, self.camera.height_px)
        stamp_s = self._stamp_s(index)
        seen = self._coverage(ball, window, stamp_s)
        for other in nearer:
            seen = seen * (1 - self._coverage(other.what, window, stamp_s))
        fraction = float(seen.sum(dtype=np.float64)) / circle.area_px2
        return 1.0 if fraction > 0.9995 else 0.0 if fraction < 0.0005 else fraction

    # --- pictures ---

    def picture(self, index: int) -> BgrImage:
        """The frame as the camera hands it to its encoder, (height, width, 3) BGR."""
        return self._picture(index, self._find_layers(index))

    def _picture(self, index: int, layers: list[_Layer]) -> BgrImage:
        sensor = self.world.sensor
        light = self._light(index, layers)
        if not sensor.noise:
            clean: BgrImage = self._curve[np.clip(light * 16383 + 0.5, 0, 16383).astype(np.uint16)]
            return clean
        rng = np.random.default_rng([self.world.seed, index])
        dy, dx = rng.integers(0, _NOISE_SLACK, 2)
        height, width = light.shape[:2]
        shot, read = 1 / sensor.full_well_e, (sensor.read_e / sensor.full_well_e) ** 2
        sign = rng.choice((-1.0, 1.0))
        flat = develop(light.reshape(height, -1), self._noise, dy, 3 * dx, shot, read, sign, self._curve)
        picture: BgrImage = flat.reshape(height, width, 3)
        if sensor.sharpen:
            soft = cv2.GaussianBlur(picture, (5, 5), 1.0)
            picture = cv2.addWeighted(picture, 1 + sensor.sharpen, soft, -sensor.sharpen, 0)  # type: ignore[assignment]
        return picture

    def light(self, index: int) -> Image:
        """Linear light on the sensor before noise, (height, width, 3) BGR float32; 1 is where white clips."""
        return self._light(index, self._find_layers(index))

    def _light(self, index: int, layers: list[_Layer]) -> Image:
        world, stamp_s = self.world, self._stamp_s(index)
        exposure = world.sensor.exposure_s
        behind = self._canvas.view(stamp_s, exposure)
        if self._body is not None:
            behind = self._body.draw(behind, stamp_s, exposure)
        light: Image = cv2.LUT(behind, self._decode)  # type: ignore[assignment]
        for group in _groups(layers):
            self._compose(light, group, stamp_s)
        if world.light.level is not None:
            rows = self._row_times(0, self.camera.height_px, np.array([stamp_s]))[0]
            light *= world.light.level(rows).astype(np.float32)[:, None, None]
        return light

    def _compose(self, light: Image, group: list[_Layer], stamp_s: float) -> None:
        """Paint a group of overlapping layers into `light`, integrating over the exposure."""
        sensor = self.world.sensor
        margin = 3 + round(3 * sensor.psf_px)
        x0, y0 = (min(layer.box[k] for layer in group) for k in (0, 1))
        x1, y1 = (max(layer.box[k] for layer in group) for k in (2, 3))
        window = _grown((x0, y0, x1, y1), margin).clipped(self.camera.width_px, self.camera.height_px)
        region = light[window.y : window.y + window.height, window.x : window.x + window.width]
        steps = int(np.clip(np.ceil(max(layer.motion_px for layer in group) / _STEP_PX), 1, _MOST_STEPS))
        times = stamp_s + ((np.arange(steps) + 0.5) / steps - 0.5) * sensor.exposure_s
        painted = []
        for layer in sorted(group, key=lambda layer: -layer.depth_m):
            part = _grown(layer.box, 1).clipped(self.camera.width_px, self.camera.height_px)
            if part.width and part.height:
                painted.append((layer.what, part, self._tracks(layer.what, part, times)))
        # Premultiplied colour and coverage: the lens blurs the layers, and not once more what is behind them.
        layers = np.zeros((*region.shape[:2], 4), np.float32)
        for step in range(steps):
            instant = np.zeros_like(layers)
            for what, part, tracks in painted:
                x, y = part.x - window.x, part.y - window.y
                here = instant[y : y + part.height, x : x + part.width]
                self._paint(here, what, part, tracks[step], float(times[step]))
            layers += instant
        layers *= np.float32(1 / steps)
        if sensor.psf_px:
            layers = cv2.GaussianBlur(layers, (0, 0), sensor.psf_px, borderType=cv2.BORDER_REPLICATE)  # type: ignore[assignment]
        region *= 1 - layers[..., 3:]
        region += layers[..., :3]

    def _tracks(self, what: Ball | Card, window: Window, times_s: FloatArray) -> FloatArray:
        """Where a ball or card is when each row of a window is exposed, for several instants: (T, rows, 3).

        A ball's rows have one more at either end, as its gradients need them.
        """
        more = 1 if isinstance(what, Ball) else 0
        t = self._row_times(window.y - more, window.y + window.height + more, times_s)
        where = self.position(what, t.ravel()) if isinstance(what, Ball) else what.path(t.ravel())
        return where.reshape(*t.shape, 3)

    def _row_times(self, first: int, end: int, times_s: FloatArray) -> FloatArray:
        """When the rows first..end-1 are exposed, (T, rows), if the middle row is at times (T,)."""
        rows = np.arange(first, end) - (self.camera.height_px - 1) / 2
        out: FloatArray = times_s[:, None] + rows * self.row_s
        return out

    def _paint(self, out: Image, what: Ball | Card, window: Window, track: FloatArray, t_s: float) -> None:
        """Lay a ball or card at one instant over `out` (h, w, 4): linear BGR times coverage, and coverage."""
        if isinstance(what, Card):
            paint_card(window.x, window.y, track, *what.half_px, self._paints[id(what)], out)
            return
        wander = 2 * np.pi * self.world.light.wander_hz * t_s
        lamp = np.array(self.world.light.direction) + np.array([0.5 * np.sin(wander), 0.2 * np.cos(wander), 0.0])
        lamp /= np.linalg.norm(lamp)
        half = lamp + np.array([0.0, 0.0, -1.0])
        half /= np.linalg.norm(half)
        surface = np.array([*lamp, *half, what.ambient, what.gloss, what.grain, 2 * np.sin(3 * t_s)])
        a, b = self._rays
        rows = slice(window.y, window.y + window.height + 2)  # The rays have a border of one pixel.
        columns = slice(window.x, window.x + window.width + 2)
        paint_ball(
            a[rows, columns], b[rows, columns], track, what.diameter_m / 2, self._albedos[id(what)], surface, out
        )

    def _coverage(self, what: Ball | Card, window: Window, t_s: float) -> Image:
        """The part (h, w) of each pixel that a ball or card covers at one instant."""
        out = np.zeros((window.height, window.width, 4), np.float32)
        self._paint(out, what, window, self._tracks(what, window, np.array([t_s]))[0], t_s)
        return out[..., 3]

    def _stamp_s(self, index: int) -> float:
        return float(self.world.ticks[index] * self.world.time_base)

    def _find_layers(self, index: int) -> list[_Layer]:
        """All balls and cards that touch the picture while this frame is exposed."""
        stamp_s, half = self._stamp_s(index), self.world.sensor.exposure_s / 2
        layers = []
        for ball in self.world.balls:
            ends = [self._outline(ball, stamp_s + s * half, 32) for s in (-1, 0, 1)]
            points = [end for end in ends if end is not None]
            if len(points) == 3:
                depth = float(np.linalg.norm(self.position(ball, np.array([stamp_s]))[0]))
                motion = sum(float(np.abs(q - p).max()) for p, q in pairwise(points))
                layers.append(self._layer(ball, np.concatenate(points), 2.0, depth, motion))
        for card in self.world.cards:
            corners = []
            reach = half + self.world.sensor.readout_s / 2
            where = card.path(stamp_s + np.array([-reach, -half, 0.0, half, reach]))
            for x, y, angle in where:
                cos, sin = np.cos(angle), np.sin(angle)
                for p, q in ((1, 1), (1, -1), (-1, -1), (-1, 1)):
                    w, h = p * card.half_px[0], q * card.half_px[1]
                    corners.append((x + w * cos - h * sin, y + w * sin + h * cos))
            motion = float(np.abs(where[3, :2] - where[1, :2]).max())
            if np.isfinite(where).all():  # NaN: it goes along with a marker that is beyond the lens
                layers.append(self._layer(card, np.array(corners), 2.0, card.depth_m, motion))
        width, height = self.camera.width_px, self.camera.height_px
        return [layer for layer in layers if _touch(layer.box, (0, 0, width, height))]

    @staticmethod
    def _layer(what: Ball | Card, points: FloatArray, margin: float, depth_m: float, motion_px: float) -> _Layer:
        low = np.floor(np.clip(points.min(axis=0) - margin, -9999, 9999)).astype(int)
        high = np.ceil(np.clip(points.max(axis=0) + margin, -9999, 9999)).astype(int) + 1
        return _Layer(what, (int(low[0]), int(low[1]), int(high[0]), int(high[1])), depth_m, motion_px)

    # --- made once ---

    @cached_property
    def _rays(self) -> tuple[Image, Image]:
        """Normalised coordinates of every pixel and of a border of one: two (height + 2, width + 2)."""
        y, x = np.mgrid[-1 : self.camera.height_px + 1, -1 : self.camera.width_px + 1]
        grid = np.stack([x.ravel(), y.ravel()], axis=1).astype(np.float64)
        normal = self.camera.normalise(grid).astype(np.float32)
        return normal[:, 0].reshape(x.shape), normal[:, 1].reshape(x.shape)

    @cached_property
    def _canvas(self) -> Canvas:
        return Canvas(self.world.backdrop, self.camera, self.world.vibration)

    @cached_property
    def _body(self) -> Body | None:
        athlete = self.world.athlete
        return None if athlete is None else Body(athlete, self.camera, self.world.vibration, self.row_s)

    @cached_property
    def _noise(self) -> Image:
        """Standard normal noise (rows, 3 columns), a little larger than the picture, slightly correlated as demosaicing
        leaves it.
        """
        shape = (self.camera.height_px + _NOISE_SLACK, self.camera.width_px + _NOISE_SLACK, 3)
        white = np.random.default_rng([self.world.seed, 7919]).standard_normal(shape, np.float32)
        kernel = np.array([0.2, 1.0, 0.2])
        kernel /= np.linalg.norm(kernel)
        return cv2.sepFilter2D(white, -1, kernel, kernel).reshape(len(white), -1)  # type: ignore[return-value]

    @cached_property
    def _decode(self) -> Image:
        return to_linear(np.arange(256, dtype=np.uint8)).astype(np.float32)

    @cached_property
    def _curve(self) -> npt.NDArray[np.uint8]:
        return np.rint(to_srgb(np.arange(16384) / 16383)).astype(np.uint8)

    @cached_property
    def _albedos(self) -> dict[int, FloatArray]:
        return {id(ball): linear_bgr(ball.colour).astype(np.float64) for ball in self.world.balls}

    @cached_property
    def _paints(self) -> dict[int, Image]:
        paints = {}
        for card in self.world.cards:
            photo = photograph(card.texture) if card.texture else np.array([[card.colour[::-1]]], np.uint8)
            paints[id(card)] = to_linear(photo).astype(np.float32)
        return paints


def _touch(p: tuple[int, int, int, int], q: tuple[int, int, int, int]) -> bool:
    return p[0] < q[2] and q[0] < p[2] and p[1] < q[3] and q[1] < p[3]


def _grown(box: tuple[int, int, int, int], margin: int) -> Window:
    x0, y0, x1, y1 = box
    return Window(x0 - margin, y0 - margin, x1 - x0 + 2 * margin, y1 - y0 + 2 * margin)


def _groups(layers: list[_Layer]) -> list[list[_Layer]]:
    """Split layers into groups whose boxes overlap, directly or through others, or nearly so."""
    groups: list[list[_Layer]] = []
    for layer in layers:
        x0, y0, x1, y1 = layer.box
        near = (x0 - 10, y0 - 10, x1 + 10, y1 + 10)
        joined = [g for g in groups if any(_touch(near, other.box) for other in g)]
        groups = [g for g in groups if not any(g is j for j in joined)]
        groups.append([layer, *(other for g in joined for other in g)])
    return groups


_KR, _KB = 0.2126, 0.0722
_TO_YUV = np.array(
    [
        [_KB * 219, (1 - _KR - _KB) * 219, _KR * 219, 16 * 255],
        [112, -(1 - _KR - _KB) / (1 - _KB) * 112, -_KR / (1 - _KB) * 112, 128 * 255],
        [-_KB / (1 - _KR) * 112, -(1 - _KR - _KB) / (1 - _KR) * 112, 112, 128 * 255],
    ]
) / 255  # fmt: skip
"""BGR in 0..255 to BT.709 limited-range Y, Cb, Cr (3, 4: the last column is the offset)."""


def to_yuv420(picture: BgrImage) -> npt.NDArray[np.uint8]:
    """(height, width, 3) BGR, both even -> (height * 3 / 2, width) Y, Cb, Cr planes, chroma sited left (MPEG-2, H.264's
    default).
    """
    return yuv420(np.ascontiguousarray(picture).reshape(len(picture), -1), _TO_YUV.astype(np.float32).ravel())
