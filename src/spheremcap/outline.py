"""From a proposed circle to a measured sphere: the edges around it, the cone through them, and how sure that is."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spheremcap.core.camera import Camera
from spheremcap.core.circle import Circle
from spheremcap.core.frame import Patch
from spheremcap.detection.edge import EdgeConfig, EdgePoints, find_edges
from spheremcap.detection.shutter import AT_REST, Motion
from spheremcap.positioning.sphere import (
    PositionConfig,
    circle_of_sphere,
    fit_sphere,
    outline_px,
    sphere_of_circle,
    thesis_position,
)

FloatArray = npt.NDArray[np.float64]
Mask = npt.NDArray[np.uint8]

SOFTNESS_LOOKS = (3, 6, 12, 24, 48, 96)
"""Verified frames after which to look again how soft the lens is."""
_SOFTNESS = (1.0, 1.6, 2.4, 3.6)  # blurs tried, in `blur_sigma_px`
_HOLD = {"seed": 0.03, "acquire": 0.1, "colour": 0.1}  # relative deviation of the proposals' sizes; 0.01 for others
_PART_HIDDEN = 0.1  # relative deviation of the radius, a share of the outline that is not seen
_SIZE_CHANGE = 0.1  # of the radius from one frame to the next: as much is usual
_SIZE_LEAP = 1.5  # most that a claim's size may differ from the first proposal's, either way
_SETTLED_PX = 0.5  # a fine look that moved the circle less than this is not repeated
_NONE = np.zeros(0)
_NO_EDGES = EdgePoints(np.zeros((0, 2)), _NONE, np.zeros(0, np.intp), _NONE, 0, 0.0)


@dataclass(frozen=True, slots=True)
class Measured:
    """A circle (pixels, as seen), its place in space (optical frame) and what speaks for it.

    `visible` is the share of the outline that shows an edge, `edge_weights` (N,) and `edges_outside_px` (N,) what the
    fit made of the edge points: weight in [0, 1], and how far outside the fitted outline.
    """

    circle: Circle
    circle_sd_px: tuple[float, float, float]
    xyz_cam_m: FloatArray
    covariance_m2: FloatArray
    visible: float
    proposer: str
    edges: EdgePoints
    edge_weights: FloatArray
    edges_outside_px: FloatArray


class Outline:
    """Measures one marker's outline, and learns how soft lens and focus are where that is not fixed."""

    def __init__(self, radius_m: float, camera: Camera, edge: EdgeConfig, position: PositionConfig) -> None:
        self._radius_m, self._camera, self._position = radius_m, camera, position
        self._options = [
            edge.model_copy(update={"blur_sigma_px": edge.blur_sigma_px * softness})
            for softness in (_SOFTNESS if edge.learn_blur else _SOFTNESS[:1])
        ]
        self._edge = self._options[0]
        self._looks, self._explained = 0, np.zeros(len(self._options))

    def clicked(self, circle: Circle) -> Measured:
        """A person's circle as it is: a careful click is good to about a pixel."""
        xyz = sphere_of_circle(circle, self._radius_m, self._camera)
        covariance = self._covariance(circle, xyz, np.ones(3))
        return Measured(circle, (1.0, 1.0, 1.0), xyz, covariance, 0.0, "seed", _NO_EDGES, _NONE, _NONE)

    def first_look(self, patch: Patch, circle: Circle) -> Measured | None:
        """The seed sharpened, with the blur that explains its outline best."""
        best: Measured | None = None
        for option in self._options:
            before, self._edge = self._edge, option
            measured = self.sharpened(patch, circle, "seed", 0.25 * circle.r_px, AT_REST, None)
            if clearness(measured) > clearness(best) + 0.02:
                best = measured
            else:
                self._edge = before
        return best

    def learn_softness(self, patch: Patch, claim: Measured, motion: Motion) -> None:
        """Look again how soft lens and focus are, now that the motion is known, by what explains the outline."""
        if len(self._options) == 1:
            return
        outline = outline_px(claim.xyz_cam_m, self._radius_m, self._camera, self._edge.rays)
        outline, close_px = motion.seen(outline, claim.circle.y_px), self.close_px(claim.circle)
        for k, option in enumerate(self._options):
            edges = find_edges(patch, outline, claim.circle.r_px, close_px, motion.blur_px, None, option)
            self._explained[k] += 0.0 if edges is None else edges.explained
        # The sharpest that is about as good as the best: too soft a step takes a dark limb for blur.
        self._looks += 1
        good = self._explained >= self._explained.max() - 0.01 * self._looks
        self._edge = self._options[int(good.argmax())]

    def longest(
        self, patch: Patch, proposals: Sequence[tuple[str, Circle]], motion: Motion, mask: Mask | None
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
            measured = self.sharpened(patch, circle, name, 0.2 * circle.r_px + 1, motion, mask)
            if measured is None or not 1 / _SIZE_LEAP < measured.circle.r_px / usual_r_px < _SIZE_LEAP:
                continue
            # The longest outline, not the largest share: a circle on a part of the marker shows more, of less. And
            # not much larger or smaller than expected: what covers a marker has an outline too.
            leap = float(np.log(measured.circle.r_px / usual_r_px)) / _SIZE_CHANGE
            arc_px = measured.visible * min(measured.circle.r_px, usual_r_px) / (1 + leap * leap)
            if best is None or arc_px > best_arc_px:
                best, best_arc_px = measured, arc_px
            if best_arc_px > 0.75 * usual_r_px:
                break
        return best

    def sharpened(
        self, patch: Patch, circle: Circle, proposer: str, reach_px: float, motion: Motion, mask: Mask | None
    ) -> Measured | None:
        """Edges around a circle and the sphere through them: a coarse look up to `reach_px` away, unless that is close,
        then fine ones close by until the circle rests. None when there is no outline."""
        radius, camera, rays = self._radius_m, self._camera, self._edge.rays
        xyz = sphere_of_circle(motion.still_circle(circle), radius, camera)
        close = self.close_px(circle)
        hold = _HOLD.get(proposer, 0.01)
        found, edges, fit = circle, None, None
        for look in range(3):
            coarse = look == 0 and reach_px > close
            outline = outline_px(xyz, radius, camera, rays // 2 if coarse else rays)
            if not np.isfinite(outline).all():
                return None
            outline = motion.seen(outline, found.y_px)
            reach = reach_px if coarse else close
            edges = find_edges(patch, outline, circle.r_px, reach, motion.blur_px, mask, self._edge, coarse)
            if edges is None:
                return None
            fit = fit_sphere(
                camera.rays(motion.still(edges.points_px, found.y_px)),
                edges.sd_px / camera.fx_px,
                radius,
                xyz,
                loose=reach / 0.1,
                hold=hold,
                near=not coarse and look > 0,
            )
            if fit is None:
                return None
            before, xyz = found, fit.xyz_cam_m
            seen = circle_of_sphere(xyz, radius, camera)
            if seen is None or not 0.5 < seen.r_px / circle.r_px < 2:
                return None
            found = motion.seen_circle(seen)
            if found.distance(circle) > 1.5 * circle.r_px:
                return None
            moved_px = found.distance(before) + abs(found.r_px - before.r_px)
            if not coarse and moved_px < min(_SETTLED_PX, 0.04 * circle.r_px):
                break
        assert edges is not None
        assert fit is not None
        visible = float((fit.weights > 0.3).sum()) / rays
        # Neighbouring rays share the pixels, so that on a small marker many rays tell no more than a few.
        shared = max(1.0, self._position.shared_px * rays / (2 * np.pi * found.r_px))
        unsure = np.full(3, self._position.systematic_px)
        hidden = _PART_HIDDEN * max(0.0, 0.8 - visible)  # what hides a part may pass for its outline
        unsure[2] = np.hypot(unsure[2], found.r_px * np.hypot(0.5 * motion.stretch_sd, hidden))
        covariance = shared * fit.covariance_m2 + self._covariance(found, xyz, unsure)
        xyz = self._placed(motion.still_circle(found), xyz)
        outside_px = fit.outside_rad * camera.fx_px
        sd = self._circle_sd(found, xyz, covariance)
        return Measured(found, sd, xyz, covariance, visible, proposer, edges, fit.weights, outside_px)

    @staticmethod
    def close_px(circle: Circle) -> float:
        """How far from its outline the fine look reaches, pixels: a large marker's outline is less exactly round."""
        return max(1.5, 0.05 * circle.r_px)

    def _placed(self, circle: Circle, xyz: FloatArray) -> FloatArray:
        """The sphere's centre by the formula of the settings; `xyz` is that of the edge rays."""
        position = self._position
        if position.formula == "edges":
            return xyz
        if position.formula == "circle":
            return sphere_of_circle(circle, self._radius_m, self._camera)
        size = self._radius_m if position.thesis_size == "radius" else 2 * self._radius_m
        return thesis_position(circle, size, position.thesis_constant_px, self._camera)

    def _covariance(self, circle: Circle, xyz: FloatArray, sd_px: FloatArray) -> FloatArray:
        """Covariance (3, 3) in metres of a sphere at `xyz` whose circle has these deviations (x, y, r) in pixels."""
        jacobian = self._jacobian(circle, xyz) * sd_px
        return jacobian @ jacobian.T

    def _circle_sd(self, circle: Circle, xyz: FloatArray, covariance_m2: FloatArray) -> tuple[float, float, float]:
        """Standard deviations (x, y, r) in pixels of the circle of a sphere at `xyz` with this covariance."""
        back = np.linalg.inv(self._jacobian(circle, xyz))
        x, y, r = np.sqrt(np.maximum(np.diag(back @ covariance_m2 @ back.T), 0))
        return float(x), float(y), float(r)

    def _jacobian(self, circle: Circle, xyz: FloatArray) -> FloatArray:
        """d xyz / d (x, y, r), metres a pixel, for a narrow cone: sideways by z / f, along the ray by z / r."""
        z = xyz[2]
        return np.array(
            [
                [z / self._camera.fx_px, 0, -xyz[0] / circle.r_px],
                [0, z / self._camera.fy_px, -xyz[1] / circle.r_px],
                [0, 0, -z / circle.r_px],
            ]
        )


def clearness(measured: Measured | None) -> float:
    """How clear an outline is: the share of it with an edge, and how well the blurred step explains that."""
    return -1.0 if measured is None else measured.visible + measured.edges.explained
