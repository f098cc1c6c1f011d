"""What a marker looked like when a person showed it, at the brightness it has by now.

The last verified picture may drift with what is followed; this one cannot.
"""

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from spheremcap.core.circle import Circle
from spheremcap.core.frame import Patch
from spheremcap.detection.colour import ColourConfig, disc_mask, disc_pixels, learn_box
from spheremcap.verification.jury import cast_votes, vote_sum
from spheremcap.verification.matching import MatchingConfig, make_template, match

Mask = npt.NDArray[np.uint8]


class Appearance:
    """The seed's colours and template. `box` is its colour box, `gain` the marker's brightness over the seed's;
    `visible` is the share of the outline that the seed showed."""

    def __init__(
        self, patch: Patch, circle: Circle, visible: float, colour: ColourConfig, matching: MatchingConfig
    ) -> None:
        pixels = disc_pixels(patch, circle, colour.sample)
        self.box = learn_box(pixels, colour)
        self.gain = 1.0
        self.visible = max(visible, 0.2)
        self.template = make_template(patch, circle, matching)
        self._value = max(1.0, float(np.median(pixels[:, 2])))
        self._matching = matching
        self.inside, self.around = self.shares(patch, circle)

    def follow(self, patch: Patch, circle: Circle) -> None:
        """Take the brightness of a verified circle in; an occluder's pixels do not count."""
        pixels = patch.hsv[disc_mask(patch, circle, 0.6)][None]
        own = replace(self.box, value=(0.0, 255.0)).mask(pixels) > 0
        values = pixels[own][:, 2]
        if len(values) > 8:
            self.gain += 0.5 * (float(np.clip(np.median(values) / self._value, 0.1, 4)) - self.gain)

    def mask(self, patch: Patch, near: Circle) -> Mask:
        """The colour mask of the patch; the exposure may have changed, so the brightness is looked up once more."""
        mask = self.box.mask(patch.hsv, self.gain)
        disc = disc_mask(patch, near, 0.6)
        if disc.any() and mask[disc].mean() < 0.3 * 255:
            gain = float(np.clip(np.median(patch.hsv[disc][:, 2]) / self._value, 0.1, 4))
            again = self.box.mask(patch.hsv, gain)
            if again[disc].mean() > 0.5 * 255:
                mask = again
        return mask

    def shares(self, patch: Patch, circle: Circle) -> tuple[float, float]:
        """Shares of pixels in the seed's own colours, inside the circle and in a ring around it, at the exposure that
        suits the inside best. A claim on a part of the marker has its colour all around."""
        disc = disc_mask(patch, circle, 0.9)
        ring = disc_mask(patch, circle, 1.35) & ~disc_mask(patch, circle, 1.1)
        if not disc.any():
            return 0.0, 0.0
        mask = self.box.mask(patch.hsv, self.gain)
        if mask[disc].mean() < 0.8 * 255:
            # Another exposure, as the brighter or the darker half of the disc has it when a part is hidden.
            values = patch.hsv[disc][:, 2]
            quarter = len(values) // 4
            halves = np.partition(values, (quarter, 3 * quarter))[[quarter, 3 * quarter]] / self._value
            masks = [mask, *(self.box.mask(patch.hsv, float(gain)) for gain in np.clip(halves, 0.1, 4))]
            mask = max(masks, key=lambda m: int(m[disc].sum()))
        return float(mask[disc].mean()) / 255, float(mask[ring].mean()) / 255 if ring.any() else 0.0

    def vote(self, patch: Patch, claim: Circle) -> float:
        """The mean vote, in [0, 1], of the seed's template for a claim."""
        template = replace(self.template, pixels=self.template.pixels * np.float32(self.gain))
        votes = cast_votes(match(template, patch, claim, 0.6 * claim.r_px, self._matching), claim)
        return vote_sum(votes) / len(votes)
