"""All that is found in a session: the chair's frame, both hands' strokes, arms, trunk, lengths, and how good it is."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from spheremcap.analysis.chair import ChairFrame, Known, chair_frame
from spheremcap.analysis.circle import PushCircle, push_circle
from spheremcap.analysis.curves import ArmCurves, SegmentLength, TrunkCurves, curves_of, segment_length
from spheremcap.analysis.rim import Wheel
from spheremcap.analysis.settings import JOINTS, SIDES, AnalysisSettings
from spheremcap.analysis.smoother import JointTrack, Smoother, unpacked
from spheremcap.analysis.strokes import Hand, HandStrokes, strokes_of
from spheremcap.core.camera import Camera
from spheremcap.core.chair import ChairClick
from spheremcap.core.time import NS_PER_S
from spheremcap.errors import UsageError
from spheremcap.io.poses import Poses, without_focal
from spheremcap.io.recording import Sensor

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

_CIRCLE_FRAMES = 12_000
"""So many frames tell where the push's circle is."""
_MISFIT = 3.0
"""What is known of the chair contradicts itself where it fits so badly."""
_BLOCK = 8192
_WHEEL_GAP_S = 0.1
"""Across so long without a sample nothing is known of a wheel."""


@dataclass(frozen=True)
class Session:
    """What of a recording an analysis is made of; it takes poses and wheels out, once tracks are made of them.

    `readout_s` is the rolling shutter's (None: nobody knows); `requests` counts the open ones by marker, `clocks` has
    what a merge wrote of each input's clock.
    """

    name: str
    poses: dict[str, Poses]
    wheels: dict[str, Sensor]
    camera: Camera | None
    readout_s: float | None
    requests: Mapping[str, int]
    clocks: Mapping[str, Mapping[str, str]]


@dataclass(frozen=True)
class MarkerQuality:
    """How much of a marker was measured: frames and shares of them, the longest gap in ms, open requests, and the
    factor by which its positions scatter more than their standard deviations say (None: too few to tell)."""

    marker: str
    frames: int
    measured: float
    bridged: float
    longest_gap_ms: float
    requests: int
    noise: float | None


@dataclass(frozen=True)
class Findings:
    """A session's analysis; the session is without poses and wheels. `stamp_ns` (N,) are its frames; what could not be
    had is named in `notes`."""

    session: Session
    stamp_ns: npt.NDArray[np.int64]
    chair: ChairFrame | None
    arms: Mapping[str, ArmCurves]
    trunk: TrunkCurves | None
    hands: Mapping[str, HandStrokes]
    lengths: tuple[SegmentLength, ...]
    quality: tuple[MarkerQuality, ...]
    notes: tuple[str, ...]

    def about(self, side: str, part: slice) -> dict[str, FloatArray]:
        """Of a part of the frames the wrist's angle about the axle and its gap outward of the push's circle, (M,) each,
        by their names in spheremcap.ArmSample; none of a hand that never goes along a rim."""
        hand = self.hands.get(side)
        if hand is None or not np.isfinite(hand.push_radius_m) or self.chair is None:
            return {}
        about = self.arms[side].about(hand.wheel, part)
        sd = np.sqrt(np.diagonal(about.covariance, axis1=1, axis2=2))
        found = {"gap_mm": (about.radius_m - hand.push_radius_m) * 1e3, "gap_sd_mm": sd[:, 0] * 1e3}
        if self.chair.upright:
            found["angle_deg"] = (np.degrees(about.angle_rad) + 90) % 360 - 90
            found["angle_sd_deg"] = np.degrees(sd[:, 1] / about.radius_m)
        return found


def findings_of(
    session: Session, settings: AnalysisSettings, clicks: Sequence[ChairClick] = (), fill_s: float = 0.0
) -> Findings:
    """Analyse a session. What cannot be had is named in the notes, and the rest is still done; `fill_s` is how long a
    gap in a marker may be that its smoothed path stands in for. Raises UsageError where there is no position at all."""
    if not any(poses.measured.any() for poses in session.poses.values()):
        raise UsageError(
            f"{session.name}: no marker has a position in metres; was it tracked without a camera? "
            "Give --camera to track"
        )
    notes: list[str] = []
    names = tuple(session.poses)
    joints = {
        (side, joint): name
        for side in SIDES
        for joint in JOINTS
        if (name := settings.marker_of(side, joint, names)) is not None
    }
    notes += _unnamed(joints, settings, names)
    stamps = np.unique(np.concatenate([poses.stamp_ns for poses in session.poses.values()]))
    stamp_s = (stamps - stamps[0]) / NS_PER_S
    frame_s = float(np.median(np.diff(stamp_s))) if len(stamps) > 1 else 1.0
    in_camera = {key: _track(session, session.poses[name], stamps, stamp_s) for key, name in joints.items()}
    wheels = _wheels(session, settings, notes)
    chair = _chair(session, settings, clicks, in_camera, wheels, stamps[0], notes)
    smoothers, may_use = {}, {}
    for key, track in in_camera.items():
        if chair is not None:
            _place(track, chair)
        if track.measured.sum() < 4:
            notes.append(f"{track.marker}: measured on {int(track.measured.sum())} frames, too few for anything")
            continue
        smoothers[key] = Smoother(track)
        may_use[key] = _usable(track, fill_s)
    quality = tuple(_quality(session, joints, smoothers))
    session.poses.clear()  # half an hour of them is a hundred megabytes, and the tracks have them
    session.wheels.clear()
    curves, trunk = curves_of(smoothers, may_use, chair=chair is not None and chair.upright)
    hands = {}
    for side, arm in curves.items():
        if chair is None:
            continue
        smoother, turned = smoothers[side, "wrist"], None
        if side in wheels:
            turned = _forward(_turned(wheels[side], smoother.track.t_s, int(stamps[0])), side, settings, notes)
        hand = Hand(
            side, int(stamps[0]), smoother.track, smoother.noise, arm,
            chair.wheel(side, float(np.radians(settings.wheel.camber_deg))),
            turned, frame_s, chair.hub_sd_m(), chair.tilt_sd_rad if chair.upright else None,
        )  # fmt: skip
        hands[side] = strokes_of(hand, settings.wheel.rim_radius_m)
        notes += hands[side].notes
    return Findings(
        session, stamps, chair, curves, trunk, hands, tuple(_lengths(curves, stamp_s)),
        quality, tuple(notes),
    )  # fmt: skip


def _unnamed(joints: Mapping[tuple[str, str], str], settings: AnalysisSettings, names: tuple[str, ...]) -> list[str]:
    """What no marker is named as, as far as it is missed."""
    notes = []
    for joint, marker in settings.markers.items():
        if marker not in names:
            notes.append(f"{joint} is to be {marker!r}, which is not in the recording; there are: {', '.join(names)}")
    wrists = [side for side in SIDES if (side, "wrist") in joints]
    if len(wrists) < 2:
        missing = " and ".join(f"{side}_wrist" for side in SIDES if side not in wrists)
        notes.append(
            f"no marker is {missing}: no strokes of that hand; say which in the settings: "
            f'[markers] {missing.split(" ")[0]} = "..." (there are: {", ".join(names)})'
        )
    return notes


def _track(session: Session, poses: Poses, stamps: npt.NDArray[np.int64], stamp_s: FloatArray) -> JointTrack:
    """A marker on all frames, in the camera's frame, at the times when its rows were exposed."""
    camera, t_s = session.camera, stamp_s
    at = np.searchsorted(stamps, poses.stamp_ns)
    xyz, packed = (np.full((len(stamps), width), np.nan, np.float32) for width in (3, 6))
    xyz[at], packed[at] = poses.xyz_cam_m, without_focal(poses, 0.0 if camera is None else camera.focal_sd)
    if camera is not None and session.readout_s:
        row = np.zeros(len(stamps))
        row[at] = np.nan_to_num(poses.row_px / (camera.height_px - 1) - 0.5)
        t_s = np.maximum.accumulate(stamp_s + row * session.readout_s)
    return JointTrack(poses.marker, stamp_s, t_s, xyz, packed)


def _place(track: JointTrack, chair: ChairFrame) -> None:
    """Bring a track into the chair's frame, in place: half an hour of all markers is a hundred megabytes."""
    for start in range(0, len(track), _BLOCK):
        part = slice(start, start + _BLOCK)
        turned = chair.turn(track.covariance(part))
        track.packed[part] = turned.reshape(-1, 9)[:, [0, 1, 2, 4, 5, 8]]
        track.xyz_m[part] = chair.place(track.xyz_m[part].astype(np.float64))


def _usable(track: JointTrack, fill_s: float) -> BoolArray:
    """Where a marker was measured, or between two measured frames that are no further apart than a gap may be long."""
    measured = track.measured
    if fill_s <= 0:
        return measured
    index = np.flatnonzero(measured)
    use = measured.copy()
    for before, after in pairwise(index):
        if after - before > 1 and track.stamp_s[after] - track.stamp_s[before] <= fill_s:
            use[before:after] = True
    return use


def _chair(
    session: Session, settings: AnalysisSettings, clicks: Sequence[ChairClick],
    tracks: Mapping[tuple[str, str], JointTrack], wheels: Mapping[str, tuple[FloatArray, FloatArray, int]],
    start_ns: int, notes: list[str],
) -> ChairFrame | None:  # fmt: skip
    """The chair's frame from all that is known; None, and a note, where nothing tells it."""
    chair, wheel = settings.chair, settings.wheel
    if session.camera is None:
        notes.append("no calibration is in the recording: no chair's frame, no strokes")
        return None
    if wheel.rim_radius_m is None:
        notes.append("no rim: give wheel.rim_radius_m in the settings, so that no other circle is taken for the push's")
    points = []
    for point in chair.points:
        poses = session.poses.get(point.marker)
        if poses is None or not poses.measured.any():
            notes.append(f"{point.marker} is to be on the chair, but has no position in the recording")
            continue
        xyz = np.median(poses.xyz_cam_m[poses.measured], axis=0).astype(np.float64)
        (covariance,) = unpacked(np.median(poses.covariance_m2[poses.measured], axis=0, keepdims=True))
        points.append((xyz, covariance, point.xyz_chair_m, point.sd_m))
    down = None if chair.camera_down_deg is None else np.radians([chair.camera_down_deg, chair.camera_down_sd_deg])
    known = Known(
        session.camera, wheel.rim_radius_m, float(np.radians(wheel.camber_deg)),
        None if wheel.track_m is None else (wheel.track_m / 2, wheel.track_sd_m / 2),
        None if chair.camera_xyz_chair_m is None else (chair.camera_xyz_chair_m, chair.camera_xyz_sd_m),
        None if down is None else (float(down[0]), float(down[1])),
        None if chair.looks is None else chair.looks == "back",
        points, tuple(clicks), chair.front_xyz_chair_m,
    )  # fmt: skip
    circles = _circles(known, tracks, wheels, start_ns)
    for some in (circles, {}):
        given = replace(known, circles=some)
        try:
            frame = chair_frame(given)
        except UsageError as error:
            notes.append(f"no chair's frame, no strokes: {error}")
            return None
        if frame.misfit < _MISFIT or not some:
            break
        notes.append("the wrists' circles do not agree with what is said of the chair: they are left out")
    if frame.misfit >= _MISFIT:
        notes.append(
            f"what is known of the chair ({', '.join(frame.told_by)}) contradicts itself: residuals are "
            f"{frame.misfit:.1f} times what they should be; check the settings and clicks"
        )
    if not frame.upright:
        notes.append(
            "nothing says how the camera is tilted: no angles of contact and release, no elevations; give "
            "chair.camera_down_deg, or a point of the chair that is known"
        )
    return frame


def _circles(
    known: Known, tracks: Mapping[tuple[str, str], JointTrack],
    wheels: Mapping[str, tuple[FloatArray, FloatArray, int]], start_ns: int,
) -> dict[str, PushCircle]:  # fmt: skip
    """The circles of both wrists' pushes, as far as they have any."""
    found: dict[str, PushCircle] = {}
    wrists = {side: tracks[side, "wrist"] for side in SIDES if (side, "wrist") in tracks}
    places = {side: np.nanmedian(t.xyz_m[t.measured], axis=0) for side, t in wrists.items() if t.measured.any()}
    back = known.looks_back
    if back is None and len(places) == 2:
        back = bool(places["left"][0] > places["right"][0])
    straight = replace(known, looks_back=True if back is None else back).roughly()
    for side, track in wrists.items():
        counts = np.concatenate([[0], np.cumsum(track.measured)])
        length = min(_CIRCLE_FRAMES, len(track))
        first = int(np.argmax(counts[length:] - counts[:-length]))
        part = slice(first, first + length)
        if track.measured[part].sum() < 50:
            continue
        motion, seen = Smoother(track).motion(part), track.measured[part]
        plane = Wheel.of(side, 0.0, known.camber_rad).axes @ straight
        wheel = wheels.get(side)
        turning = None
        if wheel is not None:
            turned = _turned(wheel, track.t_s[part], start_ns)
            turning = np.abs(np.gradient(turned, track.t_s[part]))[seen]
        circle = push_circle(
            track.t_s[part][seen], motion.xyz_m[seen], motion.velocity_mps[seen], plane, known.rim_radius_m, turning
        )
        if circle is not None:
            found[side] = circle
    return found


def _wheels(
    session: Session, settings: AnalysisSettings, notes: list[str]
) -> dict[str, tuple[FloatArray, FloatArray, int]]:
    """By side a wheel's sample times in s from its first, how far it had turned, and that first stamp in ns."""
    told = {}
    for name, sensor in session.wheels.items():
        turned = _angle(sensor)
        if turned is None:
            notes.append(f"wheel {name!r} has neither an angle nor a rate: it is not used")
        else:
            told[name] = (sensor.stamp_ns - sensor.stamp_ns[0]) / NS_PER_S, turned, int(sensor.stamp_ns[0])
    found = {}
    for side, given in (("left", settings.wheel.left), ("right", settings.wheel.right)):
        named = [name for name in told if side in name.lower()]
        other = [name for name in told if not any(s in name.lower() for s in SIDES)]
        if given is not None and given not in session.wheels:
            notes.append(
                f"the {side} wheel is to be {given!r}, of which there are no samples: {', '.join(told) or 'none'}"
            )
        names = [given] if given in told else named or other
        if given is None and len(names) > 1:
            notes.append(f"which of {', '.join(names)} is the {side} wheel? Say so: wheel.{side}")
        elif names and names[0] in told:
            found[side] = told[names[0]]
    return found


def _angle(sensor: Sensor) -> FloatArray | None:
    """How far a wheel has turned at each sample, rad (N,): its angle without jumps, else its rate summed up."""
    angle, rate = sensor.values.get("angle_rad"), sensor.values.get("rate_rad_s")
    if angle is not None and np.isfinite(angle).any():
        seen = np.isfinite(angle)
        out = np.full(len(angle), np.nan)
        out[seen] = np.unwrap(angle[seen])
        return out
    if rate is not None and np.isfinite(rate).any():
        dt = np.diff(sensor.stamp_ns) / NS_PER_S
        return np.concatenate([[0.0], np.cumsum((rate[1:] + rate[:-1]) / 2 * dt)])
    return None


def _turned(wheel: tuple[FloatArray, FloatArray, int], t_s: FloatArray, start_ns: int) -> FloatArray:
    """How far a wheel has turned at times from a start, rad (N,); NaN where it has no samples around."""
    times, turned, first_ns = wheel
    seen = np.isfinite(turned)
    times, turned = times[seen], turned[seen]
    at = t_s + (start_ns - first_ns) / NS_PER_S
    out = np.interp(at, times, turned, left=np.nan, right=np.nan)
    after = np.clip(np.searchsorted(times, at), 1, max(1, len(times) - 1))
    if len(times) > 1:
        out[times[after] - times[after - 1] > _WHEEL_GAP_S] = np.nan
    return out


def _forward(turned: FloatArray, side: str, settings: AnalysisSettings, notes: list[str]) -> FloatArray:
    """How far a wheel has turned forward: as the settings say, else the way that it turned farther."""
    seen = turned[np.isfinite(turned)]
    if not len(seen):
        notes.append(f"the {side} wheel has no samples while the wrist was seen: is its clock the video's?")
    if settings.wheel.reverse is not None:
        return -turned if settings.wheel.reverse else turned
    if len(seen) and seen[-1] < seen[0]:
        notes.append(f"the {side} wheel's angle falls on the way forward: taken the other way round; see wheel.reverse")
        return -turned
    return turned


def _lengths(curves: Mapping[str, ArmCurves], stamp_s: FloatArray) -> list[SegmentLength]:
    found = []
    for side, arm in curves.items():
        for name, segment in (("forearm", f"{side} forearm"), ("upper_arm", f"{side} upper arm")):
            if f"{name}_m" in arm.values:
                found.append(segment_length(segment, stamp_s, arm.values[f"{name}_m"], arm.values[f"{name}_sd_m"]))
    return found


def _quality(
    session: Session, joints: Mapping[tuple[str, str], str], smoothers: Mapping[tuple[str, str], Smoother]
) -> list[MarkerQuality]:
    noise = {name: smoothers[key].noise for key, name in joints.items() if key in smoothers}
    found = []
    for name, poses in session.poses.items():
        measured = poses.measured
        stamps = poses.stamp_ns[measured]
        gap_ns = int(np.diff(stamps).max()) if len(stamps) > 1 else 0
        found.append(
            MarkerQuality(
                name, len(poses), float(measured.mean()), float(poses.bridged.mean()), gap_ns / 1e6,
                session.requests.get(name, 0), noise.get(name),
            )
        )  # fmt: skip
    return found
