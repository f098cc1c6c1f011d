"""Where a sensor that counts from zero is put, and the clock that a line over the reference's time means."""

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from spheremcap.merging import sync
from spheremcap.merging.dataset import Source, merge
from spheremcap.merging.sync import Signal, SyncConfig, synchronise

START_NS = 1_700_000_000 * 10**9


def recording(path: Path, start_ns: int, count: int = 3) -> Path:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="", library="another tool")
        channel = writer.register_channel("/in", "json", writer.register_schema("thing", "jsonschema", b"{}"))
        for k in range(count):
            writer.add_message(channel, start_ns + k * 10**9, b"{}", start_ns)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def table(path: Path, first_s: float) -> Path:
    rows = [f"{first_s + 0.5 * k},{k}" for k in range(4)]
    path.write_text("\n".join(["time_s,load", *rows]) + "\n")
    return path


def log_times(path: Path, topic: str) -> list[int]:
    with path.open("rb") as file:
        return [m.log_time for _, c, m in make_reader(file).iter_messages() if topic in c.topic]


@pytest.mark.parametrize("first_s", [0.0, 2.25])
@pytest.mark.parametrize("offset_ns", [0, -250_000_000])
def test_a_sensors_zero_is_the_start_of_the_earliest_recording_and_its_times_keep_their_distance_from_it(
    first_s: float, offset_ns: int, tmp_path: Path
) -> None:
    sources = [
        Source(recording(tmp_path / "late.mcap", START_NS + 2 * 10**9)),
        Source(recording(tmp_path / "early.mcap", START_NS)),
        Source(table(tmp_path / "crank.csv", first_s), offset_ns=offset_ns),
    ]
    dataset = merge(sources, tmp_path / "out.mcap")
    times = log_times(tmp_path / "out.mcap", "crank")
    assert times == [START_NS + round(first_s * 10**9) + offset_ns + k * 500_000_000 for k in range(4)]
    (line,) = (note for note in dataset.notes if note.startswith("crank: "))
    assert "4 samples at 2 Hz" in line
    assert "column 1 (time_s) in s" in line
    assert "2023-11-14T22:13:20.000000000Z, as its zero is taken for the start of early" in line
    assert ("-250ms (offset)" in line) == bool(offset_ns)


def test_a_sensor_with_a_true_clock_is_left_where_it_is(tmp_path: Path) -> None:
    table(tmp_path / "crank.csv", START_NS / 1e9 + 1)
    sources = [Source(recording(tmp_path / "in.mcap", START_NS)), Source(tmp_path / "crank.csv")]
    dataset = merge(sources, tmp_path / "out.mcap")
    assert log_times(tmp_path / "out.mcap", "crank")[0] == START_NS + 10**9
    assert any(note.startswith("crank: ") and note.endswith("added: nothing") for note in dataset.notes)


@dataclass
class Line:
    """The estimate replaced by the answer: the sensor lags by `lag` s in the middle, and by `drift` more a second."""

    lag: float
    drift: float
    middle: float = 18_000.0
    error: float = 0.0

    def __post_init__(self) -> None:
        self.times, self.lags = np.zeros(8), np.zeros(8)
        self.residuals, self.correlations, self.agreed = np.zeros(8), np.ones(8), np.ones(8, bool)

    def coarse(self) -> tuple[float, float, float]:
        return self.lag, self.drift, 100.0

    def refine(self, lag: float, drift: float) -> tuple[float, None]:
        return lag, None

    def line(self, *given: object) -> "Line":
        return self


@pytest.mark.parametrize("drift", [300e-6, -300e-6])
def test_the_clock_maps_each_sensor_stamp_to_where_the_line_says_it_was_seen(
    drift: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """t_ref = t + lag(t_ref), over ten hours to a microsecond: the sensor's own drift is not that of the line."""
    line = Line(2.5, drift)
    monkeypatch.setattr(sync, "_Pair", lambda *given: line)
    hours = np.arange(0, 36_000, 600) * 10**9
    reference = Signal(START_NS + hours, np.ones((len(hours), 1)))
    sensor = Signal(START_NS + hours, np.ones((len(hours), 1)))
    clock = synchronise(reference, sensor, config=SyncConfig()).clock
    for stamp in sensor.stamp_ns.tolist():
        t = (stamp - START_NS) / 1e9
        t_ref = (clock(stamp) - START_NS) / 1e9
        assert t_ref == pytest.approx(t + line.lag + line.drift * (t_ref - line.middle), abs=1e-6)
    assert abs(clock.drift) < Fraction(1, 1000)
