"""Markers of a simulated athlete as a camera measures them: their distance is known far worse than their place in the
picture. No pixel is rendered."""

from dataclasses import dataclass, replace

import numpy as np

from spheremcap.analysis.curves import curves_of
from spheremcap.analysis.rim import Wheel
from spheremcap.analysis.smoother import JointTrack, Smoother
from spheremcap.analysis.strokes import Hand, HandStrokes, strokes_of
from spheremcap.core.camera import Camera
from spheremcap.core.stroke import EventKind
from spheremcap.synth.strokes import Manner, Motion, Mount, motion

START_NS = 1_700_000_000_000_000_000
CAMERA = Camera(1280, 720, 1150.0, 1150.0, 639.5, 359.5, "plumb_bob", (-0.2, 0.05, 0.001, -0.001))
MOUNT = Mount((1.08, 0.0, 0.50), float(np.radians(15.0)))
ACROSS_M, ALONG_M = 0.00015, 0.003
"""Standard deviations across the line of sight and along it."""
_UPPER = [0, 1, 2, 4, 5, 8]


@dataclass(frozen=True)
class Simulated:
    """A motion and the frames on which it is seen."""

    motion: Motion
    t_s: np.ndarray
    seed: int = 0
    along_m: float = ALONG_M

    @property
    def frame_s(self) -> float:
        return float(np.median(np.diff(self.t_s)))

    def true(self, side: str, joint: str) -> np.ndarray:
        """(N, 3) in the chair's frame."""
        return getattr(self.motion, side).joint(joint)(self.t_s)

    def in_camera(self, side: str, joint: str, gap: slice | None = None) -> JointTrack:
        """As measured, in the camera's frame."""
        rng = np.random.default_rng([self.seed, side == "left", *joint.encode()])
        xyz = MOUNT.to_camera(self.true(side, joint))
        xyz, covariance = measured(xyz, rng, self.along_m)
        if gap is not None:
            xyz[gap] = np.nan
        packed = covariance.reshape(-1, 9)[:, _UPPER]
        return JointTrack(f"{side}_{joint}", self.t_s, self.t_s, xyz.astype(np.float32), packed.astype(np.float32))

    def in_chair(self, side: str, joint: str, gap: slice | None = None) -> JointTrack:
        """As measured, in the chair's frame."""
        track = self.in_camera(side, joint, gap)
        axes = MOUNT.axes
        covariance = axes.T @ track.covariance() @ axes
        return replace(
            track, xyz_m=(track.xyz_m @ axes + MOUNT.xyz_chair_m).astype(np.float32),
            packed=covariance.reshape(-1, 9)[:, _UPPER].astype(np.float32),
        )  # fmt: skip

    def hand(self, side: str, *, wheel: bool = True, gap: slice | None = None) -> Hand:
        track = self.in_chair(side, "wrist", gap)
        smoother = Smoother(track)
        curves, _ = curves_of({(side, "wrist"): smoother}, {(side, "wrist"): track.measured}, chair=True)
        wheels = self.motion.wheels
        return Hand(
            side, START_NS, track, smoother.noise, curves[side],
            Wheel.of(side, wheels.half_track_m, wheels.camber_rad),
            self.motion.turned_rad(self.t_s) if wheel else None, self.frame_s,
        )  # fmt: skip

    def strokes(self, side: str, *, wheel: bool = True, gap: slice | None = None) -> HandStrokes:
        return strokes_of(self.hand(side, wheel=wheel, gap=gap), self.motion.wheels.rim_radius_m)


def simulated(
    manner: Manner | None = None, seconds: float = 6.0, rate_hz: float = 240.0, *, seed: int = 0
) -> Simulated:
    made = motion(manner or Manner(), seconds, np.random.default_rng(seed))
    return Simulated(made, np.arange(round(seconds * rate_hz)) / rate_hz, seed)


def measured(
    xyz_cam_m: np.ndarray, rng: np.random.Generator, along_m: float = ALONG_M
) -> tuple[np.ndarray, np.ndarray]:
    """Positions (N, 3) with noise, and its covariances (N, 3, 3)."""
    ray = xyz_cam_m / np.linalg.norm(xyz_cam_m, axis=1)[:, None]
    noise = ACROSS_M * rng.standard_normal(xyz_cam_m.shape)
    noise += ray * np.sqrt(along_m**2 - ACROSS_M**2) * rng.standard_normal((len(ray), 1))
    covariance = ACROSS_M**2 * np.eye(3) + (along_m**2 - ACROSS_M**2) * ray[:, :, None] * ray[:, None, :]
    return xyz_cam_m + noise, covariance


def truth(made: Simulated, side: str, kind: EventKind | str) -> np.ndarray:
    """Times of a hand's true events, but for a tenth of a second at either end."""
    kind = kind.value if isinstance(kind, EventKind) else kind
    ends = made.t_s[0] + 0.1, made.t_s[-1] - 0.1
    times = [e.time_s for e in getattr(made.motion, side).events if e.kind == kind]
    return np.array([t for t in times if ends[0] <= t <= ends[1]])


def told(made: Simulated, found: HandStrokes, kind: EventKind) -> np.ndarray:
    """Times of the events that were found, but for a tenth of a second at either end."""
    times = np.array([(e.stamp_ns - START_NS) / 1e9 for e in found.events if e.kind is kind])
    return times[(times >= made.t_s[0] + 0.1) & (times <= made.t_s[-1] - 0.1)]
