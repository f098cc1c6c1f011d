"""The chain of one marker: the method on one page.

predict  where the Kalman filter expects the marker on the next frame
look     KCF and points say where and how large, Hough and colour what is there, edges measure it; six votes and checks
settle   verdict, status, metres, Kalman update, learning

`look` only reads and may run in any thread; `predict` and `settle` go frame by frame, in order. A miss is data, never
an exception. Nothing here reads files, logs or draws.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np
from pydantic import Field

from spheremcap.core.camera import Camera
from spheremcap.core.circle import Circle
from spheremcap.core.estimate import MarkerEstimate
from spheremcap.core.frame import Frame, Patch
from spheremcap.core.look import Expected, Look, Measured, foremost
from spheremcap.core.marker import MarkerSpec
from spheremcap.core.stage import StageConfig
from spheremcap.core.status import PolicyConfig, Sight, Status, next_status
from spheremcap.core.time import NS_PER_S
from spheremcap.core.view import StageView
from spheremcap.core.vote import Verdict
from spheremcap.detection.acquire import AcquireConfig
from spheremcap.detection.appearance import Appearance, Limits
from spheremcap.detection.colour import ColourConfig, box_mask
from spheremcap.detection.detector import Detector
from spheremcap.detection.edge import EdgeConfig
from spheremcap.detection.hough import HoughConfig
from spheremcap.detection.optics import OpticsLearner
from spheremcap.detection.outline import Outline
from spheremcap.detection.shading import Shading
from spheremcap.positioning.kalman import KalmanConfig, Moment
from spheremcap.positioning.sphere import PositionConfig
from spheremcap.positioning.whereabouts import Whereabouts
from spheremcap.tracking.follower import Follower
from spheremcap.tracking.kcf import KcfConfig
from spheremcap.tracking.points import PointsConfig
from spheremcap.verification.jury import JuryConfig
from spheremcap.verification.matching import MatchingConfig
from spheremcap.verification.reacquired import Reacquired
from spheremcap.verification.verifier import Prior, Verifier, uncovered


class ChainConfig(StageConfig):
    """The stages' own settings, side by side."""

    when_sure: Literal["skip", "run"] = Field(
        "skip",
        description="whether KCF, points, Hough and the colour blob, which say where to look for edges, are asked "
        "where prediction and edges agree already",
    )
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


_CLEARLY_SEEDED = 0.5  # share of a seed's outline with an edge below which a person is told
_CLEAR = 0.6  # share of an outline with an edge from which nothing hides it
_OUTLINE_ALONE = frozenset(("outline", "seed"))
"""Doubts of a marker that is there but shows little of its outline."""


@dataclass(frozen=True, slots=True)
class _Seeded:
    """The stages that begin anew with every seed."""

    follower: Follower
    appearance: Appearance
    shading: Shading
    verifier: Verifier
    reacquired: Reacquired


class MarkerChain:
    """The chain of one marker. `seed` first, then `step` for every later frame in order; or `predict`, `look` and
    `settle` one by one, when the looks of several markers are to run side by side.

    `metric` False means that the camera is only assumed: tracking works, but no metres are given out. `exposure_s` and
    `readout_s` are what is known of the camera's shutter (0 and None: nothing; see `OpticsLearner`); `optics` is what
    the camera's markers learn of it together, for a chain that is not its camera's only one.
    """

    def __init__(
        self,
        spec: MarkerSpec,
        camera: Camera,
        config: ChainConfig,
        exposure_s: float = 0.0,
        metric: bool = True,
        readout_s: float | None = None,
        optics: OpticsLearner | None = None,
    ) -> None:
        self.spec, self.config, self.metric = spec, config, metric
        self.optics = optics or OpticsLearner(exposure_s, readout_s, config.edge.learn_blur, camera.height_px)
        self.status, self.misses = Status.LOST, 0  # unverified frames in a row
        self.whereabouts = Whereabouts(spec.radius_m, camera, config.kalman, config.position)
        outline = Outline(spec.radius_m, camera, config.edge, config.position)
        self._detector = Detector(outline, config.hough, config.colour, config.acquire)
        self._stages: _Seeded | None = None
        self._expected: Expected | None = None
        self._stamp_ns, self._interval_s = 0, 1 / 30  # until two stamps say more

    def seed(self, frame: Frame, circle: Circle) -> MarkerEstimate:
        """Start (again) from a person's circle on this frame; the edge step sharpens it where it agrees with it."""
        config, follower = self.config, Follower(self.config.kcf, self.config.points)
        measured = self._detector.seeded(frame, circle)
        patch = follower.patch(frame, measured.circle)
        appearance = Appearance(patch, measured.circle, measured.visible, config.colour)
        verifier = Verifier(
            patch, measured.circle, appearance, config.jury, config.matching, colour=config.colour.enabled
        )
        self._stages = _Seeded(follower, appearance, Shading(config.edge.rays), verifier, Reacquired())
        self._stamp_ns, self._expected = frame.stamp_ns, None
        self.optics.seeded(measured)
        self.whereabouts.accept(frame.stamp_ns, measured, again=True)
        self._learn(frame, patch, measured)
        self.status = Status.SEEDED
        estimate = replace(self._estimate(frame, None, measured), claim=circle, search=patch.window)
        if measured.visible < _CLEARLY_SEEDED:
            return replace(estimate, reasons=("little outline" if measured.visible else "no outline",))
        return estimate

    def step(self, frame: Frame, taken: Sequence[Circle] = ()) -> MarkerEstimate:
        """Where the marker is on the next frame; not at a circle `taken` by another marker, which would hide it.

        Raises RuntimeError before the first seed.
        """
        self.predict(frame)
        return self.settle(frame, self.look(frame), taken)

    def predict(self, frame: Frame) -> None:
        """Move the filter to this frame. Raises RuntimeError before the first seed."""
        if self._stages is None:
            raise RuntimeError(f"{self.spec.name} has not been seeded")
        if frame.stamp_ns > self._stamp_ns:  # a repeated or falling stamp says nothing of the frame interval
            self._interval_s = (frame.stamp_ns - self._stamp_ns) / NS_PER_S
        self._stamp_ns, self._expected = frame.stamp_ns, None
        if self.status.tracked:
            optics = self.optics.now(self._interval_s)
            self._expected = self.whereabouts.expect(frame, self._interval_s, optics)

    def look(self, frame: Frame) -> tuple[Look, ...]:
        """What this frame shows where the marker is expected; of a lost one, at each place that it may have come back
        to, most likely first. Changes nothing."""
        assert self._stages is not None
        stages, where = self._stages, self.whereabouts
        if not self.status.tracked:
            return self._search(frame)
        if self._expected is None:
            return ()
        expected = self._expected
        patch = stages.follower.patch(frame, expected.circle, expected.reach_px)
        found = self._detector.at_prediction(frame, patch, expected, stages.appearance, stages.shading)
        if self.config.when_sure == "run" or not _sure(found.claim, expected):
            followed = stages.follower.follow(patch, expected)
            found = self._detector.detect(frame, patch, expected, followed, found, stages.appearance, stages.shading)
        surprise, growth = (0.0, 1.0) if found.claim is None else where.surprise(found.claim, None)
        prior = Prior(expected.circle, expected.reach_px, False, expected.circle, growth, surprise, self.misses > 0)
        look = stages.verifier.look(patch, found, prior)
        if not look.doubts:
            return (look,)
        return (look, *(far for far in self._search(frame) if _news(far.claim, expected)))

    def _search(self, frame: Frame) -> tuple[Look, ...]:
        """Look for a marker that is not where it was expected by colour and shape, no further than it can have gone."""
        assert self._stages is not None
        stages, where, detector = self._stages, self.whereabouts, self._detector
        absence = where.absence(frame, self.status is Status.OUT_OF_VIEW)
        softness, looks = self.optics.now(self._interval_s).softness, []
        for candidate in detector.candidates(frame, absence.region, where.circle, stages.appearance):
            place, expected = candidate.circle, absence.at(candidate.circle, self._interval_s, softness)
            patch = stages.follower.patch(frame, place.resized(max(expected.circle.r_px, place.r_px)))
            found = detector.claimed(frame, patch, candidate, expected, stages.appearance)
            if found.claim is None:
                continue
            surprise, growth = where.surprise(found.claim, absence)
            around, reach_px = place.resized(found.claim.circle.r_px), 0.75 * place.r_px
            prior = Prior(around, reach_px, True, absence.circle, growth, surprise, missed=True)
            looks.append(stages.verifier.look(patch, found, prior))
        return tuple(looks)

    def settle(self, frame: Frame, looks: Sequence[Look], taken: Sequence[Circle] = ()) -> MarkerEstimate:
        """Decide what the looks at this frame mean, given the circles of markers settled before, and learn from it."""
        assert self._stages is not None
        looks = [uncovered(look, taken) for look in looks]
        elsewhere = [look for look in looks if look.elsewhere]
        found = self._stages.reacquired.confirmed(elsewhere)
        looks = [*(look for look in looks if not look.elsewhere), *found]
        for look in looks:
            if look.claim is not None and not look.doubts:
                self._accept(frame, look.claim, look)
                return self._estimate(frame, look, look.claim)
        told = foremost(looks)
        self._miss(frame, told)
        return self._estimate(frame, told, None)

    def _accept(self, frame: Frame, claim: Measured, look: Look) -> None:
        """Learn from a verified circle: filter, which starts anew elsewhere, template, brightness, size; and the
        camera's optics. One that was verified on the frame before has leapt."""
        assert self._stages is not None
        leapt = look.elsewhere and self.misses == 0 and self.status.tracked
        self.whereabouts.accept(frame.stamp_ns, claim, look.elsewhere, leapt)
        self._learn(frame, look.patch, claim)
        self.status = Status.VERIFIED
        if self._expected is not None and not look.elsewhere:
            rate_px, interval_s = self._expected.rate_px, self._expected.interval_s
            misfits = partial(self._detector.outline.misfits, frame, claim, self._stages.shading.profile)
            self.optics.learn(self.spec.name, claim, rate_px, interval_s, misfits)

    def _learn(self, frame: Frame, patch: Patch, claim: Measured) -> None:
        assert self._stages is not None
        stages, circle, self.misses = self._stages, claim.circle, 0
        stages.reacquired.seen(frame, circle)
        stages.verifier.learn(patch, circle)
        stages.follower.learn(patch, circle)
        stages.appearance.follow(patch, circle, claim.visible)
        stages.shading.learn(frame.stamp_ns, partial(self._detector.outline.light, frame, claim))

    def _miss(self, frame: Frame, look: Look | None) -> None:
        """No verified circle: the Kalman filter stands in, until the marker counts as lost or out of view. Where votes
        are for the marker and only its outline does not show, KCF steers the filter."""
        assert self._stages is not None
        self._stages.follower.miss()
        self.misses += 1
        away_s = (frame.stamp_ns - self.whereabouts.seen.stamp_ns) / NS_PER_S
        if self._expected is not None and look is not None and away_s < self.config.policy.steered_s:
            proposer, followed = look.proposals[0]
            if proposer == "kcf" and look.verdict is Verdict.VERIFIED and _OUTLINE_ALONE.issuperset(look.doubts):
                self.whereabouts.steer(self._expected.motion.still_circle(followed))
        sight = Sight(
            rejected=look is None or look.verdict is Verdict.REJECTED,
            gone=self.status.tracked and self.whereabouts.gone(frame),
            misses=self.misses,
            away_s=away_s,
            unsure_radii=self.whereabouts.unsure_radii,
        )
        self.status = next_status(self.status, sight, self.config.policy)

    # -- what is handed out -----------------------------------------------------------------------------------------

    @property
    def moment(self) -> Moment | None:
        """The Kalman filter's state at the last frame; None while the marker is lost or out of view."""
        return self.whereabouts.track.now if self.status.tracked else None

    @property
    def range_m(self) -> float:
        """How far away the filter has the marker, metres; infinite while it is lost or out of view."""
        moment = self.moment
        return math.inf if moment is None else math.hypot(*moment.xyz_cam_m.tolist())

    def _estimate(self, frame: Frame, look: Look | None, measured: Measured | None) -> MarkerEstimate:
        """The estimate of this frame; `look` is None at a seed, and where there was nothing to look at."""
        where, claim = self.whereabouts, look.claim if look is not None else measured
        circle, xyz, covariance, velocity = None, None, None, None
        if measured is not None:
            circle, place, spread = measured.circle, where.placed(measured), measured.covariance_m2
        elif self.status is Status.ESTIMATED:
            now, circle = where.track.now, where.image()
            place, spread = now.xyz_cam_m, now.covariance[:3, :3]
            if circle is not None and self._expected is not None:
                circle = self._expected.motion.seen_circle(circle)
        if self.metric and (measured is not None or self.status is Status.ESTIMATED):
            xyz, covariance = place, where.reported(place, spread)
            velocity = where.track.now.velocity_cam_mps if where.track.moving_known else None
        nothing = () if measured is not None else ("not found" if self.status is Status.LOST else "out of view",)
        return MarkerEstimate(
            self.spec.name, frame.index, frame.stamp_ns, self.status, circle,
            None if measured is None else measured.circle_sd_px,
            None if claim is None else claim.circle,
            "" if claim is None else claim.proposer,
            () if look is None else look.proposals,
            None if look is None else look.patch.window,
            () if look is None else look.votes,
            None if look is None else look.vote_sum,
            None if look is None else look.verdict,
            None if claim is None else claim.visible,
            xyz, covariance, velocity,
            nothing if look is None else look.doubts,
        )  # fmt: skip

    def colours(self, patch: Patch, circle: Circle) -> Limits:
        """The limits (6,) of the marker's colours on a patch with it at `circle` (image pixels), as learnt at the seed
        (`ColourBox.limits`). Raises RuntimeError before the first seed."""
        if self._stages is None:
            raise RuntimeError(f"{self.spec.name} has not been seeded")
        return self._stages.appearance.limits(patch, circle)

    def view(self, frame: Frame, looks: Sequence[Look]) -> StageView | None:
        """The stages' pictures of a frame that was just settled, in the picture's own pixels; None without a look."""
        look = next((look for look in looks if not look.doubts), foremost(looks))
        window = None if look is None else look.patch.window.clipped(frame.width_px, frame.height_px)
        if look is None or window is None or min(window.width, window.height) < 1:
            return None
        bgr = frame.patch(window)
        mask = box_mask(bgr, look.limits) if look.limits is not None else None
        edges = look.claim.edges.points_px if look.claim is not None else np.zeros((0, 2))
        weights = look.claim.edge_weights if look.claim is not None else np.zeros(0)
        hough = look.hough or self._detector.hough(look.patch, look.proposals[0][1])
        return StageView(self.spec.name, window, bgr, mask, hough, edges, weights, tuple(look.maps))


def _news(claim: Measured | None, expected: Expected) -> bool:
    """Whether what a search found is more than another reading of what hides the marker where it was expected."""
    if claim is None:
        return False
    return claim.visible > _CLEAR or claim.circle.distance(expected.circle) > expected.circle.r_px


def _sure(claim: Measured | None, expected: Expected) -> bool:
    """Whether the edges show nearly all of an outline where the filter expects one."""
    return claim is not None and claim.visible >= 0.7 and claim.circle.dice(expected.circle) > 0.85
