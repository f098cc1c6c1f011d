"""Read a recording back: markers and sensors as arrays, requests, settings.

Indexed, unindexed and damaged files are all read; what cannot be had is named in `damage`. A file is read
once, in log-time order, and closed again: what stays in memory are the arrays.
"""

import importlib
import itertools
import math
import os
import re
import tomllib
from array import array
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import DecodeError
from mcap.records import Channel

from spheremcap.core.camera import Camera
from spheremcap.core.circle import Circle
from spheremcap.core.estimate import MarkerEstimate, OperatorRequest, Status
from spheremcap.core.frame import Window
from spheremcap.core.vote import Verdict
from spheremcap.errors import SourceError, UsageError, short
from spheremcap.io import _pb
from spheremcap.io.calibration import camera_of, focal_sd_of
from spheremcap.io.decode import decoder
from spheremcap.io.mcap_log import OUTCOME_METADATA, RUN_METADATA
from spheremcap.io.mcap_records import McapRecords, RawMessage
from spheremcap.io.messages import Message, stamp_of

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
TextArray = npt.NDArray[np.str_]

STATE = _pb.MarkerState.DESCRIPTOR.full_name
REQUEST = _pb.OperatorRequest.DESCRIPTOR.full_name
CALIBRATION = CameraCalibration.DESCRIPTOR.full_name
IMU, WHEEL = _pb.ImuSample.DESCRIPTOR.full_name, _pb.WheelSample.DESCRIPTOR.full_name
SENSORS = (IMU, WHEEL)
UNREADABLE = (DecodeError, ValueError, OverflowError, KeyError)
"""What reading a message of ours ends in when it is damaged."""
_TIMESTAMP = "google.protobuf.Timestamp"
_DEEPEST = 8  # levels of a sensor's message that are looked into; a message may hold itself

_STATUS = {_pb.MarkerState.Status.Value(status.value): status.value for status in Status}
# Their numbers before viewers' colours went by them.
_STATUS |= dict(enumerate(("SEEDED", "VERIFIED", "ESTIMATED", "LOST", "OUT_OF_VIEW"), 1))
_VERDICT = {_pb.MarkerVotes.Verdict.Value(verdict.value): verdict.value for verdict in Verdict}
_NAN3 = (math.nan,) * 3
_NAN9 = (math.nan,) * 9


class StateRow(NamedTuple):
    """One marker on one frame as the file has it; `numbers` is laid out as in `_Numbers`, NaN where unset."""

    marker: str
    frame_index: int
    stamp_ns: int
    status: str
    verdict: str
    proposer: str
    reasons: str
    numbers: tuple[float, ...]

    @property
    def circle_px(self) -> tuple[float, ...]:
        """x, y and radius in pixels."""
        return self.numbers[_Numbers.circle_px]

    @property
    def xyz_cam_m(self) -> tuple[float, ...]:
        """Position in the camera's optical frame, metres."""
        return self.numbers[_Numbers.xyz_cam_m]

    @property
    def vote_sum(self) -> float:
        """Of 6."""
        return self.numbers[_Numbers.vote_sum]


class _Numbers:
    """Where each quantity stands in `StateRow.numbers`."""

    circle_px = slice(0, 3)
    circle_sd_px = slice(3, 6)
    claim_px = slice(6, 9)
    xyz_cam_m = slice(9, 12)
    covariance_m2 = slice(12, 21)
    velocity_cam_mps = slice(21, 24)
    smoothed_xyz_cam_m = slice(24, 27)
    smoothed_covariance_m2 = slice(27, 36)
    smoothed_velocity_cam_mps = slice(36, 39)
    vote_sum = 39
    visible = 40
    count = 41


@dataclass(frozen=True)
class Track:
    """One marker over time, a row a frame, by rising `stamp_ns`; NaN, "" and frame -1 where there is nothing.

    Shapes: (N,) unless said otherwise. `stamp_ns` is the recording's log time. `status` and `verdict` hold
    the names of Status and Verdict, `reasons` what spoke against the claim, as in "colour;no outline". Circles
    are (N, 3): x, y, r in pixels. Positions and velocities are (N, 3) in the camera's optical frame, metres and
    metres a second; covariances (N, 3, 3) in m^2. As in MarkerEstimate, circle and position are measured where
    `measured`, the Kalman filter's where ESTIMATED, absent elsewhere.
    """

    marker: str
    stamp_ns: IntArray
    frame: IntArray
    status: TextArray
    verdict: TextArray
    proposer: TextArray
    reasons: TextArray
    circle_px: FloatArray
    circle_sd_px: FloatArray
    claim_px: FloatArray
    xyz_cam_m: FloatArray
    covariance_m2: FloatArray
    velocity_cam_mps: FloatArray
    smoothed_xyz_cam_m: FloatArray
    smoothed_covariance_m2: FloatArray
    smoothed_velocity_cam_mps: FloatArray
    vote_sum: FloatArray
    visible: FloatArray

    def __len__(self) -> int:
        return len(self.stamp_ns)

    @property
    def measured(self) -> npt.NDArray[np.bool_]:
        """(N,) whether the row rests on its picture: SEEDED or VERIFIED."""
        return np.isin(self.status, [status.value for status in Status if status.measured])

    def at(self, stamps: npt.ArrayLike, tolerance_ns: int | None = None) -> "Track":
        """The rows nearest to `stamps` (M,) in ns, one for each; see `match`."""
        wanted = np.asarray(stamps, np.int64)
        index = match(self.stamp_ns, wanted, tolerance_ns)
        columns = [f.name for f in fields(self) if f.name not in ("marker", "stamp_ns")]
        taken: dict[str, Any] = {name: _take(getattr(self, name), index) for name in columns}
        return replace(self, stamp_ns=wanted, **taken)

    def columns(self) -> dict[str, npt.NDArray[Any]]:
        """The columns of `spheremcap export`, each (N,), by name; NaN where there is no value."""
        return {
            "marker": np.full(len(self), self.marker),
            "frame": self.frame,
            "stamp_ns": self.stamp_ns,
            "status": self.status,
            **_spread("{}_px", "xyr", self.circle_px),
            **_spread("{}_cam_m", "xyz", self.xyz_cam_m),
            "vote_sum": self.vote_sum,
            "verdict": self.verdict,
            "proposer": self.proposer,
            "reasons": self.reasons,
            "visible": self.visible,
            **_spread("{}_sd_px", "xyr", self.circle_sd_px),
            **_spread("{}_sd_m", "xyz", _deviations(self.covariance_m2)),
            **_spread("v{}_cam_mps", "xyz", self.velocity_cam_mps),
            **_spread("{}_smoothed_m", "xyz", self.smoothed_xyz_cam_m),
            **_spread("{}_smoothed_sd_m", "xyz", _deviations(self.smoothed_covariance_m2)),
            **_spread("v{}_smoothed_mps", "xyz", self.smoothed_velocity_cam_mps),
        }

    def to_pandas(self) -> Any:
        """A pandas.DataFrame of `columns`. Raises UsageError when pandas is not installed."""
        return _frame(self.columns())


@dataclass(frozen=True)
class Sensor:
    """One sensor's samples: `values` has an (N,) array for each number in its messages, NaN where unset.

    `stamp_ns` (N,) is the recording's log time, `own_stamp_ns` (N,) the publish time, which a merge leaves
    as the sensor's own. Names are the fields' paths, `linear_acceleration.x`; units are those of the
    message's .proto.
    """

    topic: str
    stamp_ns: IntArray
    own_stamp_ns: IntArray
    values: Mapping[str, FloatArray]

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def __getitem__(self, name: str) -> FloatArray:
        """`sensor["magnetic_field.x"]` is (N,), `sensor["magnetic_field"]` all of its numbers, (N, 3)."""
        if name in self.values:
            return self.values[name]
        parts = [column for path, column in self.values.items() if path.startswith(f"{name}.")]
        if not parts:
            raise KeyError(f"{self.topic} has no {name!r}; there are: {', '.join(self.values)}")
        return np.stack(parts, axis=1)

    def at(self, stamps: npt.ArrayLike, tolerance_ns: int | None = None) -> "Sensor":
        """The samples nearest to `stamps` (M,) in ns, one for each; see `match`."""
        wanted = np.asarray(stamps, np.int64)
        index = match(self.stamp_ns, wanted, tolerance_ns)
        values = {name: _take(column, index) for name, column in self.values.items()}
        return Sensor(self.topic, wanted, _take(self.own_stamp_ns, index), values)

    def to_pandas(self) -> Any:
        """A pandas.DataFrame of all values. Raises UsageError when pandas is not installed."""
        return _frame({"stamp_ns": self.stamp_ns, "own_stamp_ns": self.own_stamp_ns, **self.values})


@dataclass(frozen=True)
class Recording:
    """A recording in memory, without its pictures.

    `tracks` go by the marker's name (after `left/` when its topics are under /left), `sensors` by their
    topic without a leading /sensors/. `info` is what the first run wrote of itself (input, version, time
    source) and of its outcome, `runs` all of them by id. `camera` is the first one found. `damage` is one
    line about what could not be read, None for a whole file.
    """

    path: Path
    tracks: Mapping[str, Track]
    sensors: Mapping[str, Sensor]
    requests: tuple[OperatorRequest, ...]
    camera: Camera | None
    runs: Mapping[str, Mapping[str, str]]
    settings_toml: str
    seeds_toml: str
    damage: str | None

    @property
    def info(self) -> Mapping[str, str]:
        """What the first run says of itself; empty when no run of ours wrote the file."""
        return next(iter(self.runs.values()), {})

    @property
    def settings(self) -> dict[str, Any]:
        """The settings the run had, all of them; empty when the file has none."""
        try:
            return tomllib.loads(self.settings_toml)
        except (ValueError, RecursionError) as error:
            raise SourceError(f"{self.path}: its settings are damaged: {short(error)}") from error


def open(path: str | os.PathLike[str]) -> Recording:
    """Read a recording's tracks, sensors, requests and settings.

    Raises SourceError when there is no such file or it is not an MCAP at all; lesser damage is told in
    `damage`.
    """
    tracks: dict[str, _TrackRows] = {}
    sensors: dict[int, SensorRows] = {}
    requests: list[OperatorRequest] = []
    camera: Camera | None = None
    with McapRecords(path) as records:
        names = schema_names(records)
        sensing = {c.id for c in records.channels.values() if senses(c, names[c.id])}
        wanted = {STATE, REQUEST, CALIBRATION}
        topics = {c.topic for c in records.channels.values() if c.id in sensing or names[c.id] in wanted}
        for raw in records.messages(topics):
            kind = names.get(raw.channel.id)
            try:
                if kind == STATE:
                    row = state_row(raw.data, raw.log_time)
                    tracks.setdefault(track_name(raw.channel.topic, row.marker), _TrackRows()).add(row)
                elif kind == REQUEST:
                    requests.append(request_of(raw))
                elif kind == CALIBRATION:
                    camera = camera or camera_in(CameraCalibration.FromString(raw.data), raw.channel)
                elif raw.channel.id in sensing:
                    if raw.channel.id not in sensors:
                        sensors[raw.channel.id] = SensorRows(raw.channel, records)
                    sensors[raw.channel.id].add(raw)
            except UNREADABLE as error:
                records.undecodable(raw.channel.topic, error)
        texts = {a.name: a.data.decode("utf-8", "replace") for a in reversed(list(records.attachments()))}
        runs = runs_of(records)
        damage = damage_line(records)
    return Recording(
        path=Path(path),
        tracks={name: rows.track(name) for name, rows in tracks.items()},
        sensors={sensor_name(rows.topic): rows.sensor() for rows in sensors.values() if len(rows)},
        requests=tuple(requests),
        camera=camera,
        runs=runs,
        settings_toml=texts.get("settings.toml", ""),
        seeds_toml=texts.get("seeds.toml", ""),
        damage=damage,
    )


def iter_states(
    records: McapRecords,
    topics: Collection[str] | None = None,
    start_ns: int | None = None,
    end_ns: int | None = None,
) -> Iterator[StateRow]:
    """Every marker on every frame, by log time, without keeping any; `records` counts those that do not decode. Of the
    `topics` of these states, or of all; from `start_ns` to before `end_ns`, and the first of each channel whenever it
    is, so that every marker comes."""
    names = schema_names(records)
    if topics is None:
        topics = {channel.topic for channel in records.channels.values() if names[channel.id] == STATE}
    met: set[int] = set()
    for raw in records.messages(topics):
        if names.get(raw.channel.id) == STATE:
            before = start_ns is not None and raw.log_time < start_ns
            if raw.channel.id in met and (before or (end_ns is not None and raw.log_time >= end_ns)):
                continue
            met.add(raw.channel.id)
            try:
                row = state_row(raw.data, raw.log_time)
            except UNREADABLE as error:
                records.undecodable(raw.channel.topic, error)
                continue
            yield row._replace(marker=track_name(raw.channel.topic, row.marker))


def iter_columns(
    records: McapRecords, rows: int = 4096, start_ns: int | None = None, end_ns: int | None = None
) -> Iterator[dict[str, npt.NDArray[Any]]]:
    """`Track.columns` of all markers together, by log time, `rows` at a time, so that memory stays flat. The times are
    those of `iter_states`."""
    states = iter_states(records, None, start_ns, end_ns)
    while batch := list(itertools.islice(states, rows)):
        table = _TrackRows()
        for row in batch:
            table.add(row)
        yield table.track("").columns() | {"marker": np.array([row.marker for row in batch])}


def read_sensors(records: McapRecords, start_ns: int, end_ns: int) -> dict[str, Sensor]:
    """The IMUs and wheels of a recording by topic as in `Recording.sensors`, from `start_ns` to before `end_ns`."""
    names = schema_names(records)
    topics = {c.topic for c in records.channels.values() if names[c.id] in SENSORS}
    found: dict[int, SensorRows] = {}
    for raw in records.messages(topics) if topics else ():
        if names.get(raw.channel.id) in SENSORS and start_ns <= raw.log_time < end_ns:
            try:
                if raw.channel.id not in found:
                    found[raw.channel.id] = SensorRows(raw.channel, records)
                found[raw.channel.id].add(raw)
            except UNREADABLE as error:
                records.undecodable(raw.channel.topic, error)
    return {sensor_name(rows.topic): rows.sensor() for rows in found.values() if len(rows)}


def first_camera(records: McapRecords) -> Camera | None:
    """The first calibration of a recording that can be read; None where there is none."""
    names = schema_names(records)
    for topic in sorted({c.topic for c in records.channels.values() if names[c.id] == CALIBRATION}):
        for raw in records.messages([topic]):
            try:
                camera = camera_in(CameraCalibration.FromString(raw.data), raw.channel)
            except UNREADABLE as error:
                records.undecodable(topic, error)
                continue
            if camera is not None:
                return camera
    return None


def first_settings(records: McapRecords) -> dict[str, Any]:
    """The settings that the first run of a recording had; empty where it has none that can be read."""
    for attachment in records.attachments():
        if attachment.name == "settings.toml":
            try:
                return tomllib.loads(attachment.data.decode("utf-8", "replace"))
            except (ValueError, RecursionError):
                return {}
    return {}


def state_row(data: bytes, stamp_ns: int) -> StateRow:
    """The content of a serialised spheremcap.MarkerState, NaN and "" for what is not set. Raises UNREADABLE."""
    m = _pb.MarkerState.FromString(data)
    has = m.HasField
    numbers = (
        *(_xyr(m.circle) if has("circle") else _NAN3),
        *(_xyr(m.circle_sd) if has("circle_sd") else _NAN3),
        *(_xyr(m.claim) if has("claim") else _NAN3),
        *(_xyz(m.position) if has("position") else _NAN3),
        *(m.covariance if len(m.covariance) == 9 else _NAN9),
        *(_xyz(m.velocity) if has("velocity") else _NAN3),
        *(_xyz(m.smoothed_position) if has("smoothed_position") else _NAN3),
        *(m.smoothed_covariance if len(m.smoothed_covariance) == 9 else _NAN9),
        *(_xyz(m.smoothed_velocity) if has("smoothed_velocity") else _NAN3),
        m.vote_sum if has("vote_sum") else math.nan,
        m.visible if has("visible") else math.nan,
    )
    status, verdict = _STATUS.get(m.status, ""), _VERDICT.get(m.verdict, "")
    return StateRow(
        m.marker, int(m.frame_index), int64_ns(stamp_ns), status, verdict, m.proposer, ";".join(m.reasons), numbers
    )


def estimate_of(data: bytes) -> MarkerEstimate:
    """The estimate of a serialised spheremcap.MarkerState; its votes are in another message. Raises UNREADABLE."""
    m = _pb.MarkerState.FromString(data)
    has, square = m.HasField, (3, 3)
    sd = m.circle_sd
    return MarkerEstimate(
        m.marker, int(m.frame_index), stamp_of(m.timestamp), Status(_STATUS[m.status]),
        Circle(*_xyr(m.circle)) if has("circle") else None,
        (sd.x_px, sd.y_px, sd.r_px) if has("circle_sd") else None,
        Circle(*_xyr(m.claim)) if has("claim") else None,
        m.proposer,
        tuple((p.proposer, Circle(*_xyr(p.circle))) for p in m.proposals),
        Window(m.search.x, m.search.y, m.search.width, m.search.height) if has("search") else None,
        (),
        m.vote_sum if has("vote_sum") else None,
        Verdict(_VERDICT[m.verdict]) if has("verdict") else None,
        m.visible if has("visible") else None,
        np.array(_xyz(m.position)) if has("position") else None,
        np.array(m.covariance).reshape(square) if len(m.covariance) == 9 else None,
        np.array(_xyz(m.velocity)) if has("velocity") else None,
        tuple(m.reasons),
        int(m.answer_frame) if has("answer_frame") else None,
    )  # fmt: skip


def match(samples: IntArray, stamps: IntArray, tolerance_ns: int | None = None) -> IntArray:
    """For each of `stamps` (M,) the index of the nearest of the rising `samples` (N,), -1 where none is.

    None is taken from further than `tolerance_ns` (by default half the samples' median interval), and no
    sample goes to two stamps: the nearer one gets it, of two equally near the earlier. All in int
    nanoseconds.
    """
    if len(samples) == 0:
        return np.full(stamps.shape, -1, np.int64)
    if tolerance_ns is None:
        tolerance_ns = int(np.median(np.diff(samples))) // 2 if len(samples) > 1 else 0
    after = np.searchsorted(samples, stamps).clip(0, len(samples) - 1)
    before = (after - 1).clip(0)
    nearest = np.where(np.abs(stamps - samples[before]) <= np.abs(samples[after] - stamps), before, after)
    distance = np.abs(samples[nearest] - stamps)
    order = np.lexsort((stamps, distance, nearest))
    first = np.ones(len(order), np.bool_)
    first[1:] = nearest[order][1:] != nearest[order][:-1]
    index = np.full(stamps.shape, -1, np.int64)
    winners = order[first & (distance[order] <= tolerance_ns)]
    index[winners] = nearest[winners]
    return index


class _TrackRows:
    """A track's rows while the file is read, in flat arrays."""

    def __init__(self) -> None:
        self._stamp, self._frame, self._numbers = array("q"), array("q"), array("d")
        self._texts: tuple[list[str], ...] = ([], [], [], [])

    def add(self, row: StateRow) -> None:
        self._stamp.append(row.stamp_ns)
        self._frame.append(row.frame_index)
        self._numbers.extend(row.numbers)
        for texts, text in zip(self._texts, (row.status, row.verdict, row.proposer, row.reasons), strict=True):
            texts.append(text)

    def track(self, name: str) -> Track:
        numbers = np.frombuffer(self._numbers, np.float64).reshape(-1, _Numbers.count)
        status, verdict, proposer, reasons = (np.array(texts, np.str_) for texts in self._texts)
        n = _Numbers
        square = (-1, 3, 3)
        return Track(
            marker=name,
            stamp_ns=np.frombuffer(self._stamp, np.int64),
            frame=np.frombuffer(self._frame, np.int64),
            status=status,
            verdict=verdict,
            proposer=proposer,
            reasons=reasons,
            circle_px=numbers[:, n.circle_px],
            circle_sd_px=numbers[:, n.circle_sd_px],
            claim_px=numbers[:, n.claim_px],
            xyz_cam_m=numbers[:, n.xyz_cam_m],
            covariance_m2=numbers[:, n.covariance_m2].reshape(square),
            velocity_cam_mps=numbers[:, n.velocity_cam_mps],
            smoothed_xyz_cam_m=numbers[:, n.smoothed_xyz_cam_m],
            smoothed_covariance_m2=numbers[:, n.smoothed_covariance_m2].reshape(square),
            smoothed_velocity_cam_mps=numbers[:, n.smoothed_velocity_cam_mps],
            vote_sum=numbers[:, n.vote_sum],
            visible=numbers[:, n.visible],
        )


class SensorRows:
    """A sensor's numbers while the file is read: every numeric leaf of its message, by its path."""

    def __init__(self, channel: Channel, records: McapRecords) -> None:
        decode = decoder(channel, records.schemas.get(channel.schema_id))
        if decode is None or channel.message_encoding != "protobuf":
            encoding = channel.message_encoding
            raise SourceError(f"{records.path}: {channel.topic} has encoding {encoding!r}, not protobuf")
        self.topic, self._decode = channel.topic, decode
        self._leaves: dict[str, tuple[str, ...]] | None = None
        self._stamp, self._own, self._numbers = array("q"), array("q"), array("d")

    def __len__(self) -> int:
        return len(self._stamp)

    def add(self, raw: RawMessage) -> None:
        """Raises UNREADABLE, and then has added nothing."""
        message = self._decode(raw.data)
        stamps = int64_ns(raw.log_time), int64_ns(raw.publish_time)
        if self._leaves is None:
            self._leaves = dict(_leaves(message))
        numbers = [_leaf(message, path) for path in self._leaves.values()]
        self._stamp.append(stamps[0])
        self._own.append(stamps[1])
        self._numbers.extend(numbers)

    def sensor(self) -> Sensor:
        leaves = list(self._leaves or ())
        numbers = np.frombuffer(self._numbers, np.float64).reshape(len(self._stamp), len(leaves))
        values = {name: numbers[:, i] for i, name in enumerate(leaves)}
        stamps, own = (np.frombuffer(a, np.int64) for a in (self._stamp, self._own))
        return Sensor(self.topic, stamps, own, values)


_NUMERIC = {
    FieldDescriptor.CPPTYPE_BOOL, FieldDescriptor.CPPTYPE_DOUBLE, FieldDescriptor.CPPTYPE_FLOAT,
    FieldDescriptor.CPPTYPE_INT32, FieldDescriptor.CPPTYPE_INT64, FieldDescriptor.CPPTYPE_UINT32,
    FieldDescriptor.CPPTYPE_UINT64,
}  # fmt: skip


def _leaves(message: Message, above: tuple[str, ...] = ()) -> Iterator[tuple[str, tuple[str, ...]]]:
    """(dotted name, path) of every single number in a message; the time stamp is left out."""
    for leaf in message.DESCRIPTOR.fields:
        path, value = (*above, leaf.name), getattr(message, leaf.name)
        if leaf.cpp_type in _NUMERIC and isinstance(value, int | float):  # a list when repeated
            yield ".".join(path), path
        elif (
            len(path) < _DEEPEST
            and hasattr(value, "DESCRIPTOR")
            and value.DESCRIPTOR.full_name != "google.protobuf.Timestamp"
        ):
            yield from _leaves(value, path)


def numbers_of(message: Message) -> dict[str, float]:
    """Every single number in a sensor's message by its path, `linear_acceleration.x`; NaN where it is not set."""
    return {name: _leaf(message, path) for name, path in _leaves(message)}


def _leaf(message: Message, path: tuple[str, ...]) -> float:
    for name in path[:-1]:
        if not message.HasField(name):
            return math.nan
        message = getattr(message, name)
    last = message.DESCRIPTOR.fields_by_name[path[-1]]
    if last.has_presence and not message.HasField(path[-1]):
        return math.nan
    return float(getattr(message, path[-1]))


def _take(values: npt.NDArray[Any], index: IntArray) -> npt.NDArray[Any]:
    """The rows at `index`, and NaN, "" or -1 where that is -1."""
    fill: Any = {"f": np.nan, "U": "", "i": -1}[values.dtype.kind]
    taken = np.full((len(index), *values.shape[1:]), fill, values.dtype)
    there = index >= 0
    taken[there] = values[index[there]]
    return taken


def _spread(pattern: str, axes: str, values: FloatArray) -> dict[str, FloatArray]:
    return {pattern.format(axis): values[:, i] for i, axis in enumerate(axes)}


def _deviations(covariance: FloatArray) -> FloatArray:
    return np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))


def _frame(columns: Mapping[str, npt.NDArray[Any]]) -> Any:
    try:
        pandas = importlib.import_module("pandas")
    except ImportError:
        raise UsageError("pandas is not installed: pip install pandas") from None
    return pandas.DataFrame(dict(columns))


def _xyr(circle: Message) -> tuple[float, float, float]:
    return circle.x_px, circle.y_px, circle.r_px


def _xyz(vector: Message) -> tuple[float, float, float]:
    return vector.x, vector.y, vector.z


def schema_names(records: McapRecords) -> dict[int, str]:
    """Schema name by channel id; "" for a channel without one."""
    return {
        channel.id: records.schemas[channel.schema_id].name if channel.schema_id in records.schemas else ""
        for channel in records.channels.values()
    }


_ROOT = re.compile(r"^/?(?P<root>.*?)/?(markers/[^/]+/state|requests)$")


def track_name(topic: str, marker: str) -> str:
    found = _ROOT.match(topic)
    return f"{found['root']}/{marker}" if found and found["root"] else marker


def senses(channel: Channel, schema: str) -> bool:
    """Whether a channel is a sensor's: one of our sample types, or any protobuf under /sensors/."""
    under = channel.topic.startswith("/sensors/")
    return schema in SENSORS or (under and channel.message_encoding == "protobuf" and schema != "")


def sensor_name(topic: str) -> str:
    return topic.removeprefix("/").removeprefix("sensors/")


def request_of(raw: RawMessage) -> OperatorRequest:
    """The content of a serialised spheremcap.OperatorRequest. Raises UNREADABLE."""
    message = _pb.OperatorRequest.FromString(raw.data)
    return OperatorRequest(
        marker=message.marker,
        frame_index=message.frame_index,
        stamp_ns=stamp_of(message.frame_timestamp),
        raised_at_frame_index=message.raised_at_frame_index,
        raised_stamp_ns=stamp_of(message.timestamp),
        reason=message.reason,
        reasons=tuple(message.reasons),
        answered=message.answered,
    )


def camera_in(message: Message, channel: Channel) -> Camera | None:
    """The camera of a CameraCalibration. Raises ValueError for what is none that we know."""
    fields = {field.name.lower(): getattr(message, field.name) for field in message.DESCRIPTOR.fields}
    return camera_of(fields, "the recording", focal_sd=focal_sd_of(channel.metadata))


def runs_of(records: McapRecords) -> dict[str, dict[str, str]]:
    runs: dict[str, dict[str, str]] = {}
    for record in records.metadata:
        for prefix in (RUN_METADATA, OUTCOME_METADATA):
            if record.name.startswith(prefix):
                runs.setdefault(record.name.removeprefix(prefix), {}).update(record.metadata)
    return runs


def damage_line(records: McapRecords) -> str | None:
    """One line about what could not be read so far; None when nothing was lost."""
    damage = records.damage()
    if not damage:
        return None
    more = f" (and {len(damage) - 1} more)" if len(damage) > 1 else ""
    return f"{records.path.name} is damaged: {damage[0]}{more}"


def int64_ns(stamp_ns: int) -> int:
    """The stamp, when it is one that int64 can hold, up to the year 2262. Raises ValueError."""
    if stamp_ns >= 1 << 63:
        raise ValueError(f"its time of {stamp_ns} ns is after 2262")
    return stamp_ns
