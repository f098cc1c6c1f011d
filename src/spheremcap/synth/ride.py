"""What is true of a session of strokes beside its pictures: events, the wheel's angle, the mount, where the wheels are.

All times count from the first frame's stamp, as truth.csv does. The texts are files that lie beside the video.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import tomli_w

from spheremcap.core.camera import Camera
from spheremcap.core.time import NS_PER_S
from spheremcap.synth.strokes import Arm, Motion, Mount, TrueEvent

FloatArray = npt.NDArray[np.float64]
EVENT_COLUMNS = ("side", "marker", "kind", "stamp_ns", "angle_deg", "speed_mps")
WHEEL_COLUMNS = ("time_s", "angle_rad")
ENCODER_HZ = 200


@dataclass(frozen=True, slots=True)
class WheelPoints:
    """A rear wheel in the picture of the camera at rest: its hub (2,) and points on its push rim (N, 2), in pixels; NaN
    beyond the lens."""

    hub_px: FloatArray
    rim_px: FloatArray


@dataclass(frozen=True)
class Ride:
    """A session of strokes of `seconds`, from the first frame's stamp to the last one's."""

    motion: Motion
    mount: Mount
    camera: Camera
    seconds: float

    @cached_property
    def events(self) -> tuple[TrueEvent, ...]:
        """The contacts and releases of both hands within the session, by time."""
        found = [event for arm in self.motion.arms for event in arm.events if 0 <= event.time_s <= self.seconds]
        return tuple(sorted(found, key=lambda event: event.time_s))

    def files(self) -> dict[str, str]:
        """What lies beside the video, by name: events.csv, wheel.csv and analysis.toml."""
        return {
            "events.csv": self._events_csv(),
            "wheel.csv": self._wheel_csv(),
            "analysis.toml": self._analysis_toml(),
        }

    def _events_csv(self) -> str:
        """`EVENT_COLUMNS`: the speed is just before contact, just after release; the angle as in `strokes`."""
        rows = [
            f"{e.side},{e.side}_wrist,{e.kind},{stamp_ns(e)},{np.degrees(e.angle_rad):.6f},{e.speed_mps:.6f}"
            for e in self.events
        ]
        return "\n".join([",".join(EVENT_COLUMNS), *rows]) + "\n"

    def _wheel_csv(self) -> str:
        """`WHEEL_COLUMNS`, as an encoder writes them that begins with the video; the angle grows on the way forward."""
        t = np.arange(int(np.ceil(self.seconds * ENCODER_HZ)) + 1) / ENCODER_HZ
        rows = [f"{at:.3f},{angle:.7f}" for at, angle in zip(t, self.motion.turned_rad(t), strict=True)]
        return "\n".join([",".join(WHEEL_COLUMNS), *rows]) + "\n"

    def _analysis_toml(self) -> str:
        wheels = self.motion.wheels
        said = {
            "wheel": {
                "radius_m": wheels.radius_m,
                "rim_radius_m": wheels.rim_radius_m,
                "camber_deg": _degrees(wheels.camber_rad),
                "track_m": 2 * wheels.half_track_m,
            },
            "chair": {
                "camera_xyz_chair_m": list(self.mount.xyz_chair_m),
                "camera_down_deg": _degrees(self.mount.down_rad),
            },
        }
        return "# Wheels and mount of the rendered world, exact.\n" + tomli_w.dumps(said)


def stamp_ns(event: TrueEvent) -> int:
    """An event's time on the clock of the frames' stamps, in ns."""
    return round(event.time_s * NS_PER_S)


def wheel_points(motion: Motion, mount: Mount, camera: Camera, count: int = 24) -> dict[str, WheelPoints]:
    """The rear wheels as the camera at rest sees them, by side; `count` points a rim, from its top forward."""
    out = {}
    for arm in motion.arms:
        rim = mount.to_camera(circle(arm, motion.wheels.rim_radius_m, count))
        hub = mount.to_camera(arm.in_chair(np.zeros((1, 3))))
        out[arm.side] = WheelPoints(camera.project(hub)[0], camera.project(rim))
    return out


def circle(arm: Arm, radius_m: float, count: int) -> FloatArray:
    """Points (count, 3) on a circle about the hub in the wheel's plane, from its top forward, in the chair's frame."""
    angle = 2 * np.pi * np.arange(count) / count
    return arm.in_chair(radius_m * np.stack([np.sin(angle), np.cos(angle), 0 * angle], axis=1))


def _degrees(angle_rad: float) -> float:
    return round(float(np.degrees(angle_rad)), 9)
