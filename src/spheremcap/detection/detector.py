"""What is there: circles by gradient and by colour, and sub-pixel edges on whichever has an outline."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

from spheremcap.core.circle import Circle
from spheremcap.core.frame import Frame, Patch, Window
from spheremcap.core.look import Expected, FloatArray, Measured
from spheremcap.core.optics import bounded_blur
from spheremcap.detection.acquire import AcquireConfig, Candidate, acquire
from spheremcap.detection.appearance import Appearance
from spheremcap.detection.colour import ColourConfig, box_mask, colour_circle
from spheremcap.detection.hough import HoughConfig, hough_circles
from spheremcap.detection.optics import BLUR_SHOWS_PX, EXPOSURES
from spheremcap.detection.outline import Outline, clearness, close_px
from spheremcap.detection.shading import Shading

Proposals = tuple[tuple[str, Circle], ...]


@dataclass(frozen=True, slots=True)
class Detected:
    """Proposed circles by name, all of Hough's, the marker's colours on the patch (None where colour is not asked),
    and the claim: the proposal with an outline, measured, or None."""

    proposals: Proposals
    hough: tuple[Circle, ...]
    limits: FloatArray | None
    claim: Measured | None


class Detector:
    """One marker's detectors; they keep nothing from frame to frame."""

    def __init__(self, outline: Outline, hough: HoughConfig, colour: ColourConfig, search: AcquireConfig) -> None:
        self.outline, self._hough, self._colour, self._acquire = outline, hough, colour, search

    def seeded(self, frame: Frame, circle: Circle) -> Measured:
        """A person's circle, sharpened by the edges where they agree with it."""
        measured = self.outline.first_look(frame, circle)
        agrees = measured is not None and measured.circle.dice(circle) >= 0.65
        return measured if measured is not None and agrees else self.outline.clicked(circle)

    def at_prediction(
        self, frame: Frame, patch: Patch, expected: Expected, appearance: Appearance, shading: Shading
    ) -> Detected:
        """What the edges close to the expected circle say; no claim where the filter is not sure enough of it."""
        limits, claim = self._limits(patch, expected.circle, appearance), None
        if expected.spread_px < max(2.0, 0.15 * expected.circle.r_px):
            close = close_px(expected.circle)
            claim = self.outline.sharpened(
                frame, expected.circle, "prediction", close, expected.motion, limits, expected, shading.profile
            )
        return Detected((("prediction", expected.circle),), (), limits, claim)

    def detect(
        self,
        frame: Frame,
        patch: Patch,
        expected: Expected,
        followed: Circle,
        close: Detected,
        appearance: Appearance,
        shading: Shading,
    ) -> Detected:
        """What this frame shows of a marker that is expected somewhere and that KCF follows to a circle; `close` is
        what is there `at_prediction`, which counts where both agree."""
        predicted, motion = expected.circle, expected.motion
        agree = predicted.dice(followed) > 0.8
        limits = close.limits if agree else self._limits(patch, followed, appearance)
        colour = colour_circle(box_mask(patch.bgr, limits), patch, predicted) if limits is not None else None
        hough = self.hough(patch, followed)
        proposals: Proposals = (("kcf", followed), *close.proposals)
        proposals += (("colour", colour),) if colour is not None else ()
        proposals += (("hough", hough[0]),) if hough else ()
        claim = close.claim if agree else None
        if claim is None or claim.visible < 0.6:
            claim = self.outline.longest(frame, proposals, motion, limits, expected, shading.profile)
        if claim is None or claim.visible <= 0.5:
            claim = self._at_other_exposures(frame, expected, proposals, limits, shading, claim)
        return Detected(proposals, hough, limits, claim)

    def _limits(self, patch: Patch, circle: Circle, appearance: Appearance) -> FloatArray | None:
        return appearance.limits(patch, circle) if self._colour.enabled else None

    def hough(self, patch: Patch, followed: Circle) -> tuple[Circle, ...]:
        """Hough's circles near one (image pixels), most votes first."""
        return hough_circles(patch, followed, self._hough) if self._hough.enabled else ()

    def _at_other_exposures(
        self,
        frame: Frame,
        expected: Expected,
        proposals: Proposals,
        limits: FloatArray | None,
        shading: Shading,
        claim: Measured | None,
    ) -> Measured | None:
        """The clearest claim over other exposure times, for an outline that is hard to see while the marker moves."""
        way_px = expected.rate_px * expected.interval_s
        if math.hypot(way_px[0], way_px[1]) <= BLUR_SHOWS_PX:
            return claim
        for share in EXPOSURES:
            motion = replace(expected.motion, blur_px=bounded_blur(way_px * share, expected.circle))
            other = self.outline.longest(frame, proposals, motion, limits, expected, shading.profile)
            if clearness(other) > clearness(claim) + 0.02:
                claim = other
        return claim

    def candidates(self, frame: Frame, region: Window, last: Circle, appearance: Appearance) -> Iterator[Candidate]:
        """Places in a region that a marker may have gone to, by colour and shape, most likely first; `last` is as it
        was last verified."""
        yield from acquire(frame, appearance.box, appearance.gain, last, region, self._acquire)

    def claimed(
        self, frame: Frame, patch: Patch, candidate: Candidate, expected: Expected, appearance: Appearance
    ) -> Detected:
        """What is at a candidate: as large as the marker should be, with any side of it hidden; and as the blob is."""
        limits = self._limits(patch, candidate.circle, appearance)
        first, *others = [("acquire", circle) for circle in candidate.wholes(expected.circle.r_px)]
        proposals: Proposals = (first, ("colour", candidate.circle), *others)
        claim = self.outline.longest(frame, proposals, expected.motion, limits, expected)
        return Detected(proposals, (), limits, claim)
