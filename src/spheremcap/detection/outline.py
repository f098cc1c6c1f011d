"""From a proposed circle to a measured sphere: the edges around it, the cone through them, and how sure that is."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from spheremcap.core.camera import Camera
from spheremcap.core.circle import Circle
from spheremcap.core.compiled import BOOL, F4, F8, I8, PLANE, array, finite, inner, kernel
from spheremcap.core.frame import Frame
from spheremcap.core.lens import normal_of
from spheremcap.core.look import AGREES, EdgePoints, Expected, Measured
from spheremcap.core.optics import AT_REST, Motion
from spheremcap.core.sampling import GRID, bgr_at, clipped
from spheremcap.detection.colour import loosened
from spheremcap.detection.edge import EdgeConfig, edge_params, edges_into, misfits_into, to_linear
from spheremcap.detection.shading import RINGS, Rings
from spheremcap.positioning.sphere import (
    FIT_ROUNDS,
    IMPERFECTION,
    PositionConfig,
    circle_at,
    fit_rays,
    set_outline,
    sphere_at,
    sphere_of_circle,
)

FloatArray = npt.NDArray[np.float64]

SOFTNESS = (1.0, 1.6, 2.4, 3.6)
"""Blurs of lens and focus that are tried, in `blur_sigma_px`."""
_SEED_SEEN = 0.7  # share of the outline from which a seed is where it should be
_HOLD = {"seed": 0.03, "acquire": 0.1, "colour": 0.1}  # relative deviation of the proposals' sizes
_HOLD_CLOSE = 0.01  # that of the others'
_LOOKS = 3  # a coarse one and two fine ones
_PART_HIDDEN = 0.1  # relative deviation of the radius, a share of the outline that is not seen
_ALIKE = 8.0  # neighbouring frames that share what hides a part
_WHOLE_SD = 0.005  # relative deviation of the radius of an outline that is seen as a whole
_RANGE_SD = 0.01  # the filter's distance is no surer than this, relative
_SIZE_CHANGE = 0.1  # of the radius from one frame to the next: as much is usual
_SIZE_OPEN = 0.3  # relative deviation of the expected radius from which it is not known any better
_SIZE_LEAP = 1.5  # most that a claim's size may differ from the first proposal's, either way
_OWN_SIZE = 0.15  # logarithm of the ratio of radii from which a proposal has a size of its own
_INSIDE, _WHOLE = 0.75, 0.8  # shares of its outline: in the picture, and with an edge of that, when it is a whole
_WHOLE_CHANGE, _WHOLE_LEAP = 0.4, 2.0  # `_SIZE_CHANGE` and `_SIZE_LEAP` of a whole
_SETTLED_PX = 0.5  # a fine look that moved the circle less than this is not repeated
_NO_LIMITS = np.empty(0)
_NO_SHADING = np.empty((0, 0), np.float32)
_NONE = np.zeros(0)
_NO_EDGES = EdgePoints(np.zeros((0, 2)), _NONE, np.zeros(0, np.intp), _NONE, 0, 0.0)
_F1 = array(F8, 1)


class Outline:
    """Measures the outlines of spheres of one size before one camera; keeps nothing from frame to frame."""

    def __init__(self, radius_m: float, camera: Camera, edge: EdgeConfig, position: PositionConfig) -> None:
        self._radius_m, self._camera, self._edge = radius_m, camera, edge
        self._params = edge_params(edge)
        self._unsure = np.array([position.shared_px, position.systematic_px])

    def clicked(self, circle: Circle) -> Measured:
        """A person's circle as it is: a careful click is good to about a pixel."""
        xyz = sphere_of_circle(circle, self._radius_m, self._camera)
        z, focal = xyz[2], np.array([self._camera.fx_px, self._camera.fy_px])
        aside = np.diag([z / focal[0], z / focal[1], 0.0])
        aside[:, 2] = -xyz / circle.r_px
        return Measured(circle, (1.0, 1.0, 1.0), xyz, aside @ aside.T, 0.0, "seed", _NO_EDGES, _NONE, _NONE, AT_REST)

    def first_look(self, frame: Frame, circle: Circle, sizes: Sequence[float] = (1.0, 1.25, 0.8)) -> Measured | None:
        """The seed sharpened, with the blur that explains its outline best; where that is not much of one, also from
        circles a quarter larger and smaller (`sizes`), as a hasty click may be."""
        best: Measured | None = None
        for size in sizes:
            start = circle.resized(size * circle.r_px)
            for softness in SOFTNESS if self._edge.learn_blur else SOFTNESS[:1]:
                motion = replace(AT_REST, softness=softness)
                measured = self.sharpened(frame, start, "seed", 0.25 * start.r_px, motion, None)
                if clearness(measured) > clearness(best) + 0.02:
                    best = measured
            if best is not None and best.visible > _SEED_SEEN:
                break
        return best

    def longest(
        self,
        frame: Frame,
        proposals: Sequence[tuple[str, Circle]],
        motion: Motion,
        limits: FloatArray | None,
        expected: Expected | None,
        shading: Rings = _NO_SHADING,
    ) -> Measured | None:
        """The proposal whose neighbourhood shows the most outline, sharpened; proposals alike are tried once."""
        best: Measured | None = None
        best_arc_px = 0.0
        usual_r_px = proposals[0][1].r_px
        tried: list[Circle] = []
        for name, circle in proposals:
            if any(circle.dice(other) > 0.85 for other in tried):
                continue
            tried.append(circle)
            reach_px = 0.2 * circle.r_px + 1
            held = self.sharpened(frame, circle, name, reach_px, motion, limits, expected, shading)
            found = [] if held is None else [(held, _SIZE_CHANGE, _SIZE_LEAP)]
            own_size = abs(math.log(circle.r_px / usual_r_px)) > _OWN_SIZE
            if own_size and expected is not None and math.hypot(*motion.blur_px) < usual_r_px:
                free = self.sharpened(frame, circle, name, reach_px, motion, limits, None, shading)
                if free is not None and free.in_picture > _INSIDE and free.visible > _WHOLE * free.in_picture:
                    found.append((free, _WHOLE_CHANGE, _WHOLE_LEAP))
            for measured, change, leap in found:
                if 1 / leap < measured.circle.r_px / usual_r_px < leap:
                    arc_px = _arc_px(measured, usual_r_px, change, expected)
                    if best is None or arc_px > best_arc_px:
                        best, best_arc_px = measured, arc_px
            if best_arc_px > 0.75 * usual_r_px:
                break
        return best

    def sharpened(
        self,
        frame: Frame,
        circle: Circle,
        proposer: str,
        reach_px: float,
        motion: Motion,
        limits: FloatArray | None,
        expected: Expected | None = None,
        shading: Rings = _NO_SHADING,
    ) -> Measured | None:
        """Edges around a circle and the sphere through them: a coarse look up to `reach_px` away, unless that is close,
        then fine ones close by until the circle rests. None when there is no outline. `limits` are the marker's
        colours (`ColourBox.limits`), or None for any. Of a marker that is followed, the distance that is `expected` is
        held as far as the outline leaves it open. `shading` is how its light falls off towards the outline
        (`Shading.profile`)."""
        known = (0.0, math.inf) if expected is None else (expected.range_m, math.hypot(expected.range_sd, _RANGE_SD))
        found, circle_out, sd, xyz, covariance, alone, alone_covariance, edges, seen = _sharpened(
            *frame.planes, self._camera.params, self._params, self._unsure, self._radius_m,
            self._edge.blur_sigma_px * motion.softness, self._edge.rays,
            _NO_LIMITS if limits is None else loosened(limits), shading,
            *circle, reach_px, close_px(circle), _HOLD.get(proposer, _HOLD_CLOSE), *known,
            *motion.blur_px, *motion.lean, motion.stretch_sd,
        )  # fmt: skip
        if found == 0:
            return None
        points, rest = edges[:found, :2].copy(), edges[:found].T.copy()
        return Measured(
            Circle(*circle_out), sd, xyz, covariance, seen[0], proposer,
            EdgePoints(points, rest[2], rest[3].astype(np.intp), rest[4], int(seen[1]), seen[2]),
            rest[5], rest[6], motion, seen[1] / self._edge.rays, (alone, alone_covariance),
        )  # fmt: skip

    def misfits(
        self,
        frame: Frame,
        claim: Measured,
        shading: Rings,
        way_px: FloatArray,
        softnesses: Sequence[float],
        exposures: Sequence[float],
    ) -> FloatArray | None:
        """How badly each softness and exposure time (a share of the way (2,) in a frame interval) explain the profiles
        across a claim's outline, (len(softnesses), len(exposures)): mean logarithms of the squares that are left. None
        where too little of it is seen."""
        shown, out = np.zeros(self._edge.rays, np.bool_), np.empty((len(softnesses), len(exposures)))
        shown[claim.edges.ray[claim.agreeing]] = True
        believed = min(math.hypot(*claim.motion.blur_px) / max(math.hypot(*way_px), 1e-9), 1.0)
        found = _misfits(
            *frame.planes, self._camera.params, self._radius_m, claim.xyz_cam_m, *claim.motion.lean, claim.circle.y_px,
            claim.circle.r_px, close_px(claim.circle), *way_px, believed, np.array(softnesses),
            np.array(exposures), self._edge.blur_sigma_px, self._params, shading, shown, out,
        )  # fmt: skip
        return out if found else None

    def light(self, frame: Frame, claim: Measured) -> tuple[Rings, npt.NDArray[np.bool_], float]:
        """What a verified claim shows of its marker's shading, for `Shading.follow`: linear light (RINGS, rays), the
        rays that show an edge (all of a click, which has none), and the share of the radius clear of the edge."""
        rays, motion = self._edge.rays, claim.motion
        row_px = claim.circle.y_px
        rings = _rings(
            *frame.planes, self._camera.params, self._radius_m, claim.xyz_cam_m, *motion.lean, row_px, RINGS, rays
        )
        shown = np.full(rays, len(claim.edges.ray) == 0)
        shown[claim.edges.ray[claim.agreeing]] = True
        blur_px = self._edge.blur_sigma_px * motion.softness + 0.5 * self._edge.chroma_sigma_px + 0.2
        return rings, shown, 1 - (blur_px + 0.5 * math.hypot(*motion.blur_px)) / claim.circle.r_px


def _arc_px(measured: Measured, usual_r_px: float, change: float, expected: Expected | None) -> float:
    """How much outline a claim shows, pixels: not how large a share, as a circle on a part of the marker shows more, of
    less. Less counts of one that by itself is much larger or smaller than usual, give or take a relative `change`, or
    far from where it is expected: what covers a marker has an outline too."""
    r_px, r_sd = _size_alone(measured)
    off, r_known = 0.0, 0.0
    if expected is not None:
        off = measured.circle.distance(expected.circle) / expected.reach_px
        r_known = min(expected.range_sd, _SIZE_OPEN)
    leap = math.log(r_px / usual_r_px) / math.hypot(change, r_sd, r_known)
    return measured.visible * min(measured.circle.r_px, usual_r_px) / (1 + leap * leap + off * off)


def _size_alone(measured: Measured) -> tuple[float, float]:
    """The radius that a claim's outline has by itself, pixels, and its relative deviation: large where it is near."""
    (place, covariance), square = measured.outline_alone, float(measured.xyz_cam_m @ measured.xyz_cam_m)
    alone = float(place @ place)
    return measured.circle.r_px * math.sqrt(square / alone), math.sqrt(float(place @ covariance @ place)) / alone


def close_px(circle: Circle) -> float:
    """How far from its outline the fine look reaches, pixels: a large marker's outline is less exactly round."""
    return max(1.5, 0.05 * circle.r_px)


def clearness(measured: Measured | None) -> float:
    """How clear an outline is: the share of it with an edge, and how well the blurred step explains that."""
    return -1.0 if measured is None else measured.visible + measured.edges.explained


@inner
def _lean(points, lean_x, lean_y, row):
    """Points of an outline as a global shutter has them, brought to where they are in the picture (`Motion.seen`)."""
    for k in range(len(points)):
        late = (points[k, 1] - row) / (1.0 - lean_y)
        points[k, 0] += lean_x * late
        points[k, 1] += lean_y * late


@kernel(None, PLANE, PLANE, PLANE, GRID, _F1, F8, _F1, F8, F8, F8, I8, I8)
def _rings(y, u, v, grid, camera, radius_m, centre, lean_x, lean_y, row, rings, rays):
    """Brightness in linear light (rings, rays) at even steps from the middle of a sphere's outline to the outline."""
    out, outline = np.zeros((rings, rays), np.float32), np.empty((rays, 2))
    if not set_outline(centre[0], centre[1], centre[2], radius_m, camera, outline):
        return out
    _lean(outline, lean_x, lean_y, row)
    x0 = y0 = 0.0
    for n in range(rays):
        x0, y0 = x0 + outline[n, 0] / rays, y0 + outline[n, 1] / rays
    for k in range(rings):
        part = k / (rings - 1.0)
        for n in range(rays):
            x, below = x0 + part * (outline[n, 0] - x0), y0 + part * (outline[n, 1] - y0)
            blue, green, red = bgr_at(y, u, v, grid, x, below)
            luma = 0.114 * clipped(blue) + 0.587 * clipped(green) + 0.299 * clipped(red)
            out[k, n] = to_linear(luma / 255.0)
    return out


@kernel(
    None, PLANE, PLANE, PLANE, GRID, _F1, F8, _F1, F8, F8, F8, F8, F8, F8, F8, F8, _F1, _F1, F8, _F1, array(F4, 2),
    array(BOOL, 1), F8[:, ::1],
)  # fmt: skip
def _misfits(
    y, u, v, grid, camera, radius_m, centre, lean_x, lean_y, row, r_px, reach_px, way_x, way_y, believed, softnesses,
    exposures, sigma, params, shading, shown, out,
):  # fmt: skip
    outline = np.empty((len(shown), 2))
    if not set_outline(centre[0], centre[1], centre[2], radius_m, camera, outline):
        return False
    _lean(outline, lean_x, lean_y, row)
    return misfits_into(
        y, u, v, grid, outline, r_px, reach_px, way_x, way_y, believed, softnesses, exposures, sigma, params, shading,
        shown, out,
    )  # fmt: skip


@inner
def _shared(length_px, rays, r_px):
    """How many rays share an error: neighbours see the same pixels, so that on a small marker many tell no more than a
    few."""
    return max(1.0, length_px * rays / (2.0 * math.pi * r_px))


@inner
def _condition(covariance, axis, sd):
    """The covariance (3, 3) given a value along an axis (3,) with this standard deviation, in place."""
    across = np.zeros(3)
    variance = sd * sd
    for i in range(3):
        for j in range(3):
            across[i] += covariance[i, j] * axis[j]
        variance += axis[i] * across[i]
    for i in range(3):
        for j in range(3):
            covariance[i, j] -= across[i] * across[j] / variance


@inner
def _set_jacobian(camera, x, y, z, r_px, out):
    """d xyz / d (x, y, r), metres a pixel, for a narrow cone: sideways by z / f, along the ray by z / r."""
    out[:] = 0.0
    out[0, 0], out[1, 1] = z / camera[0], z / camera[1]
    out[0, 2], out[1, 2], out[2, 2] = -x / r_px, -y / r_px, -z / r_px


@inner
def _circle_sd(camera, x, y, z, r_px, covariance):
    """Standard deviations (x, y, r) in pixels of the circle of a sphere with this covariance (3, 3)."""
    back = np.zeros((3, 3))  # the inverse of the jacobian
    back[2, 2] = -r_px / z
    back[0, 0], back[0, 2] = camera[0] / z, -camera[0] * x / (z * z)
    back[1, 1], back[1, 2] = camera[1] / z, -camera[1] * y / (z * z)
    sd = np.zeros(3)
    for i in range(3):
        for a in range(3):
            for b in range(3):
                sd[i] += back[i, a] * covariance[a, b] * back[i, b]
        sd[i] = math.sqrt(max(sd[i], 0.0))
    return sd[0], sd[1], sd[2]


@kernel(
    None, PLANE, PLANE, PLANE, GRID, _F1, _F1, _F1, F8, F8, I8, _F1, array(F4, 2),
    F8, F8, F8, F8, F8, F8, F8, F8, F8, F8, F8, F8, F8,
)  # fmt: skip
def _sharpened(
    y, u, v, grid, camera, params, unsure, radius_m, sigma, rays, limits, shading,
    x_px, y_px, r_px, reach_px, close, hold, known_m, known_sd, blur_x, blur_y, lean_x, lean_y, stretch_sd,
):  # fmt: skip
    """`Outline.sharpened`: the number of edge points (0 for none), circle, its deviations,
    centre and covariance, both again by the outline alone; edges (rays, 7): x, y, sd, ray, offset, weight, outside, in
    pixels; share seen, rays inside the picture, explained."""
    points, sd, ray, offset = np.empty((rays, 2)), np.empty(rays), np.empty(rays), np.empty(rays)
    directions, weights, outside = np.empty((rays, 3)), np.empty(rays), np.empty(rays)
    edges, centre, alone, start = np.zeros((rays, 7)), np.zeros(3), np.zeros(3), np.zeros(3)
    covariance, both = np.zeros((3, 3)), np.zeros((3, 3))
    none = (0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), centre, both, alone, covariance, edges, (0.0, 0.0, 0.0))
    shrunk = math.sqrt(1.0 - lean_y)
    start[0], start[1], start[2] = sphere_at(x_px, y_px, r_px * shrunk, radius_m, camera)
    found_x, found_y, found_r = x_px, y_px, r_px
    count, in_picture, explained = 0, 0, 0.0
    for look in range(_LOOKS):
        coarse = look == 0 and reach_px > close
        outline = np.empty((rays // 2 if coarse else rays, 2))
        if not set_outline(start[0], start[1], start[2], radius_m, camera, outline):
            return none
        _lean(outline, lean_x, lean_y, found_y)
        reach = reach_px if coarse else close
        count, in_picture, explained = edges_into(
            y, u, v, grid, outline, r_px, reach, blur_x, blur_y, limits, sigma, params, coarse, shading,
            points, sd, ray, offset,
        )  # fmt: skip
        if count == 0:
            return none
        for k in range(count):
            late = points[k, 1] - found_y
            a, b = normal_of(camera, points[k, 0] - lean_x * late, points[k, 1] - lean_y * late)
            length = math.sqrt(1.0 + a * a + b * b)
            directions[k, 0], directions[k, 1], directions[k, 2] = a / length, b / length, 1.0 / length
            sd[k] /= camera[0]
        near = not coarse and look > 0
        # What is known of the distance counts against what the outline says of it: rays share errors, and what hides a
        # part of the outline moves the rest of it.
        hidden = _PART_HIDDEN * max(0.0, 0.8 - count / len(outline))
        worse = _shared(unsure[0], rays, r_px) * (1.0 + (hidden / _WHOLE_SD) ** 2)
        known_sd_m = known_sd * known_m / math.sqrt(worse)
        if not fit_rays(
            directions[:count], sd[:count], radius_m, start, reach / 0.1, FIT_ROUNDS, IMPERFECTION, hold,
            known_m, known_sd_m, near, centre, covariance, alone, weights[:count], outside[:count],
        ):  # fmt: skip
            return none
        start[:] = centre
        before_x, before_y, before_r = found_x, found_y, found_r
        found_x, found_y, found_r = circle_at(centre[0], centre[1], centre[2], radius_m, camera)
        if not 0.5 < found_r / r_px < 2.0:
            return none
        found_r /= shrunk
        if not math.hypot(found_x - x_px, found_y - y_px) <= 1.5 * r_px:
            return none
        moved = math.hypot(found_x - before_x, found_y - before_y) + abs(found_r - before_r)
        if not coarse and moved < min(_SETTLED_PX, 0.04 * r_px):
            break
    seen = 0
    for k in range(count):
        seen += weights[k] > AGREES
        edges[k, 0], edges[k, 1], edges[k, 2], edges[k, 3] = points[k, 0], points[k, 1], sd[k] * camera[0], ray[k]
        edges[k, 4], edges[k, 5], edges[k, 6] = offset[k], weights[k], outside[k] * camera[0]
    visible = seen / rays
    shared = _shared(unsure[0], rays, found_r)
    hidden = _PART_HIDDEN * max(0.0, 0.8 - visible)  # what hides a part may pass for its outline
    unsure_r = math.hypot(unsure[1], found_r * math.hypot(0.5 * stretch_sd, hidden))
    jacobian = np.empty((3, 3))
    _set_jacobian(camera, centre[0], centre[1], centre[2], found_r, jacobian)
    for i in range(3):
        for j in range(3):
            covariance[i, j] *= shared
            for k in range(3):
                deviation = unsure_r if k == 2 else unsure[1]
                covariance[i, j] += jacobian[i, k] * jacobian[j, k] * deviation * deviation
    length = math.sqrt(centre[0] * centre[0] + centre[1] * centre[1] + centre[2] * centre[2])
    for i in range(3):
        for j in range(3):
            both[i, j] = covariance[i, j]
    if finite(known_sd):
        _condition(both, centre / length, known_sd * known_m)
    # Frame after frame, what hides a part is wrong by about as much: to the filter, which takes errors of frames as
    # independent, all those frames together tell no more than one.
    more = (_ALIKE - 1.0) * (found_r * hidden) ** 2
    for i in range(3):
        for j in range(3):
            covariance[i, j] += jacobian[i, 2] * jacobian[j, 2] * more
    deviations = _circle_sd(camera, centre[0], centre[1], centre[2], found_r, both)
    return (
        count, (found_x, found_y, found_r), deviations, centre, both, alone, covariance, edges,
        (visible, float(in_picture), explained),
    )  # fmt: skip
