"""One marker, one frame: the method on one page.

predict -> KCF -> points -> Hough and colour -> edges -> claim -> six votes -> verdict -> metres -> Kalman update.
A miss is data, never an exception. Nothing here reads files, logs or draws.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from pydantic import Field

from spheremcap.appearance import Appearance
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
from spheremcap.detection.colour import ColourConfig, colour_circle
from spheremcap.detection.edge import EdgeConfig
from spheremcap.detection.hough import HoughConfig, hough_circles
from spheremcap.detection.shutter import AT_REST, Motion, Shutter
from spheremcap.outline import SOFTNESS_LOOKS, Measured, Outline, clearness
from spheremcap.positioning.kalman import KalmanConfig, Moment, Track3D
from spheremcap.positioning.sphere import PositionConfig, circle_of_sphere
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
        self._forget()

    def _forget(self) -> None:
        self._kcf = Kcf(self.config.kcf)
        self._outline = Outline(self.spec.radius_m, self.camera, self.config.edge, self.config.position)
        self._template: Template | None = None
        self._appearance: Appearance | None = None
        self._status = Status.LOST
        self._last: Circle | None = None  # as last verified
        self._verified = self._moving = 0
        self._stamp_ns, self._interval_s = 0, 1 / 30  # until two stamps say more
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
        measured = self._outline.first_look(patch, circle)
        if measured is None or measured.circle.dice(circle) < 0.7:
            measured = self._outline.clicked(circle)
        self._appearance = Appearance(
            patch, measured.circle, measured.visible, self.config.colour, self.config.matching
        )
        self._track.start(frame.stamp_ns, measured.xyz_cam_m, measured.covariance_m2)
        self._accept(frame, patch, measured, Status.SEEDED)
        self.view = None
        return self._estimate(frame, Status.SEEDED, measured, claim=circle, search=patch.window)

    # -- one frame ----------------------------------------------------------------------------------------------

    def step(self, frame: Frame, keep_view: bool = False, taken: Sequence[Circle] = ()) -> MarkerEstimate:
        """Where the marker is on the next frame; not at a circle `taken` by another marker, which would hide it.

        Raises RuntimeError before the first seed.
        """
        if self._appearance is None:
            raise RuntimeError(f"{self.spec.name} has not been seeded")
        self.view, self._taken = None, taken
        if self._status in (Status.LOST, Status.OUT_OF_VIEW):
            return self._search(frame, keep_view)

        if frame.stamp_ns > self._stamp_ns:  # a repeated or falling stamp says nothing of the frame interval
            self._interval_s = (frame.stamp_ns - self._stamp_ns) / NS_PER_S
        self._stamp_ns, interval_s = frame.stamp_ns, self._interval_s
        predicted, spread_px, rate_px = self._predict(frame.stamp_ns)
        if predicted is None:
            return self._miss(frame, None, None)
        motion = self._shutter.motion(rate_px, self.exposure_s, interval_s)
        predicted = motion.seen_circle(predicted)
        reach = float(np.clip(3 * spread_px, 0.5 * predicted.r_px, 3 * predicted.r_px))
        patch = Patch(frame, Window.around(predicted, self._kcf.half_side_px(predicted.r_px) + reach))

        # Where to look: KCF around the prediction, the size from points on the marker.
        followed = self._kcf.locate(patch, predicted, reach).circle if self.config.kcf.enabled else predicted
        followed = replace(followed, r_px=self._scaled(patch, followed, predicted.r_px))

        # What is there: circles by gradient and by colour, then sub-pixel edges on whichever has an outline.
        mask = self._appearance.mask(patch, followed) if self.config.colour.enabled else None
        hough = hough_circles(patch, followed, self.config.hough) if self.config.hough.enabled else ()
        colour = colour_circle(mask, patch, predicted) if mask is not None else None
        proposals = [("kcf", followed), ("prediction", predicted)]
        proposals += [("colour", colour)] if colour is not None else []
        proposals += [("hough", hough[0])] if hough else []
        close = self._outline.close_px(predicted)
        claim = None
        if spread_px < max(2.0, 0.15 * predicted.r_px) and predicted.dice(followed) > 0.8:  # they agree: look close by
            claim = self._outline.sharpened(patch, predicted, "prediction", close, motion, mask)
        if claim is None or claim.visible < 0.6:
            claim = self._outline.longest(patch, proposals, motion, mask)
        if not self._exposure_known:
            claim = self._learn_exposure(patch, proposals, motion, rate_px * interval_s, interval_s, mask, claim)
        if claim is not None and claim.visible > 0.6:
            if self._verified in SOFTNESS_LOOKS:
                self._outline.learn_softness(patch, claim, motion)
            if claim.proposer == "prediction":
                points, outside = claim.edges.points_px, claim.edges_outside_px
                self._shutter.learn(points, outside, claim.edge_weights, claim.circle, motion, rate_px)
        return self._decide(frame, patch, predicted, reach, claim, proposals, mask, hough, keep_view)

    def _search(self, frame: Frame, keep_view: bool) -> MarkerEstimate:
        """Look for a lost marker by colour and shape, no further than it can have gone."""
        assert self._last is not None
        assert self._appearance is not None
        seeded = self._appearance
        expected_m, tolerance_m = self._whereabouts(frame.stamp_ns)
        size_change = 0.15 + 2.0 * (frame.stamp_ns - self._seen.stamp_ns) / NS_PER_S
        centre = circle_of_sphere(expected_m, self.spec.radius_m, self.camera) or self._last
        reach = 3 * self._last.r_px + tolerance_m * self._last.r_px / self.spec.radius_m
        region = Window.around(centre, min(reach, 2.0 * max(frame.width_px, frame.height_px)))
        for candidate in acquire(frame, seeded.box, seeded.gain, self._last, region, self.config.acquire):
            usual = replace(candidate, r_px=self._last.r_px)
            patch = Patch(frame, Window.around(usual, self._kcf.half_side_px(max(usual.r_px, candidate.r_px))))
            mask = seeded.mask(patch, candidate) if self.config.colour.enabled else None
            # As large as it was, should a part be hidden; and as large as the blob.
            proposals = [("acquire", usual), ("colour", candidate)]
            claim = self._outline.longest(patch, proposals, AT_REST, mask)
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

    def _scaled(self, patch: Patch, followed: Circle, predicted_r_px: float) -> float:
        """The radius that the points on the marker give, as far as the filter is less sure of the distance."""
        if self._before is None or not self.config.points.enabled:
            return predicted_r_px
        scale = geometry_scale(*self._before, patch, followed, self.config.points)
        if scale is None:
            return predicted_r_px
        ratio, ratio_sd = scale
        moment = self._track.now
        axis = moment.xyz_cam_m / self.range_m
        variance = float(axis @ moment.covariance[:3, :3] @ axis) / self.range_m**2
        share = variance / (variance + ratio_sd**2)
        r_px = float(np.clip(self._before[1].r_px * ratio, 0.9 * predicted_r_px, 1.1 * predicted_r_px))
        return predicted_r_px + share * (r_px - predicted_r_px)

    def _learn_exposure(
        self,
        patch: Patch,
        proposals: list[tuple[str, Circle]],
        motion: Motion,
        way_px: FloatArray,
        interval_s: float,
        mask: npt.NDArray[np.uint8] | None,
        claim: Measured | None,
    ) -> Measured | None:
        """Try other exposure times on a marker that moves by `way_px` (2,) in a frame interval, now and then or when
        its outline is hard to see.

        Keeps the time whose blur explains the outline best, and the claim made with it.
        """
        shows = float(np.hypot(*way_px)) > _BLUR_SHOWS_PX
        self._moving += shows
        clear = claim is not None and claim.visible > 0.5
        if not shows or (clear and self._moving % 8):
            return claim
        best, best_score = claim, clearness(claim)
        for share in _EXPOSURES:
            other = self._outline.longest(patch, proposals, replace(motion, blur_px=way_px * share), mask)
            if clearness(other) > best_score + 0.02:
                best, best_score = other, clearness(other)
                self.exposure_s = share * interval_s
        return best

    def _decide(
        self,
        frame: Frame,
        patch: Patch,
        around: Circle,
        reach_px: float,
        claim: Measured | None,
        proposals: list[tuple[str, Circle]],
        mask: npt.NDArray[np.uint8] | None,
        hough: tuple[Circle, ...],
        keep_view: bool,
        lost: bool = False,
    ) -> MarkerEstimate:
        """Six votes on the claim, the verdict, and what follows from it."""
        size = claim.circle.r_px if claim is not None and lost else around.r_px
        assert self._appearance is not None
        maps: tuple[ResponseMap, ...] = ()
        votes: tuple[Vote, ...] = ()
        total = -1.0
        # A lost marker may look as it did when last verified or as it did when a person showed it.
        near = replace(around, r_px=size)
        reach_px = min(reach_px, size)
        if claim is not None:
            reach_px = max(reach_px, claim.circle.distance(around) + 0.3 * size)
        for template in (self._template, self._appearance.template) if lost else (self._template,):
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

    def _plausible(self, patch: Patch, claim: Measured, around: Circle, lost: bool) -> bool:
        """The seed's say, the outline's and the filter's: colour as seeded, edges to be seen, no leap."""
        jury, seeded = self.config.jury, self._appearance
        assert seeded is not None
        if claim.visible < min(jury.lost_visible if lost else jury.visible, 0.5 * seeded.visible):
            return False
        if self._is_taken(claim.circle):
            return False
        if claim.visible < 0.7 and not lost and seeded.vote(patch, claim.circle) <= jury.seed_template:
            return False
        if self.config.colour.enabled:
            inside, around_it = seeded.shares(patch, claim.circle)
            least = (jury.lost_colour if lost else jury.seed_colour) * max(0.4, claim.visible) * seeded.inside
            part_of_it = claim.visible < 0.6 and around_it > min(0.75, jury.seed_around + seeded.around)
            if inside < least or part_of_it:
                return False
        if lost or self._track.inside_gate(claim.xyz_cam_m, claim.covariance_m2):
            return True
        # A clear outline hardly off the prediction is no leap, whatever a filter that has learnt a wrong speed says.
        off = claim.circle.distance(around) / around.r_px + 3 * abs(float(np.log(claim.circle.r_px / around.r_px)))
        return claim.visible > 0.7 and off < 0.6

    def _is_taken(self, circle: Circle) -> bool:
        """Whether a circle of another marker covers this one: that marker then hides it, or is what was found."""
        return any(circle.shared_area(other) > _COVERED * circle.area_px2 for other in self._taken)

    def _accept(self, frame: Frame, patch: Patch, measured: Measured, status: Status) -> None:
        """Learn from a verified circle: template, filter, colour gain, size."""
        circle = measured.circle
        self._status, self.misses, self._stamp_ns = status, 0, frame.stamp_ns
        self._last, self._seen = circle, self._track.now
        self._template = make_template(patch, circle, self.config.matching)
        if self._verified % self.config.kcf.train_every == 0:
            self._kcf.train(patch, circle)
        self._verified += 1
        self._before = (patch, circle)
        assert self._appearance is not None
        self._appearance.follow(patch, circle)

    def _miss(
        self,
        frame: Frame,
        search: Window | None,
        claim: Measured | None,
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
        measured: Measured | None,
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
        claim: Measured | None,
        maps: tuple[ResponseMap, ...],
    ) -> StageView:
        edges = claim.edges.points_px if claim is not None else np.zeros((0, 2))
        weights = claim.edge_weights if claim is not None else np.zeros(0)
        return StageView(self.spec.name, patch.window, patch.bgr, mask, hough, edges, weights, maps)


_EXPOSURES = (0.0, 0.15, 0.3, 0.5, 0.75, 1.0)  # exposure times tried, in frame intervals
_BLUR_SHOWS_PX = 5.0  # motion in a frame interval from which blur can be told
_COVERED = 0.8  # share of a claim's disc from which the marker before it hides it
