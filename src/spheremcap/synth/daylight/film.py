"""A film of a `DayWorld`: its pictures and their exact truth, frame by frame.

Time. A frame's stamp is the middle of the exposure of the picture's middle row. A marker's truth is of the instant at
which the row of its own centre is half exposed; each row of its outline is where it is when that row is half exposed.
The circle has the outline's area and centroid, found row by row from the cone of rays that touch the sphere.
"""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt

from spheremcap.core.circle import Circle
from spheremcap.core.frame import BgrImage
from spheremcap.synth.daylight import rays
from spheremcap.synth.daylight.electronics import Image, curve, develop, planes420
from spheremcap.synth.daylight.surfaces import GROUNDS, PATTERNS, WALLS, backdrop
from spheremcap.synth.daylight.world import Box, Capsule, DayWorld, FloatArray, Paint, Sphere, Strap
from spheremcap.synth.truth import Container, Ellipse, MarkerTruth, Rendered

CLEAR = 0.6
"""A person gives a marker's seed once so much of it is seen: a strap always hides some."""
_ROWS = 400  # of an outline, on which its moments are summed
_FINE = 160  # rays across an outline's box that tell how much of it is seen
_WIDEST_RAD = float(np.radians(80))
_KNOTS_PX = 4.0  # how far a thing may go between two instants at which it is placed


@dataclass(frozen=True, slots=True)
class _Things:
    """All things during one picture, as `rays.expose` takes them."""

    knots: FloatArray
    hulls: FloatArray
    when: FloatArray


class Film(Rendered):
    """Renders a `DayWorld`: any frame on its own, the same bytes every time."""

    def __init__(self, world: DayWorld) -> None:
        self.world = world
        self.camera = world.camera
        self.row_s = world.electronics.readout_s / max(1, self.camera.height_px - 1)
        camera, view = self.camera, world.view
        self._lens = np.array(
            [camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, view.height_m, np.cos(view.down_rad),
             np.sin(view.down_rad)]
        )  # fmt: skip

    @property
    def container(self) -> Container:
        """How the session is written down."""
        world, electronics = self.world, self.world.electronics
        markers = tuple((sphere.name, sphere.diameter_m) for sphere in world.markers)
        return Container(
            world.camera, electronics.exposure_s, electronics.readout_s, world.ticks, world.time_base, markers,
            electronics.megabits, world.sample_aspect if world.says_aspect else None, CLEAR,
        )  # fmt: skip

    def _frame(self, index: int) -> tuple[BgrImage, int, list[MarkerTruth]]:
        return self.picture(index), self.stamp_ns(index), self.truth(index)

    # --- pictures ---

    def picture(self, index: int) -> BgrImage:
        """The frame as the camera hands it to its encoder, (height, width, 3) BGR."""
        rng = np.random.Generator(np.random.SFC64([self.world.seed, index, 5_701]))
        return develop(self.light(index), self.world.electronics, self._curve, rng)

    def planes(self, picture: BgrImage) -> npt.NDArray[np.uint8]:
        """The picture's 4:2:0 planes with the camera's chroma siting."""
        return planes420(picture, self.world.electronics.siting)

    def light(self, index: int) -> Image:
        """Linear light on the sensor before gain and noise, (height, width, 3) RGB float32."""
        of_sky, of_sun, far = self._backdrop
        light: Image = of_sky + of_sun
        if self._order:
            things = self._things(index)
            light = rays.expose(
                of_sky, of_sun, far, self._lens, self._light, things.knots, self._solids, things.hulls, things.when,
                self.world.edge_samples, index + 1000 * self.world.seed,
            )  # fmt: skip
        if self.world.electronics.psf_px:
            light = cv2.GaussianBlur(light, (0, 0), self.world.electronics.psf_px, borderType=cv2.BORDER_REPLICATE)  # type: ignore[assignment]
        if self._glare is not None:
            light = light + self._glare
        return light

    # --- truth ---

    def truth(self, index: int) -> list[MarkerTruth]:
        """The truth of every marker on a frame, in the world's order."""
        things = self._things(index)
        return [self._marker_truth(sphere, index, things) for sphere in self.world.markers]

    def _marker_truth(self, sphere: Sphere, index: int, things: _Things) -> MarkerTruth:
        t, pixel = self._when_seen(sphere, self._stamp_s(index))
        xyz, velocity = self._at(sphere, t), self._velocity(sphere, t)
        far = float(np.linalg.norm(xyz))
        if np.arccos(xyz[2] / far) + np.arcsin(min(1.0, sphere.diameter_m / 2 / far)) > _WIDEST_RAD:
            return MarkerTruth(sphere.name, None, None, None, xyz, velocity, 0.0, False)
        circle, ellipse, box = self._outline(sphere, t)
        width, height = self.camera.width_px, self.camera.height_px
        inside = -0.5 <= circle.x_px < width - 0.5 and -0.5 <= circle.y_px < height - 0.5
        visible = 0.0
        if box[0] < width and box[2] > -1 and box[1] < height and box[3] > -1:
            which = self._order.index(sphere)
            met, free = rays.shown(
                self._lens, things.knots, self._solids, which, things.when, box, _FINE, height, width
            )
            visible = free / met if met else 0.0
        return MarkerTruth(sphere.name, circle, ellipse, pixel, xyz, velocity, visible, inside)

    def _at(self, sphere: Sphere, t_s: float) -> FloatArray:
        """A sphere's centre (3,) in the optical frame."""
        out: FloatArray = self.world.view.to_camera(sphere.path(np.array([t_s])))[0]
        return out

    def _velocity(self, sphere: Sphere, t_s: float) -> FloatArray:
        step = 1e-5
        return (self._at(sphere, t_s + step) - self._at(sphere, t_s - step)) / (2 * step)

    def _when_seen(self, sphere: Sphere, stamp_s: float) -> tuple[float, tuple[float, float] | None]:
        """When the row of the sphere's projected centre is half exposed, and that pixel."""
        camera, t = self.camera, stamp_s
        x = y = np.nan
        for _ in range(6):
            where = self._at(sphere, t)
            if where[2] <= 1e-6:
                return stamp_s, None
            x = camera.fx_px * where[0] / where[2] + camera.cx_px
            y = camera.fy_px * where[1] / where[2] + camera.cy_px
            t = stamp_s + (y - (camera.height_px - 1) / 2) * self.row_s
        return t, (float(x), float(y))

    def _outline(self, sphere: Sphere, t_s: float) -> tuple[Circle, Ellipse, FloatArray]:
        """The outline's circle, ellipse and box (x0, y0, x1, y1) in pixels, as seen about the time when its centre is.

        The rays q with (q . c)**2 = (|c|**2 - R**2) |q|**2 touch a sphere with centre c and radius R; on one row of the
        picture that is a quadratic in x, whose roots are the outline's two ends.
        """
        camera, radius = self.camera, sphere.diameter_m / 2
        centre = self._at(sphere, t_s)
        middle = camera.fy_px * centre[1] / centre[2] + camera.cy_px

        def cone(y_px: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
            """a x**2 + 2 b x + c of rows y (N,), with x normalised: 0 on the outline, positive inside."""
            t = t_s + (y_px - middle) * self.row_s
            p = self.world.view.to_camera(sphere.path(t))
            v = (y_px - camera.cy_px) / camera.fy_px
            s = (p * p).sum(axis=1) - radius**2
            along = p[:, 1] * v + p[:, 2]
            return p[:, 0] ** 2 - s, p[:, 0] * along, along**2 - s * (v * v + 1)

        def end(side: float) -> float:
            """The row at which the outline ends: where the quadratic's two roots meet."""
            reach = 1.3 * camera.fy_px * radius / centre[2] * float(np.linalg.norm(centre)) / centre[2] + 1
            low, high = middle, middle + side * reach
            for _ in range(60):
                y = (low + high) / 2
                a, b, c = cone(np.array([y]))
                low, high = (y, high) if b[0] * b[0] - a[0] * c[0] > 0 else (low, y)
            return (low + high) / 2

        top, bottom = end(-1.0), end(1.0)
        theta = (np.arange(_ROWS) + 0.5) / _ROWS * np.pi  # rows crowd towards the ends, where the width falls steeply
        y = (top + bottom) / 2 - (bottom - top) / 2 * np.cos(theta)
        weight = (bottom - top) / 2 * np.sin(theta) * np.pi / _ROWS
        a, b, c = cone(y)
        root = np.sqrt(np.maximum(b * b - a * c, 0.0))
        x0, x1 = ((-b + side * root) / a * camera.fx_px + camera.cx_px for side in (1.0, -1.0))
        x0, x1 = np.minimum(x0, x1), np.maximum(x0, x1)
        wide = x1 - x0
        area = float((weight * wide).sum())
        x_px, y_px = float((weight * (x1**2 - x0**2) / 2).sum() / area), float((weight * wide * y).sum() / area)
        u0, u1, v = x0 - x_px, x1 - x_px, y - y_px
        xx = float((weight * (u1**3 - u0**3) / 3).sum() / area)
        xy = float((weight * (u1**2 - u0**2) / 2 * v).sum() / area)
        yy = float((weight * wide * v * v).sum() / area)
        # An ellipse's second moments are a quarter of its axes' squares.
        mean, half = (xx + yy) / 2, float(np.hypot((xx - yy) / 2, xy))
        angle = 0.5 * float(np.arctan2(2 * xy, xx - yy))
        ellipse = Ellipse(x_px, y_px, 2 * float(np.sqrt(mean + half)), 2 * float(np.sqrt(mean - half)), angle)
        return (
            Circle(x_px, y_px, float(np.sqrt(area / np.pi))),
            ellipse,
            np.array([float(x0.min()), top, float(x1.max()), bottom]),
        )

    def _stamp_s(self, index: int) -> float:
        return float(self.world.ticks[index] * self.world.time_base)

    # --- things ---

    @cached_property
    def _order(self) -> list[Sphere | tuple[Sphere, Strap] | Capsule | Box]:
        """All things in the order of the tables' rows."""
        world = self.world
        straps = [(sphere, sphere.strap) for sphere in world.spheres if sphere.strap is not None]
        return [*world.spheres, *straps, *world.capsules, *world.boxes]

    def _things(self, index: int) -> _Things:
        """Where all things are while a frame is exposed, at instants so near that none goes far between two."""
        electronics, stamp_s = self.world.electronics, self._stamp_s(index)
        # The outlines reach out of the picture, and their rows with them.
        reach = electronics.exposure_s / 2 + electronics.readout_s * 0.6 + 1e-5
        for count in (2, 3, 5, 9, 17, 33, 65):
            times = np.linspace(stamp_s - reach, stamp_s + reach, count)
            knots = np.stack([_places(thing, times) for thing in self._order], axis=1)
            moved = np.linalg.norm(np.diff(knots[..., :3], axis=0), axis=2)
            ends = np.array([isinstance(thing, Capsule) for thing in self._order])
            moved = np.where(ends, np.maximum(moved, np.linalg.norm(np.diff(knots[..., 3:6], axis=0), axis=2)), moved)
            near = np.maximum(np.abs(knots[:-1, :, 1]), 0.2)
            turned = np.abs(np.diff(knots[..., 6], axis=0)).max()
            if (moved * self.camera.fy_px / near).max() < _KNOTS_PX and turned < 0.1:
                break
        other = np.where(ends[:, None], knots[..., 3:6], knots[..., :3])
        low = np.minimum(knots[..., :3], other).min(axis=0)
        high = np.maximum(knots[..., :3], other).max(axis=0)
        size = np.array([_size(thing) for thing in self._order])
        hulls = np.concatenate(
            [
                (low + high) / 2,
                np.linalg.norm(high - low, axis=1)[:, None] / 2 + size[:, None],
                moved.max(axis=0)[:, None],
            ],
            axis=1,
        )
        when = np.array([times[0], times[1] - times[0], stamp_s, electronics.exposure_s, self.row_s])
        return _Things(np.ascontiguousarray(knots), np.ascontiguousarray(hulls), when)

    # --- made once ---

    @cached_property
    def _solids(self) -> FloatArray:
        return np.array([_solid(thing) for thing in self._order]).reshape(-1, rays.COLUMNS)

    @cached_property
    def _light(self) -> FloatArray:
        d = self.world.daylight
        towards = _unit(d.sun_from)
        across = np.cross(towards, np.eye(3)[np.abs(towards).argmin()])
        across /= np.linalg.norm(across)
        return np.array([*d.sky, *d.bounce, *d.sun, *towards, *across, *np.cross(towards, across)])

    @cached_property
    def _backdrop(self) -> tuple[Image, Image, Image]:
        s = self.world.stage
        stage = np.array(
            [GROUNDS.index(s.ground), *s.ground_albedo, WALLS.index(s.wall), *s.wall_albedo, s.wall_m, s.wall_height_m]
        )
        patches = np.array([[p.on == "wall", *p.place_m, p.radius_m, *p.albedo] for p in s.patches], np.float64)
        of_sky, of_sun, far = backdrop(
            self.camera.height_px, self.camera.width_px, self._lens, self._light, stage, patches.reshape(-1, 7), 3
        )
        return of_sky, of_sun, far

    @cached_property
    def _glare(self) -> Image | None:
        g = self.world.glare
        if g.strength == 0.0:
            return None
        width, height = self.camera.width_px, self.camera.height_px
        y, x = np.mgrid[:height, :width].astype(np.float32)
        square = float(self.world.sample_aspect)
        off = ((x - g.middle[0] * width) * square) ** 2 + (y - g.middle[1] * height) ** 2
        spot = g.everywhere + (1 - g.everywhere) * np.exp(-off / (2 * (g.sigma * width * square) ** 2))
        out: Image = (g.strength * spot[..., None] * np.array(g.colour)).astype(np.float32)
        return out

    @cached_property
    def _curve(self) -> npt.NDArray[np.uint8]:
        return curve(self.world.electronics)


def _places(thing: Sphere | tuple[Sphere, Strap] | Capsule | Box, t_s: FloatArray) -> FloatArray:
    """(N, 7) at times (N,), as in `rays`: place or end, other end or half edges or axis, turn."""
    zero = np.zeros((len(t_s), 1))
    if isinstance(thing, Capsule):
        return np.concatenate([thing.start(t_s), thing.end(t_s), zero], axis=1)
    if isinstance(thing, Box):
        return np.concatenate([thing.path(t_s), np.tile(thing.half_m, (len(t_s), 1)), zero], axis=1)
    sphere, strap = thing if isinstance(thing, tuple) else (thing, None)
    turn = sphere.turn_rad + sphere.spin_rad_s * t_s
    axis = np.tile((0.0, 0.0, 1.0), (len(t_s), 1))
    if strap is not None:
        axis = _turned(np.array(strap.axis) / np.linalg.norm(strap.axis), _unit(sphere.spin_axis), turn)
    return np.concatenate([sphere.path(t_s), axis, turn[:, None]], axis=1)


def _turned(v: FloatArray, axis: FloatArray, angle: FloatArray) -> FloatArray:
    """A vector (3,) turned about a unit axis (3,) by angles (N,) (Rodrigues): (N, 3)."""
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    out: FloatArray = v * c + np.cross(axis, v) * s + axis * (axis @ v) * (1 - c)
    return out


def _unit(v: tuple[float, float, float]) -> FloatArray:
    out: FloatArray = np.array(v) / np.linalg.norm(v)
    return out


def _size(thing: Sphere | tuple[Sphere, Strap] | Capsule | Box) -> float:
    """How far a thing reaches from its place or its line, in metres."""
    if isinstance(thing, Capsule):
        return thing.radius_m
    if isinstance(thing, Box):
        return float(np.linalg.norm(thing.half_m))
    if isinstance(thing, tuple):
        return thing[0].diameter_m / 2 * (1 + thing[1].thick)
    return thing.diameter_m / 2


def _solid(thing: Sphere | tuple[Sphere, Strap] | Capsule | Box) -> FloatArray:
    """A thing's row of `rays`' table of what does not change."""
    out = np.zeros(rays.COLUMNS)
    sphere, strap = thing if isinstance(thing, tuple) else (thing, None)
    paint: Paint = sphere.paint if strap is None else strap.paint
    kinds = {Sphere: rays.SPHERE, Capsule: rays.CAPSULE, Box: rays.BOX}
    out[rays.KIND] = rays.BAND if strap is not None else kinds[type(sphere)]
    out[rays.RADIUS] = 1.0 if isinstance(sphere, Box) else _size(thing)
    out[rays.PATTERN], out[rays.SCALE] = PATTERNS.index(paint.pattern), paint.scale
    out[rays.STRENGTH], out[rays.GLOSS], out[rays.EXPONENT] = paint.strength, paint.gloss, paint.exponent
    out[rays.ALBEDO : rays.ALBEDO + 3], out[rays.SECOND : rays.SECOND + 3] = paint.albedo, paint.second
    out[rays.SPIN : rays.SPIN + 3] = _unit(sphere.spin_axis) if isinstance(sphere, Sphere) else (0, 0, 1)
    out[rays.MARKER] = isinstance(sphere, Sphere) and sphere.tracked
    if strap is not None and isinstance(sphere, Sphere):
        out[rays.HALF_WIDTH] = strap.half_width * sphere.diameter_m / 2
        out[rays.OFFSET] = strap.offset * sphere.diameter_m / 2
    return out
