"""Where one marker is, in metres and in the picture: the Kalman filter before a camera."""

import math
from dataclasses import dataclass, replace

import numpy as np

from spheremcap.core.camera import Camera
from spheremcap.core.circle import Circle
from spheremcap.core.frame import Frame, Window
from spheremcap.core.look import Expected, FloatArray, Measured
from spheremcap.core.optics import AT_REST, Optics
from spheremcap.core.time import NS_PER_S
from spheremcap.positioning.kalman import KalmanConfig, Moment, Track3D
from spheremcap.positioning.size import SizeTrack
from spheremcap.positioning.sphere import (
    PositionConfig,
    circle_of_sphere,
    image_of_moving,
    sphere_of_circle,
    thesis_position,
)

_GROWTH = 2.0  # greatest ratio of a followed marker's radius to the expected one
_FOLLOWED_SD, _FOLLOWED_RANGE_SD = 0.25, 0.3  # of a place that is only followed: sideways in radii, the distance
_WHOLE, _HIDDEN_SD = 0.8, 1.0  # an outline of which less shows tells of the size only so far: relative deviation for
# each share that is missing. What hides a part stays for long, and is wrong by as much in frame after frame.
_FREE_S = 0.05  # time after which a marker may be two radii from where its motion brings it, whatever that was
_SIZE_OPEN = 0.3  # relative deviation of a distance from which a marker's size is not known
_ANYWHERE = 4.0  # radii within which a claim counts as at the candidate that it was found from


@dataclass(frozen=True, slots=True)
class Absence:
    """A lost marker: where it would be (`xyz_cam_m`, and its `circle` in the picture, as large as it should be), how
    far from there it can be (`tolerance_m`), the part of the picture where that can show, and the greatest ratio of
    radii since it was last seen; and how far away its size says that it is, metres and relative deviation."""

    xyz_cam_m: FloatArray
    circle: Circle
    tolerance_m: float
    region: Window
    growth: float
    range_m: float
    range_sd: float

    def at(self, candidate: Circle, interval_s: float, softness: float) -> Expected:
        """What is expected of the marker were it at a candidate: nothing is known of how it moves."""
        circle = candidate.resized(self.circle.r_px)
        motion, reach_px = replace(AT_REST, softness=softness), _ANYWHERE * circle.r_px
        return Expected(circle, 0.0, self.range_m, self.range_sd, np.zeros(2), interval_s, motion, reach_px)


class Whereabouts:
    """One marker's filter, and how it was when last verified."""

    def __init__(self, radius_m: float, camera: Camera, kalman: KalmanConfig, position: PositionConfig) -> None:
        self.radius_m, self.camera, self._position = radius_m, camera, position
        self._acceleration_mps2 = kalman.acceleration_mps2
        self.track, self.size = Track3D(kalman), SizeTrack()
        self.circle = Circle(0, 0, 1)  # as last verified
        self.seen = Moment(0, np.zeros(6), np.zeros((6, 6)))  # the filter's state then

    def expect(self, frame: Frame, interval_s: float, optics: Optics) -> Expected | None:
        """Move the filter to this frame: what it expects of it. None when that is outside the picture, or beyond what
        the lens model holds for: nobody needs to look."""
        moment = self.track.predict(frame.stamp_ns)
        image = image_of_moving(moment.state, self.radius_m, self.camera)
        if image is None:
            return None
        circle, rate_px = image
        # A wild depth must not make a wild patch.
        r_px = min(max(circle.r_px, self.circle.r_px / 2), self.circle.r_px * 2)
        circle = Circle(circle.x_px, circle.y_px, r_px)
        motion = optics.motion(rate_px, circle, frame.height_px)
        circle = motion.seen_circle(circle)
        spread_px = math.sqrt(max(moment.covariance[0, 0], moment.covariance[1, 1])) / moment.state[2]
        spread_px = float(spread_px) * self.camera.fx_px
        if outside_px(frame, circle) > circle.r_px + 3 * spread_px:
            return None
        place = moment.xyz_cam_m
        square = float(place @ place)
        range_sd = math.sqrt(float(place @ moment.covariance[:3, :3] @ place)) / square
        reach_px = min(max(3 * spread_px, 0.5 * circle.r_px), 3 * circle.r_px)
        range_m = math.sqrt(square)
        sized_m, sized_sd = self.size.expect(frame.stamp_ns)
        if sized_sd < range_sd:
            circle = circle.resized(circle.r_px * range_m / sized_m)
            range_m, range_sd = sized_m, sized_sd
        return Expected(circle, spread_px, range_m, range_sd, rate_px, interval_s, motion, reach_px)

    def absence(self, frame: Frame, left: bool) -> Absence:
        """What is known of a lost marker, had it moved on evenly. One that would be outside the picture comes back
        where it went out: it is expected there, give or take the way it can go; and in that half of the picture where
        it surely `left`."""
        age_s = (frame.stamp_ns - self.seen.stamp_ns) / NS_PER_S
        variance = np.diag(self.seen.covariance)
        drift_m = float(np.sqrt(variance[:3].max() + variance[3:].max() * age_s**2))
        way_m = self.seen.velocity_cam_mps * age_s
        strayed_m = 2 * self.radius_m * min(1.0, abs(age_s) / _FREE_S)
        tolerance_m = strayed_m + 3 * drift_m + 0.5 * self._acceleration_mps2 * age_s**2
        xyz = self.seen.xyz_cam_m + way_m
        centre = circle_of_sphere(xyz, self.radius_m, self.camera)
        if left or centre is None or outside_px(frame, centre) > centre.r_px:
            xyz, centre = self.seen.xyz_cam_m, self.circle
            tolerance_m += float(np.linalg.norm(way_m))
        reach_px = self.circle.r_px * (3 + tolerance_m / self.radius_m)
        region = Window.around(centre, min(reach_px, 2.0 * max(frame.width_px, frame.height_px)))
        if left:
            region = _near_half(frame, self.circle, region)
        growth = math.exp(min(0.15 + 2.0 * max(age_s, 0.0), 5.0))
        range_m, range_sd = self.size.expect(frame.stamp_ns)
        # Away for long it may have any size, and is sought as it was.
        ratio = float(np.linalg.norm(self.seen.xyz_cam_m)) / range_m if range_sd < _SIZE_OPEN else 1.0
        circle = centre.resized(self.circle.r_px * ratio)
        return Absence(xyz, circle, tolerance_m, region, growth, range_m, range_sd)

    def surprise(self, claim: Measured, absence: Absence | None) -> tuple[float, float]:
        """How far a claim is from where the marker should be, 1 at the farthest that is believed, and the greatest
        ratio of radii that is."""
        if absence is None:
            return self.track.surprise(*claim.outline_alone), _GROWTH
        # The distance is much less sure than the place sideways, and must not excuse what is far aside.
        ray = claim.xyz_cam_m / np.linalg.norm(claim.xyz_cam_m)
        off, deep = claim.xyz_cam_m - absence.xyz_cam_m, float(ray @ claim.covariance_m2 @ ray)
        along = float(off @ ray)
        across, spread = float(np.linalg.norm(off - along * ray)), float(np.trace(claim.covariance_m2)) - deep
        surprise = math.hypot(
            along / (absence.tolerance_m + 3 * math.sqrt(deep)),
            across / (absence.tolerance_m + 3 * math.sqrt(max(spread, 0.0))),
        )
        return surprise, absence.growth

    def accept(self, stamp_ns: int, claim: Measured, again: bool, leapt: bool = False) -> None:
        """Take a verified claim in; `again` starts the filter with it, where the marker `leapt` with the speed of that
        leap."""
        place, covariance = claim.outline_alone
        square = float(place @ place)
        range_m, range_sd = math.sqrt(square), math.sqrt(float(place @ covariance @ place)) / square
        if again:
            since_s = (stamp_ns - self.seen.stamp_ns) / NS_PER_S
            leap_mps = (place - self.seen.xyz_cam_m) / since_s if leapt and since_s > 0 else None
            self.track.start(stamp_ns, place, covariance, leap_mps)
            self.size.start(stamp_ns, range_m, range_sd)
        else:
            self.track.update(place, covariance)
            hidden_sd = _HIDDEN_SD * max(0.0, _WHOLE - claim.visible)
            self.size.update(stamp_ns, range_m, math.hypot(range_sd, hidden_sd))
        self.circle, self.seen = claim.circle, self.track.now

    def steer(self, followed: Circle) -> None:
        """Keep the filter with a marker whose outline does not show, but which was followed to a circle (as a global
        shutter has it). Nothing is measured by that."""
        range_m = float(np.linalg.norm(self.track.now.xyz_cam_m))
        place = sphere_of_circle(followed, self.radius_m, self.camera)
        ray = place / np.linalg.norm(place)
        spread = np.eye(3) * (_FOLLOWED_SD * self.radius_m) ** 2
        self.track.update(ray * range_m, spread + ray[:, None] * ray * (_FOLLOWED_RANGE_SD * range_m) ** 2)

    @property
    def unsure_radii(self) -> float:
        """The filter's standard deviation sideways, in radii of the marker."""
        covariance = self.track.now.covariance
        return math.sqrt(max(covariance[0, 0], covariance[1, 1])) / self.radius_m

    def gone(self, frame: Frame) -> bool:
        """Whether the filter is sure that the marker is out of the picture."""
        sure = float(self.track.now.covariance[0, 0]) ** 0.5 < 4 * self.radius_m
        circle = self.image()
        return sure and (circle is None or outside_px(frame, circle) > 0.3 * circle.r_px)

    def image(self) -> Circle | None:
        """The circle under a global shutter where the filter has the marker; None when it has none in the picture."""
        return circle_of_sphere(self.track.now.xyz_cam_m, self.radius_m, self.camera)

    def placed(self, claim: Measured) -> FloatArray:
        """The sphere's centre (3,) by the formula of the settings. It is only reported: the filter has that of the
        edges."""
        if self._position.formula == "edges":
            return claim.xyz_cam_m
        circle = claim.motion.still_circle(claim.circle)
        if self._position.formula == "circle":
            return sphere_of_circle(circle, self.radius_m, self.camera)
        size_m = self.radius_m * (1 if self._position.thesis_size == "radius" else 2)
        return thesis_position(circle, size_m, self._position.thesis_constant_px, self.camera)

    def reported(self, xyz_cam_m: FloatArray, covariance_m2: FloatArray) -> FloatArray:
        """The covariance (3, 3) with the camera's own uncertainty: a wrong focal length scales the distance."""
        if self.camera.focal_sd == 0:
            return covariance_m2
        return covariance_m2 + xyz_cam_m[:, None] * xyz_cam_m * self.camera.focal_sd**2


def _near_half(frame: Frame, last: Circle, region: Window) -> Window:
    """The part of a region in the half of the picture on the side of the border that a circle was nearest to."""
    x0, y0, x1, y1 = region.x, region.y, region.x + region.width, region.y + region.height
    to_side_px = min(last.x_px, frame.width_px - 1 - last.x_px)
    if to_side_px <= min(last.y_px, frame.height_px - 1 - last.y_px):
        half = frame.width_px // 2
        x0, x1 = (x0, min(x1, half)) if last.x_px < half else (max(x0, half), x1)
    else:
        half = frame.height_px // 2
        y0, y1 = (y0, min(y1, half)) if last.y_px < half else (max(y0, half), y1)
    return Window(x0, y0, max(0, x1 - x0), max(0, y1 - y0))


def outside_px(frame: Frame, circle: Circle) -> float:
    """How far the circle's centre lies outside the picture; 0 inside."""
    x = max(-circle.x_px, circle.x_px - (frame.width_px - 1), 0.0)
    y = max(-circle.y_px, circle.y_px - (frame.height_px - 1), 0.0)
    return max(x, y)
