"""Circles in the image, in pixels; an integer coordinate is a pixel's centre."""

import math
from typing import NamedTuple


class Circle(NamedTuple):
    """A circle in the image: centre and radius in pixels."""

    x_px: float
    y_px: float
    r_px: float

    @property
    def area_px2(self) -> float:
        """Area in square pixels."""
        return math.pi * self.r_px * self.r_px

    def distance(self, other: "Circle") -> float:
        """Distance between the two centres in pixels."""
        return math.hypot(self.x_px - other.x_px, self.y_px - other.y_px)

    def shared_area(self, other: "Circle") -> float:
        """Area of the lens both circles cover, in square pixels, in closed form (S_sh of eq 2.19 and 3.8)."""
        d, r, s = self.distance(other), self.r_px, other.r_px
        if d >= r + s:
            return 0.0
        if d <= abs(r - s):
            return math.pi * min(r, s) ** 2
        # Half-angles that the common chord spans at either centre.
        alpha = math.acos(max(-1.0, min(1.0, (d * d + r * r - s * s) / (2 * d * r))))
        beta = math.acos(max(-1.0, min(1.0, (d * d + s * s - r * r) / (2 * d * s))))
        return r * r * (alpha - math.sin(2 * alpha) / 2) + s * s * (beta - math.sin(2 * beta) / 2)

    def dice(self, other: "Circle") -> float:
        """Dice overlap 2 S_sh / (S_1 + S_2) in [0, 1]: eq 3.8, and 1 minus the error of eq 2.19 and 3.13."""
        total = self.area_px2 + other.area_px2
        return 2.0 * self.shared_area(other) / total if total > 0 else 0.0

    def shifted(self, dx_px: float, dy_px: float) -> "Circle":
        """The same circle moved by (dx_px, dy_px)."""
        return Circle(self.x_px + dx_px, self.y_px + dy_px, self.r_px)

    def resized(self, r_px: float) -> "Circle":
        """The circle of another radius about the same centre."""
        return Circle(self.x_px, self.y_px, r_px)
