"""The chair's frame from the camera that is fixed to it: one least-squares fit of whatever is known.

The chair's frame has its origin midway between the hubs of the rear wheels, x forward, y to the athlete's left, z up.
Known may be: where the camera is and how far down it looks (tape measure, inclinometer), markers or a clicked point at
known places of the chair, clicks on hubs and push rims, and the circles on which the wrists go while they push. Each is
a row of residuals over its standard deviation; what none of them says is held where chairs have it, as widely as that
is unsure, and the covariance says so.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from spheremcap.analysis.circle import PushCircle
from spheremcap.analysis.rim import Wheel
from spheremcap.core.camera import Camera
from spheremcap.core.chair import ChairClick
from spheremcap.errors import UsageError

FloatArray = npt.NDArray[np.float64]

_CLICK_PX = 1.0
"""How well a person clicks."""
_USUAL_DOWN_DEG, _USUAL_TURN_DEG, _USUAL_XYZ_M = (15.0, 15.0), 4.0, (1.0, 0.02, 1.0)
"""How far down cameras look, how straight they are, and how far from the chair's origin they are: x, y, z."""
_USUAL_HALF_TRACK_M = 0.28, 0.06
_UPRIGHT_DEG = 3.0
"""How well the camera's tilt has to be known for an angle to count from straight up."""
_OUTWARD_M = 0.02, 0.03
"""How far outward of the rim's plane wrists are."""


@dataclass(frozen=True)
class ChairFrame:
    """Where the camera is on the chair.

    `rotation` (3, 3) turns vectors of the camera's optical frame into the chair's; `camera_xyz_chair_m` (3,) is where
    the lens is. `covariance` (6, 6) is that of a small turn (radians, about the chair's axes) and of that place
    (metres). `half_track_m` is from the middle to a hub. `told_by` names what it rests on, `misfit` the residuals' root
    mean square over their standard deviations. Without `upright` nothing says how the camera is tilted.
    """

    rotation: FloatArray
    camera_xyz_chair_m: FloatArray
    covariance: FloatArray
    half_track_m: float
    half_track_sd_m: float
    told_by: tuple[str, ...]
    misfit: float
    upright: bool

    def place(self, xyz_cam_m: FloatArray) -> FloatArray:
        """Positions (N, 3) in the chair's frame, of those in the camera's."""
        out: FloatArray = xyz_cam_m @ self.rotation.T + self.camera_xyz_chair_m
        return out

    def turn(self, covariance: FloatArray) -> FloatArray:
        """Covariances (N, 3, 3) in the chair's axes, of those in the camera's; the frame's own is not in them."""
        out: FloatArray = self.rotation @ covariance @ self.rotation.T
        return out

    @property
    def tilt_sd_rad(self) -> float:
        """Of the pitch, about the axle."""
        return float(np.sqrt(self.covariance[1, 1]))

    def hub_sd_m(self) -> float:
        """Of where an axle is seen across it, in the mean of its two directions."""
        return float(np.sqrt((self.covariance[3, 3] + self.covariance[5, 5]) / 2))


@dataclass(frozen=True)
class Known:
    """What is known of the chair and the camera on it; see `AnalysisSettings` for units. `points` are (xyz_cam_m (3,),
    covariance (3, 3), xyz_chair_m, sd_m), `circles` the pushes' circles by side."""

    camera: Camera
    rim_radius_m: float | None = None
    camber_rad: float = 0.0
    half_track_m: tuple[float, float] | None = None
    camera_xyz_chair_m: tuple[tuple[float, float, float], float] | None = None
    down_rad: tuple[float, float] | None = None
    looks_back: bool | None = None
    points: Sequence[tuple[FloatArray, FloatArray, tuple[float, float, float], float]] = ()
    clicks: Sequence[ChairClick] = ()
    front_xyz_chair_m: tuple[float, float, float] | None = None
    circles: dict[str, PushCircle] = field(default_factory=dict)

    def roughly(self) -> FloatArray:
        """The chair's axes from the camera's (3, 3), of a camera that is straight and looks down as told."""
        down = self.down_rad[0] if self.down_rad else float(np.radians(_USUAL_DOWN_DEG[0]))
        back = _looks_back(self)
        turn = Rotation.from_rotvec([0.0, -down if back else down, 0.0]).as_matrix()
        out: FloatArray = turn @ _straight(back)
        return out

    def told_by(self) -> tuple[str, ...]:
        """What there is, in words."""
        words = {
            "tape measure": self.camera_xyz_chair_m is not None, "inclinometer": self.down_rad is not None,
            "markers on the chair": bool(self.points), "clicks": bool(self.clicks), "pushes": bool(self.circles),
        }  # fmt: skip
        return tuple(word for word, there in words.items() if there)


def chair_frame(known: Known) -> ChairFrame:
    """The frame under which all that is known fits best. Raises UsageError where nothing tells where the axle is."""
    rims = [click for click in known.clicks if click.on.endswith("rim")]
    if rims and known.rim_radius_m is None:
        raise UsageError("clicks on the rim need its radius: give wheel.rim_radius_m in the settings")
    if known.camera_xyz_chair_m is None and not (known.points or known.clicks or known.circles):
        raise UsageError(
            "nothing tells where the axle is: give chair.camera_xyz_chair_m, click the wheels in `annotate`, put "
            "markers on the chair, or track a wrist that pushes"
        )
    return _Fit(known).solved()


class _Fit:
    """Unknowns: a small turn (3), where the camera is (3), half the track, and of each circle radius and plane."""

    def __init__(self, known: Known) -> None:
        self.known = known
        self._base = _straight(_looks_back(known))
        self._sides = tuple(known.circles)
        pixels = np.array([(c.x_px, c.y_px) for c in known.clicks])
        self._rays = known.camera.rays(pixels) if len(pixels) else np.zeros((0, 3))

    def solved(self) -> ChairFrame:
        start = self._start()
        self._weights = self._click_weights(start)
        found = least_squares(self._residuals, start, x_scale="jac")
        self._weights = self._click_weights(found.x)
        found = least_squares(self._residuals, found.x, x_scale="jac")
        alike = sum(2 * (len(circle.xyz_cam_m) - circle.counts) for circle in self.known.circles.values())
        dof = max(1.0, len(found.fun) - alike - len(found.x))
        misfit = float(np.sqrt(found.fun @ found.fun / dof))
        covariance = np.linalg.inv(found.jac.T @ found.jac) * max(1.0, misfit) ** 2
        rotation, xyz, half = self._parts(found.x)
        return ChairFrame(
            rotation, xyz, covariance[:6, :6], half, float(np.sqrt(covariance[6, 6])), self.known.told_by(), misfit,
            bool(np.degrees(np.sqrt(covariance[1, 1])) < _UPRIGHT_DEG),
        )  # fmt: skip

    def _parts(self, x: FloatArray) -> tuple[FloatArray, FloatArray, float]:
        return Rotation.from_rotvec(x[:3]).as_matrix() @ self._base, x[3:6], float(x[6])

    def _start(self) -> FloatArray:
        """A camera that is straight and looks down as told, where the circles or clicks are about the axle."""
        known = self.known
        rotation = known.roughly()
        turn = Rotation.from_matrix(rotation @ self._base.T).as_rotvec()
        half = known.half_track_m[0] if known.half_track_m else _USUAL_HALF_TRACK_M[0]
        places = []
        for side, circle in known.circles.items():
            sign = 1.0 if side == "left" else -1.0
            places.append(np.array([0.0, sign * half, 0.0]) - rotation @ circle.centre_cam_m)
        for xyz, _, there, _ in known.points:
            places.append(np.array(there) - rotation @ xyz)
        if known.camera_xyz_chair_m is not None:
            xyz_m = np.array(known.camera_xyz_chair_m[0])
        elif places:
            xyz_m = np.mean(places, axis=0)
        else:
            xyz_m = self._by_size(rotation, half)
        radii = [value for side in self._sides for value in (known.circles[side].radius_m, _OUTWARD_M[0])]
        return np.array([*turn, *xyz_m, half, *radii])

    def _by_size(self, rotation: FloatArray, half: float) -> FloatArray:
        """Where the camera is, by how large the clicked rims are and where their middles are."""
        places = []
        for side, sign in (("left", 1.0), ("right", -1.0)):
            own = [k for k, c in enumerate(self.known.clicks) if c.on == f"{side}_rim"]
            axle = [k for k, c in enumerate(self.known.clicks) if c.on == f"{side}_axle"]
            if not own:
                continue
            rays = self._rays[own]
            high = np.ptp(np.arctan2(rays[:, 1], rays[:, 2]))
            far = 2 * (self.known.rim_radius_m or 0.2) / max(float(high), 0.02)
            middle = self._rays[axle[0]] if axle else rays.mean(axis=0)
            places.append(np.array([0.0, sign * half, 0.0]) - rotation @ (far * middle / np.linalg.norm(middle)))
        return np.mean(places, axis=0) if places else np.array([1.0 if _looks_back(self.known) else -1.0, 0.0, 0.4])

    def _click_weights(self, x: FloatArray) -> FloatArray:
        """What a pixel of a click is worth at its residual, (clicks,): 1 / sd."""
        camera, clicks = self.known.camera, self.known.clicks
        if not clicks:
            return np.ones(0)
        pixels = np.array([(c.x_px, c.y_px) for c in clicks])
        change = [
            self._rim_gaps(x, camera.rays(pixels + step)) - self._rim_gaps(x, self._rays)
            for step in ((1.0, 0.0), (0.0, 1.0))
        ]
        out: FloatArray = 1 / np.maximum(np.hypot(*change) * _CLICK_PX, 1e-5)
        return out

    def _rim_gaps(self, x: FloatArray, rays: FloatArray) -> FloatArray:
        """How far outward of its rim each clicked ray meets the rim's plane, m (clicks,); 0 for what is no rim."""
        rotation, xyz, half = self._parts(x)
        gaps = np.zeros(len(rays))
        for k, click in enumerate(self.known.clicks):
            if click.on.endswith("rim"):
                wheel = Wheel.of(click.on.split("_")[0], half, self.known.camber_rad)
                hub, axes = wheel.hub_m, wheel.axes
                ray = rotation @ rays[k]
                along = float(axes[2] @ (hub - xyz)) / float(axes[2] @ ray)
                gaps[k] = np.linalg.norm(axes[:2] @ (xyz + along * ray - hub)) - (self.known.rim_radius_m or 0.0)
        return gaps

    def _residuals(self, x: FloatArray) -> FloatArray:
        known = self.known
        rotation, xyz, half = self._parts(x)
        forward = rotation[:, 2]  # the camera's axis in the chair's frame
        across = rotation[:, 0]
        back = -1.0 if _looks_back(known) else 1.0
        down = float(np.arctan2(-forward[2], back * forward[0]))
        yaw, roll = float(np.arctan2(forward[1], back * forward[0])), float(np.arcsin(np.clip(across[2], -1, 1)))
        mean, sd = known.down_rad or tuple(np.radians(_USUAL_DOWN_DEG))
        turn_sd = np.radians(_USUAL_TURN_DEG)
        rows = [np.array([(down - mean) / sd, yaw / turn_sd, roll / turn_sd])]
        if known.camera_xyz_chair_m is not None:
            there, sd_m = known.camera_xyz_chair_m
            rows.append((xyz - there) / sd_m)
        else:
            rows.append(xyz / _USUAL_XYZ_M)
        mean_m, track_sd_m = known.half_track_m or _USUAL_HALF_TRACK_M
        rows.append(np.array([(half - mean_m) / track_sd_m]))
        for xyz_cam, covariance, there, sd_m in known.points:
            root = np.linalg.inv(np.linalg.cholesky(rotation @ covariance @ rotation.T + sd_m**2 * np.eye(3)))
            rows.append(root @ (rotation @ xyz_cam + xyz - there))
        rows.append(self._rim_gaps(x, self._rays) * self._weights)
        for click in known.clicks:
            place: FloatArray | None = None
            if click.on.endswith("axle"):
                place = Wheel.of(click.on.split("_")[0], half, known.camber_rad).hub_m
            elif click.on == "front" and known.front_xyz_chair_m is not None:
                place = np.array(known.front_xyz_chair_m)
            if place is not None:
                pixel = known.camera.project((rotation.T @ (place - xyz))[None])[0]
                gap = pixel - (click.x_px, click.y_px)
                rows.append(np.nan_to_num(gap, nan=1e3) / (2 * _CLICK_PX))
        for k, side in enumerate(self._sides):
            radius, outward = x[7 + 2 * k : 9 + 2 * k]
            wheel, circle = Wheel.of(side, half, known.camber_rad), known.circles[side]
            u, v, w = wheel.axes @ (circle.xyz_cam_m @ rotation.T + xyz - wheel.hub_m).T
            rows.append((np.hypot(u, v) - radius) * circle.weight_per_m)
            rows.append((w - outward) * circle.plane_weight_per_m)
            rows.append(np.array([(outward - _OUTWARD_M[0]) / _OUTWARD_M[1]]))
        return np.concatenate(rows)


def _straight(looks_back: bool) -> FloatArray:
    """The chair's axes of a camera that looks level and straight back or forward: (3, 3), chair from optical."""
    s = -1.0 if looks_back else 1.0
    return np.array([[0.0, 0.0, s], [-s, 0.0, 0.0], [0.0, -1.0, 0.0]])


def _looks_back(known: Known) -> bool:
    """Whether the camera looks at the athlete: the left hand, wheel or marker is then on the picture's right."""
    if known.looks_back is not None:
        return known.looks_back
    left = [c.x_px for c in known.clicks if c.on.startswith("left")]
    right = [c.x_px for c in known.clicks if c.on.startswith("right")]
    if left and right:
        return float(np.mean(left)) > float(np.mean(right))
    if {"left", "right"} <= set(known.circles):
        return bool(known.circles["left"].centre_cam_m[0] > known.circles["right"].centre_cam_m[0])
    return True
