"""One marker, one frame: the method on one page.

predict -> KCF -> points -> Hough and colour -> edges -> claim -> six votes -> verdict -> metres -> Kalman update.
A miss is data, never an exception. Nothing here reads files, logs or draws.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from pydantic import Field

from spheremcap.core.camera import Camera
from spheremcap.core.circle import Circle
from spheremcap.core.estimate import MarkerEstimate, Status
from spheremcap.core.frame import Frame, Patch, Window
from spheremcap.core.marker import MarkerSpec
from spheremcap.core.stage import StageConfig
from spheremcap.core.time import NS_PER_S
from spheremcap.core.view import ResponseMap, StageView
from spheremcap.core.vote import Verdict, Vote
from spheremcap.detection.acquire import AcquireConfig, acquire
from spheremcap.detection.colour import (
    ColourBox,
    ColourConfig,
    colour_circle,
    disc_mask,
    disc_pixels,
    learn_box,
)
from spheremcap.detection.edge import EdgeConfig, EdgePoints, find_edges
from spheremcap.detection.hough import HoughConfig, hough_circles
from spheremcap.detection.shutter import AT_REST, Motion, Shutter
from spheremcap.positioning.kalman import KalmanConfig, Moment, Track3D
from spheremcap.positioning.sphere import (
    PositionConfig,
    circle_of_sphere,
    fit_sphere,
    outline_px,
    sphere_of_circle,
    thesis_position,
)
from spheremcap.tracking.kcf import Kcf, KcfConfig
from spheremcap.tracking.points import PointsConfig, geometry_scale
from spheremcap.verification.jury import JuryConfig, cast_votes, judge, vote_sum
from spheremcap.verification.matching import MatchingConfig, Template, make_template, match

FloatArray = npt.NDArray[np.float64]


class PolicyConfig(StageConfig):
    """When a marker is lost and how far it is looked for (docs/method.md section 5)."""

    lost_after: int = Field(5, ge=1, description="unverified frames in a row that mean LOST")
    immediate: bool = Field(False, description="true: lost at the first sum below TH2 (thesis line 1143)")
    out_of_view_s: float = Field(1.0, ge=0, description="seconds out of the picture before it counts as LOST")


class ChainConfig(StageConfig):
    """The stages' own settings, side by side."""

    kcf: KcfConfig = KcfConfig()
    points: PointsConfig = PointsConfig()
    hough: HoughConfig = HoughConfig()
    colour: ColourConfig = ColourConfig()
    edge: EdgeConfig = EdgeConfig()
    acquire: AcquireConfig = AcquireConfig()
    matching: MatchingConfig = MatchingConfig()
    jury: JuryConfig = JuryConfig()
    position: PositionConfig = PositionConfig()
    kalman: KalmanConfig = KalmanConfig()
    policy: PolicyConfig = PolicyConfig()


@dataclass(frozen=True, slots=True)
class _Measured:
    """A circle with its place in space and what speaks for it."""

    circle: Circle
    circle_sd_px: tuple[float, float, float]
    xyz_cam_m: FloatArray
    covariance_m2: FloatArray
    visible: float
    proposer: str
    edges: EdgePoints
    edge_weights: FloatArray
    edges_outside_px: FloatArray  # of the outline


class MarkerChain:
    """The chain of one marker. `seed` first, then `step` for every later frame in order.

    `metric` False means that the camera is only assumed: tracking works, but no metres are given out.
    `exposure_s` is the exposure time; 0 when it is not known: it is then learnt from how blurred the
    marker's outline is while it moves. `readout_s` is the time from the first row's exposure to the last one's (rolling
    shutter, 0 for a global one); None when it is not known: it is then learnt, and until then distances are less sure
    while the marker moves up or down. `view` holds the last frame's StageView when `step` was asked to keep it.
    """

    def __init__(
        self,
        spec: MarkerSpec,
        camera: Camera,
        config: ChainConfig,
        exposure_s: float = 0.0,
        metric: bool = True,
        readout_s: float | None = None,
    ) -> None:
        self.spec, self.camera, self.config, self.metric = spec, camera, config, metric
        self._shutter = Shutter(readout_s, camera.height_px)
        self.exposure_s = exposure_s
        self._exposure_known = exposure_s > 0
        self.view: StageView | None = None
        self.misses = 0  # unverified frames in a row
        self._track = Track3D(config.kalman)
        self._edge = config.edge
        self._forget()

    def _forget(self) -> None:
        self._kcf = Kcf(self.config.kcf)
        self._edge = self.config.edge
        self._template: Template | None = None
        self._box: ColourBox | None = None
        self._box_value = self._gain = 1.0
        self._seed_shares, self._seed_visible = (1.0, 0.0), 1.0
        self._seed_template: Template | None = None
        self._status = Status.LOST
        self._last: Circle | None = None  # as last verified
        self._verified = self._moving = self._looks = 0
        self._explained = np.zeros(len(_SOFTNESS))
        self._stamp_ns = 0
        self._seen = Moment(0, np.zeros(6), np.zeros((6, 6)))  # the filter's state when last verified
        self._before: tuple[Patch, Circle] | None = None  # the previous frame's, when it was verified
        self._taken: Sequence[Circle] = ()

    @property
    def moment(self) -> Moment | None:
        """The Kalman filter's state at the last frame; None while the marker is lost or out of view."""
        return self._track.now if self._track.started and self._status.value not in ("LOST", "OUT_OF_VIEW") else None

    @property
    def range_m(self) -> float:
        """How far away the filter has the marker, metres; infinite while it is lost or out of view."""
        moment = self.moment
        return float("inf") if moment is None else float(np.linalg.norm(moment.xyz_cam_m))

    # -- what a person gives ------------------------------------------------------------------------------------

    def seed(self, frame: Frame, circle: Circle) -> MarkerEstimate:
        """Start (again) from a person's circle on this frame; the edge step sharpens it where it agrees with it."""
        self._forget()
        patch = Patch(frame, Window.around(circle, self._kcf.half_side_px(circle.r_px) + 2))
        self._box = learn_box(disc_pixels(patch, circle, self.config.colour.sample), self.config.colour)
        measured = self._first_look(patch, circle)
        if measured is None or measured.circle.dice(circle) < 0.7:
            xyz = sphere_of_circle(circle, self.spec.radius_m, self.camera)
            sd = np.array([1.0, 1.0, 1.0])  # a careful click is good to about a pixel
            covariance = self._circle_covariance(circle, xyz, sd)
            measured = _Measured(circle, (1.0, 1.0, 1.0), xyz, covariance, 0.0, "seed", _NO_EDGES, _NONE, _NONE)
        pixels = disc_pixels(patch, measured.circle, self.config.colour.sample)
        self._box = learn_box(pixels, self.config.colour)
        self._box_value = max(1.0, float(np.median(pixels[:, 2])))
        self._seed_shares = self._colour_shares(patch, measured.circle)
        self._seed_visible = max(measured.visible, 0.2)
        self._seed_template = make_template(patch, measured.circle, self.config.matching)
        self._track.start(frame.stamp_ns, measured.xyz_cam_m, measured.covariance_m2)
        self._accept(frame, patch, measured, Status.SEEDED)
        self.view = None
        return self._estimate(frame, Status.SEEDED, measured, claim=circle, search=patch.window)

    def _learn_softness(self, patch: Patch, claim: _Measured, motion: Motion) -> None:
        """Look again how soft lens and focus are, now that the motion is known, by what explains the outline."""
        if not self.config.edge.learn_blur:
            return
        outline = outline_px(claim.xyz_cam_m, self.spec.radius_m, self.camera, self.config.edge.rays)
        outline = motion.seen(outline, claim.circle.y_px)
        options = [
            self.config.edge.model_copy(update={"blur_sigma_px": self.config.edge.blur_sigma_px * softness})
            for softness in _SOFTNESS
        ]
        for k, edge in enumerate(options):
            edges = find_edges(patch, outline, claim.circle.r_px, self._close(claim.circle), motion.blur_px, None, edge)
            self._explained[k] += 0.0 if edges is None else edges.explained
        # The sharpest that is about as good as the best: too soft a step takes a dark limb for blur.
        self._looks += 1
        good = self._explained >= self._explained.max() - 0.01 * self._looks
        self._edge = options[int(good.argmax())]

    def _first_look(self, patch: Patch, circle: Circle) -> _Measured | None:
        """The seed sharpened; how soft the lens and focus are is learnt from which blur explains the outline best."""
        best: _Measured | None = None
        for softness in _SOFTNESS if self.config.edge.learn_blur else _SOFTNESS[:1]:
            sigma = self.config.edge.blur_sigma_px * softness
            edge = self.config.edge.model_copy(update={"blur_sigma_px": sigma})
            before, self._edge = self._edge, edge
            measured = self._refine(patch, circle, "seed", 0.25 * circle.r_px, AT_REST, None)
            if _outline_score(measured) > _outline_score(best) + 0.02:
                best = measured
            else:
                self._edge = before
        return best

    # -- one frame ----------------------------------------------------------------------------------------------

    def step(self, frame: Frame, keep_view: bool = False, taken: Sequence[Circle] = ()) -> MarkerEstimate:
        """Where the marker is on the next frame; not at a circle `taken` by another marker, which would hide it.

        Raises RuntimeError before the first seed.
        """
        if self._template is None or self._last is None:
            raise RuntimeError(f"{self.spec.name} has not been seeded")
        self.view, self._taken = None, taken
        if self._status in (Status.LOST, Status.OUT_OF_VIEW):
            return self._search(frame, keep_view)

        interval_s = (frame.stamp_ns - self._stamp_ns) / NS_PER_S
        self._stamp_ns = frame.stamp_ns
        predicted, spread_px, rate_px = self._predict(frame.stamp_ns)
        if predicted is None:
            return self._miss(frame, None, None)
        motion = self._shutter.motion(rate_px, self.exposure_s, interval_s)
        predicted = motion.seen_circle(predicted)
        reach = float(np.clip(3 * spread_px, 0.5 * predicted.r_px, 3 * predicted.r_px))
        patch = Patch(frame, Window.around(predicted, self._kcf.half_side_px(predicted.r_px) + reach))

        # Where to look: KCF around the prediction, the size from points on the marker.
        followed = self._kcf.locate(patch, predicted, reach).circle if self.config.kcf.enabled else predicted
        r_px = predicted.r_px
        if self._before is not None and self.config.points.enabled:
            ratio = geometry_scale(*self._before, patch, followed, self.config.points)
            if ratio is not None:
                r_px = float(np.clip(self._before[1].r_px * ratio, 0.9 * r_px, 1.1 * r_px))
        followed = replace(followed, r_px=r_px)

        # What is there: circles by gradient and by colour, then sub-pixel edges on whichever has an outline.
        mask = self._mask(patch, followed)
        hough = hough_circles(patch, followed, self.config.hough) if self.config.hough.enabled else ()
        colour = colour_circle(mask, patch, predicted) if mask is not None else None
        proposals = [("kcf", followed), ("prediction", predicted)]
        proposals += [("colour", colour)] if colour is not None else []
        proposals += [("hough", hough[0])] if hough else []
        close = self._close(predicted)
        claim = None
        if spread_px < max(2.0, 0.15 * predicted.r_px) and predicted.dice(followed) > 0.8:  # they agree: look close by
            claim = self._refine(patch, predicted, "prediction", close, motion, mask)
        if claim is None or claim.visible < 0.6:
            claim = self._claim(patch, proposals, motion, mask)
        if not self._exposure_known:
            claim = self._learn_exposure(patch, proposals, motion, rate_px * interval_s, interval_s, mask, claim)
        if claim is not None and claim.visible > 0.6:
            if self._verified in _SOFTNESS_LOOKS:
                self._learn_softness(patch, claim, motion)
            if claim.proposer == "prediction":
                points, outside = claim.edges.points_px, claim.edges_outside_px
                self._shutter.learn(points, outside, claim.edge_weights, claim.circle, motion, rate_px)
        return self._decide(frame, patch, predicted, reach, claim, proposals, mask, hough, keep_view)

    def _search(self, frame: Frame, keep_view: bool) -> MarkerEstimate:
        """Look for a lost marker by colour and shape, no further than it can have gone."""
        assert self._last is not None
        assert self._box is not None
        expected_m, tolerance_m = self._whereabouts(frame.stamp_ns)
        size_change = 0.15 + 2.0 * (frame.stamp_ns - self._seen.stamp_ns) / NS_PER_S
        centre = circle_of_sphere(expected_m, self.spec.radius_m, self.camera) or self._last
        reach = 3 * self._last.r_px + tolerance_m * self._last.r_px / self.spec.radius_m
        region = Window.around(centre, min(reach, 2.0 * max(frame.width_px, frame.height_px)))
        for candidate in acquire(frame, self._box, self._gain, self._last, region, self.config.acquire):
            usual = replace(candidate, r_px=self._last.r_px)
            patch = Patch(frame, Window.around(usual, self._kcf.half_side_px(max(usual.r_px, candidate.r_px))))
            mask = self._mask(patch, candidate)
            # As large as it was, should a part be hidden; and as large as the blob.
            proposals = [("acquire", usual), ("colour", candidate)]
            claim = self._claim(patch, proposals, AT_REST, mask)
            if claim is None:
                continue
            slack_m = tolerance_m + 3 * float(np.sqrt(np.trace(claim.covariance_m2)))
            if float(np.linalg.norm(claim.xyz_cam_m - expected_m)) > slack_m:
                continue
            if abs(np.log(claim.circle.r_px / self._last.r_px)) > size_change:
                continue
            reach = 0.75 * candidate.r_px
            if self._is_taken(claim.circle):
                continue
            estimate = self._decide(frame, patch, candidate, reach, claim, proposals, mask, (), keep_view, lost=True)
            if estimate.status is Status.VERIFIED:
                return estimate
        return self._miss(frame, None, None)

    def _whereabouts(self, stamp_ns: int) -> tuple[FloatArray, float]:
        """Where a lost marker would be had it moved on evenly (3,), and how far from there it can be, in metres.

        One that left the picture comes back where it went out: it is expected there, give or take the way it can go.
        """
        age_s = (stamp_ns - self._seen.stamp_ns) / NS_PER_S
        variance = np.diag(self._seen.covariance)
        drift_m = float(np.sqrt(variance[:3].max() + variance[3:].max() * age_s**2))
        swerve_m = 0.5 * self.config.kalman.acceleration_mps2 * age_s**2
        way_m = self._seen.velocity_cam_mps * age_s
        tolerance_m = 2 * self.spec.radius_m + 3 * drift_m + swerve_m
        if self._status is Status.OUT_OF_VIEW:
            return self._seen.xyz_cam_m, tolerance_m + float(np.linalg.norm(way_m))
        return self._seen.xyz_cam_m + way_m, tolerance_m

    # -- the parts of a step --------------------------------------------------------------------------------------

    def _predict(self, stamp_ns: int) -> tuple[Circle | None, float, FloatArray]:
        """Predicted circle, its standard deviation in px (largest of x, y) and its velocity (2,) in px/s."""
        moment = self._track.predict(stamp_ns)
        xyz, velocity = moment.xyz_cam_m, moment.velocity_cam_mps
        circle = circle_of_sphere(xyz, self.spec.radius_m, self.camera)
        if circle is None:
            return None, 0.0, np.zeros(2)
        if self._last is not None:  # a wild depth must not make a wild patch
            circle = replace(circle, r_px=float(np.clip(circle.r_px, self._last.r_px / 2, self._last.r_px * 2)))
        lateral_m = float(np.sqrt(max(moment.covariance[0, 0], moment.covariance[1, 1])))
        short_s = 1e-4
        ends = self.camera.project(xyz + np.outer((-0.5, 0.5), velocity * short_s))
        return circle, lateral_m / xyz[2] * self.camera.fx_px, (ends[1] - ends[0]) / short_s

    def _learn_exposure(
        self,
        patch: Patch,
        proposals: list[tuple[str, Circle]],
        motion: Motion,
        way_px: FloatArray,
        interval_s: float,
        mask: npt.NDArray[np.uint8] | None,
        claim: _Measured | None,
    ) -> _Measured | None:
        """Try other exposure times on a marker that moves by `way_px` (2,) in a frame interval, now and then or when
        its outline is hard to see.

        Keeps the time whose blur explains the outline best, and the claim made with it.
        """
        shows = float(np.hypot(*way_px)) > _BLUR_SHOWS_PX
        self._moving += shows
        clear = claim is not None and claim.visible > 0.5
        if not shows or (clear and self._moving % 8):
            return claim
        best, best_score = claim, _outline_score(claim)
        for share in _EXPOSURES:
            other = self._claim(patch, proposals, replace(motion, blur_px=way_px * share), mask)
            if _outline_score(other) > best_score + 0.02:
                best, best_score = other, _outline_score(other)
                self.exposure_s = share * interval_s
        return best

    def _mask(self, patch: Patch, near: Circle) -> npt.NDArray[np.uint8] | None:
        """The colour mask of the patch; the exposure may have changed, so the brightness is looked up once more."""
        if not self.config.colour.enabled or self._box is None:
            return None
        mask = self._box.mask(patch.hsv, self._gain)
        disc = disc_mask(patch, near, 0.6)
        if disc.any() and mask[disc].mean() < 0.3 * 255:
            gain = float(np.clip(np.median(patch.hsv[disc][:, 2]) / self._box_value, 0.1, 4))
            again = self._box.mask(patch.hsv, gain)
            if again[disc].mean() > 0.5 * 255:
                mask = again
        return mask

    def _claim(
        self,
        patch: Patch,
        proposals: list[tuple[str, Circle]],
        motion: Motion,
        mask: npt.NDArray[np.uint8] | None,
    ) -> _Measured | None:
        """The proposal whose neighbourhood shows the most outline, sharpened; proposals alike are tried once."""
        best: _Measured | None = None
        best_arc_px = 0.0
        usual_r_px = proposals[0][1].r_px
        tried: list[Circle] = []
        for name, circle in proposals:
            if any(circle.dice(other) > 0.85 for other in tried):
                continue
            tried.append(circle)
            measured = self._refine(patch, circle, name, 0.2 * circle.r_px + 1, motion, mask)
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

    def _refine(
        self,
        patch: Patch,
        circle: Circle,
        proposer: str,
        reach_px: float,
        motion: Motion,
        mask: npt.NDArray[np.uint8] | None,
    ) -> _Measured | None:
        """Edges around a circle and the sphere through them: a coarse look up to `reach_px` away, unless that is close,
        then fine ones close by until the circle rests. None when there is no outline."""
        radius, camera, config = self.spec.radius_m, self.camera, self.config
        xyz = sphere_of_circle(motion.still_circle(circle), radius, camera)
        close = self._close(circle)
        hold = _HOLD.get(proposer, 0.01)
        found, edges, fit = circle, None, None
        for look in range(3):
            coarse = look == 0 and reach_px > close
            outline = outline_px(xyz, radius, camera, config.edge.rays // 2 if coarse else config.edge.rays)
            if not np.isfinite(outline).all():
                return None
            outline = motion.seen(outline, found.y_px)
            reach = reach_px if coarse else close
            edges = find_edges(patch, outline, circle.r_px, reach, motion.blur_px, mask, self._edge, coarse)
            if edges is None:
                return None
            rays = camera.rays(motion.still(edges.points_px, found.y_px))
            fit = fit_sphere(
                rays,
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
            if not coarse and found.distance(before) + abs(found.r_px - before.r_px) < min(
                _SETTLED_PX, 0.04 * circle.r_px
            ):
                break
        assert edges is not None
        assert fit is not None
        visible = float((fit.weights > 0.3).sum()) / config.edge.rays
        # Neighbouring rays share the pixels, so that on a small marker many rays tell no more than a few.
        shared = max(1.0, config.position.shared_px * config.edge.rays / (2 * np.pi * found.r_px))
        unsure = np.full(3, config.position.systematic_px)
        hidden = _PART_HIDDEN * max(0.0, 0.8 - visible)  # what hides a part may pass for its outline
        unsure[2] = np.hypot(unsure[2], found.r_px * np.hypot(0.5 * motion.stretch_sd, hidden))
        covariance = shared * fit.covariance_m2 + self._circle_covariance(found, xyz, unsure)
        if config.position.formula == "circle":
            xyz = sphere_of_circle(motion.still_circle(found), radius, camera)
        elif config.position.formula == "thesis":
            size = radius if config.position.thesis_size == "radius" else 2 * radius
            xyz = thesis_position(motion.still_circle(found), size, config.position.thesis_constant_px, camera)
        return _Measured(
            found,
            self._circle_sd(found, xyz, covariance),
            xyz,
            covariance,
            visible,
            proposer,
            edges,
            fit.weights,
            fit.outside_rad * camera.fx_px,
        )

    @staticmethod
    def _close(circle: Circle) -> float:
        """How far from its outline the fine look reaches, pixels: a large marker's outline is less exactly round."""
        return max(1.5, 0.05 * circle.r_px)

    def _decide(
        self,
        frame: Frame,
        patch: Patch,
        around: Circle,
        reach_px: float,
        claim: _Measured | None,
        proposals: list[tuple[str, Circle]],
        mask: npt.NDArray[np.uint8] | None,
        hough: tuple[Circle, ...],
        keep_view: bool,
        lost: bool = False,
    ) -> MarkerEstimate:
        """Six votes on the claim, the verdict, and what follows from it."""
        size = claim.circle.r_px if claim is not None and lost else around.r_px
        maps: tuple[ResponseMap, ...] = ()
        votes: tuple[Vote, ...] = ()
        total = -1.0
        # A lost marker may look as it did when last verified or as it did when a person showed it.
        near = replace(around, r_px=size)
        reach_px = min(reach_px, size)
        if claim is not None:
            reach_px = max(reach_px, claim.circle.distance(around) + 0.3 * size)
        for template in (self._template, self._seed_template) if lost else (self._template,):
            assert template is not None
            these = match(template, patch, near, reach_px, self.config.matching)
            cast = cast_votes(these, claim.circle if claim is not None else None)
            if vote_sum(cast) > total:
                maps, votes, total = these, cast, vote_sum(cast)
        verdict = judge(total, self.config.jury)
        if claim is None:
            verdict = Verdict.REJECTED
        elif verdict is Verdict.VERIFIED and not self._plausible(patch, claim, around, lost):
            verdict = Verdict.DOUBTFUL
        if keep_view:
            self.view = self._stage_view(patch, mask, hough, claim, maps)
        if claim is None or verdict is not Verdict.VERIFIED:
            return self._miss(frame, patch.window, claim, tuple(proposals), votes, total, verdict)
        if lost or not self._track.started:
            self._track.start(frame.stamp_ns, claim.xyz_cam_m, claim.covariance_m2)
        else:
            self._track.update(claim.xyz_cam_m, claim.covariance_m2)
        self._accept(frame, patch, claim, Status.VERIFIED)
        return self._estimate(
            frame, Status.VERIFIED, claim, claim.circle, patch.window, tuple(proposals), votes, total, verdict
        )

    def _plausible(self, patch: Patch, claim: _Measured, around: Circle, lost: bool) -> bool:
        """The seed's say, the outline's and the filter's: colour as seeded, edges to be seen, no leap."""
        jury = self.config.jury
        if claim.visible < min(jury.lost_visible if lost else jury.visible, 0.5 * self._seed_visible):
            return False
        if self._is_taken(claim.circle):
            return False
        if claim.visible < 0.7 and not lost and not self._like_seed(patch, claim.circle):
            return False
        if self.config.colour.enabled:
            inside, ring = self._colour_shares(patch, claim.circle)
            least = (jury.lost_colour if lost else jury.seed_colour) * max(0.4, claim.visible) * self._seed_shares[0]
            part_of_it = claim.visible < 0.6 and ring > jury.seed_around + self._seed_shares[1]
            if inside < least or part_of_it:
                return False
        if lost or self._track.inside_gate(claim.xyz_cam_m, claim.covariance_m2):
            return True
        # A clear outline hardly off the prediction is no leap, whatever a filter that has learnt a wrong speed says.
        off = claim.circle.distance(around) / around.r_px + 3 * abs(float(np.log(claim.circle.r_px / around.r_px)))
        return claim.visible > 0.7 and off < 0.6

    def _like_seed(self, patch: Patch, claim: Circle) -> bool:
        """Whether the seed's own template, at today's brightness, finds the claim too: the last template may have
        drifted with it."""
        assert self._seed_template is not None
        template = replace(self._seed_template, pixels=self._seed_template.pixels * np.float32(self._gain))
        votes = cast_votes(match(template, patch, claim, 0.6 * claim.r_px, self.config.matching), claim)
        return vote_sum(votes) > self.config.jury.seed_template * len(votes)

    def _is_taken(self, circle: Circle) -> bool:
        """Whether another marker is where this circle is, and as large in the picture."""
        return any(circle.dice(other) > _SAME for other in self._taken)

    def _accept(self, frame: Frame, patch: Patch, measured: _Measured, status: Status) -> None:
        """Learn from a verified circle: template, filter, colour gain, size."""
        circle = measured.circle
        self._status, self.misses, self._stamp_ns = status, 0, frame.stamp_ns
        self._last, self._seen = circle, self._track.now
        self._template = make_template(patch, circle, self.config.matching)
        if self._verified % self.config.kcf.train_every == 0:
            self._kcf.train(patch, circle)
        self._verified += 1
        self._before = (patch, circle)
        pixels = patch.hsv[disc_mask(patch, circle, 0.6)][None]
        assert self._box is not None
        own = replace(self._box, value=(0.0, 255.0)).mask(pixels) > 0  # not an occluder's
        values = pixels[own][:, 2]
        if len(values) > 8:
            self._gain += 0.5 * (float(np.clip(np.median(values) / self._box_value, 0.1, 4)) - self._gain)

    def _miss(
        self,
        frame: Frame,
        search: Window | None,
        claim: _Measured | None,
        proposals: tuple[tuple[str, Circle], ...] = (),
        votes: tuple[Vote, ...] = (),
        total: float | None = None,
        verdict: Verdict | None = None,
    ) -> MarkerEstimate:
        """No verified circle: the Kalman filter stands in, until the marker counts as lost or out of view."""
        self.misses += 1
        self._before = None
        policy = self.config.policy
        claimed = claim.circle if claim is not None else None
        standing_in: Circle | None = None
        if self._status in (Status.LOST, Status.OUT_OF_VIEW):
            if (frame.stamp_ns - self._seen.stamp_ns) / NS_PER_S > policy.out_of_view_s:
                self._status = Status.LOST
        else:
            moment = self._track.now
            standing_in = circle_of_sphere(moment.xyz_cam_m, self.spec.radius_m, self.camera)
            rejected = verdict is None or verdict is Verdict.REJECTED
            sure = float(moment.covariance[0, 0] ** 0.5) < 4 * self.spec.radius_m
            if sure and (standing_in is None or not self._in_picture(frame, standing_in)):
                self._status = Status.OUT_OF_VIEW
            elif self.misses >= policy.lost_after or (policy.immediate and rejected):
                self._status = Status.LOST
            else:
                self._status = Status.ESTIMATED
        estimate = self._estimate(frame, self._status, None, claimed, search, proposals, votes, total, verdict)
        if claim is not None:
            estimate = replace(estimate, visible=claim.visible, proposer=claim.proposer)
        if self._status is not Status.ESTIMATED:
            return estimate
        estimate = replace(estimate, circle=standing_in)
        if not self.metric:
            return estimate
        moment = self._track.now
        return replace(
            estimate,
            xyz_cam_m=moment.xyz_cam_m,
            covariance_m2=self._reported(moment.xyz_cam_m, moment.covariance[:3, :3]),
            velocity_cam_mps=moment.velocity_cam_mps,
        )

    # -- small facts ------------------------------------------------------------------------------------------------

    def _estimate(
        self,
        frame: Frame,
        status: Status,
        measured: _Measured | None,
        claim: Circle | None = None,
        search: Window | None = None,
        proposals: tuple[tuple[str, Circle], ...] = (),
        votes: tuple[Vote, ...] = (),
        total: float | None = None,
        verdict: Verdict | None = None,
    ) -> MarkerEstimate:
        estimate = MarkerEstimate(
            self.spec.name, frame.index, frame.stamp_ns, status,
            claim=claim, proposals=proposals, search=search, votes=votes, vote_sum=total, verdict=verdict,
        )  # fmt: skip
        if measured is None:
            return estimate
        estimate = replace(
            estimate,
            circle=measured.circle,
            circle_sd_px=measured.circle_sd_px,
            proposer=measured.proposer,
            visible=measured.visible,
        )
        if not self.metric:
            return estimate
        return replace(
            estimate,
            xyz_cam_m=measured.xyz_cam_m,
            covariance_m2=self._reported(measured.xyz_cam_m, measured.covariance_m2),
            velocity_cam_mps=self._track.now.velocity_cam_mps,
        )

    def _reported(self, xyz_cam_m: FloatArray, covariance_m2: FloatArray) -> FloatArray:
        """The covariance with the camera's own uncertainty: a wrong focal length scales the distance."""
        return covariance_m2 + np.outer(xyz_cam_m, xyz_cam_m) * self.camera.focal_sd**2

    def _circle_covariance(self, circle: Circle, xyz: FloatArray, sd_px: FloatArray) -> FloatArray:
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
                [z / self.camera.fx_px, 0, -xyz[0] / circle.r_px],
                [0, z / self.camera.fy_px, -xyz[1] / circle.r_px],
                [0, 0, -z / circle.r_px],
            ]
        )

    def _colour_shares(self, patch: Patch, circle: Circle) -> tuple[float, float]:
        """Shares of pixels in the seed's own colours, inside the circle and in a ring around it, at the exposure that
        suits the inside best. A claim on a part of the marker has its colour all around."""
        if self._box is None:
            return 1.0, 0.0
        disc = disc_mask(patch, circle, 0.9)
        ring = disc_mask(patch, circle, 1.35) & ~disc_mask(patch, circle, 1.1)
        if not disc.any():
            return 0.0, 0.0
        mask = self._box.mask(patch.hsv, self._gain)
        if mask[disc].mean() < 0.8 * 255:
            # Another exposure, as the brighter or the darker half of the disc has it when a part is hidden.
            values = patch.hsv[disc][:, 2]
            quarter = len(values) // 4
            halves = np.partition(values, (quarter, 3 * quarter))[[quarter, 3 * quarter]] / self._box_value
            masks = [mask, *(self._box.mask(patch.hsv, float(gain)) for gain in np.clip(halves, 0.1, 4))]
            mask = max(masks, key=lambda m: int(m[disc].sum()))
        return float(mask[disc].mean()) / 255, float(mask[ring].mean()) / 255 if ring.any() else 0.0

    @staticmethod
    def _in_picture(frame: Frame, circle: Circle) -> bool:
        """Whether more than a sliver of the circle lies inside the picture."""
        slack = 0.3 * circle.r_px
        return -slack < circle.x_px < frame.width_px - 1 + slack and -slack < circle.y_px < frame.height_px - 1 + slack

    def _stage_view(
        self,
        patch: Patch,
        mask: npt.NDArray[np.uint8] | None,
        hough: tuple[Circle, ...],
        claim: _Measured | None,
        maps: tuple[ResponseMap, ...],
    ) -> StageView:
        edges = claim.edges.points_px if claim is not None else np.zeros((0, 2))
        weights = claim.edge_weights if claim is not None else np.zeros(0)
        return StageView(self.spec.name, patch.window, patch.bgr, mask, hough, edges, weights, maps)


_HOLD = {"seed": 0.03, "acquire": 0.1, "colour": 0.1}  # relative deviation of the proposals' sizes; 0.01 for others
_SOFTNESS = (1.0, 1.6, 2.4, 3.6)  # blurs tried at the seed, in `blur_sigma_px`
_SOFTNESS_LOOKS = (3, 6, 12, 24, 48, 96)  # verified frames after which the softness is looked at again
_EXPOSURES = (0.0, 0.15, 0.3, 0.5, 0.75, 1.0)  # exposure times tried, in frame intervals
_BLUR_SHOWS_PX = 5.0  # motion in a frame interval from which blur can be told


def _outline_score(claim: _Measured | None) -> float:
    """How clear an outline is: the share of it with an edge, and how well the blurred step explains that."""
    return -1.0 if claim is None else claim.visible + claim.edges.explained


_SAME = 0.8  # Dice overlap from which two markers' circles are one marker, seen by both
_PART_HIDDEN = 0.1  # relative deviation of the radius, a share of the outline that is not seen
_SIZE_CHANGE = 0.1  # of the radius from one frame to the next: as much is usual
_SIZE_LEAP = 1.5  # most that a claim's size may differ from the first proposal's, either way
_SETTLED_PX = 0.5  # a fine look that moved the circle less than this is not repeated
_NONE = np.zeros(0)
_NO_EDGES = EdgePoints(np.zeros((0, 2)), np.zeros(0), np.zeros(0, np.intp), np.zeros(0), 0, 0.0)
