"""A plain colour blob tracker: what one would write in an afternoon, to compare the chain with."""

import cv2
import numpy as np

from spheremcap.core.circle import Circle
from spheremcap.core.estimate import MarkerEstimate, Status
from spheremcap.core.frame import Frame, Patch, Window


class BlobTracker:
    """Threshold in HSV over the whole picture, open, the largest contour, its smallest enclosing circle.

    The range is that of the seed's disc (2nd to 98th percentile, a little wider), hue around its circular
    mean.
    """

    def __init__(self, marker: str) -> None:
        self.marker = marker
        self._hue = 0.0
        self._low = self._high = np.zeros(3)

    def seed(self, frame: Frame, circle: Circle) -> MarkerEstimate:
        """Learn the colour range from a person's circle."""
        patch = Patch(frame, Window.around(circle, circle.r_px))
        rows, columns = np.indices(patch.gray.shape)
        local = patch.local(circle)
        inside = np.hypot(columns - local.x_px, rows - local.y_px) <= max(1.0, 0.8 * circle.r_px)
        pixels = patch.hsv[inside].astype(np.float64)
        angle = np.angle(np.exp(1j * pixels[:, 0] * np.pi / 90).mean())
        self._hue = float(angle) * 90 / np.pi % 180
        pixels[:, 0] = (pixels[:, 0] - self._hue + 90) % 180
        margin = np.array([6, 25, 25])
        self._low = np.maximum(np.percentile(pixels, 2, axis=0) - margin, 0)
        self._high = np.percentile(pixels, 98, axis=0) + margin
        return MarkerEstimate(self.marker, frame.index, frame.stamp_ns, Status.SEEDED, circle=circle)

    def step(self, frame: Frame) -> MarkerEstimate:
        """The largest blob of the colour; LOST when there is none."""
        hsv = cv2.cvtColor(frame.full, cv2.COLOR_BGR2HSV)
        turned = (np.arange(256) - self._hue + 90) % 180
        table = np.repeat(np.arange(256, dtype=np.uint8)[:, None], 3, axis=1)
        table[:, 0] = np.clip(np.rint(turned), 0, 255)
        hsv = cv2.LUT(hsv, table[None])
        mask = cv2.inRange(hsv, tuple(map(float, self._low)), tuple(map(float, self._high)))
        mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
        contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        if not contours:
            return MarkerEstimate(self.marker, frame.index, frame.stamp_ns, Status.LOST)
        (x, y), r = cv2.minEnclosingCircle(max(contours, key=cv2.contourArea))
        circle = Circle(float(x), float(y), float(r) + 0.5)  # a contour goes through the pixels' centres
        return MarkerEstimate(self.marker, frame.index, frame.stamp_ns, Status.VERIFIED, circle=circle)
