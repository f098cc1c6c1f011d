"""Sessions of a season as `dataset run` leaves them, without running any."""

import random
from collections.abc import Mapping
from pathlib import Path

from spheremcap.season.manifest import Plan, Season
from spheremcap.season.outcome import (
    RECORDING,
    TABLES,
    Asked,
    ClockOutcome,
    MarkerOutcome,
    Outcome,
    write_outcome,
    write_season,
)
from spheremcap.season.tables import write_session_tables

START_NS = 1_750_000_000_000_000_000
WRISTS = ("left_wrist", "right_wrist")


def marker(name: str, measured: int, frames: int = 1000, gap_s: float = 0.1) -> MarkerOutcome:
    return MarkerOutcome(
        marker=name, frames=frames, frames_by_status={"VERIFIED": measured, "LOST": frames - measured},
        measured=measured, longest_gap_frames=round(240 * gap_s), longest_gap_s=gap_s,
    )  # fmt: skip


def asked(name: str, frame: int, answered: str = "") -> Asked:
    return Asked(
        marker=name, frame=frame, stamp_ns=START_NS, raised_at_frame=frame + 5, reason="lost", answered=answered
    )


def clock(sensor: str, residual_ms: float | None = None, **more) -> ClockOutcome:
    known = {"samples": 900, "first_ns": START_NS, "last_ns": START_NS + 10**9, "added": "+5 ms"}
    synced = {} if residual_ms is None else {"error_ms": residual_ms / 5, "windows": "11 of 12", "drift_ppm": 12.5}
    return ClockOutcome(sensor=sensor, residual_ms=residual_ms, **(known | synced | more))


def outcome(name: str, status: str = "done", **more) -> Outcome:
    """A session that went well, unless said otherwise."""
    known = {
        "subject": "S1", "key": f"key of {name}", "version": "0.1.0", "videos": (f"/data/{name}/run.mp4",),
        "seeds": "/data/seeds.toml",
    }  # fmt: skip
    done = {
        "frames": 1000, "start_ns": START_NS, "duration_s": 4.2,
        "markers": tuple(marker(wrist, 990) for wrist in WRISTS), "clocks": (clock("wheel", 0.4),),
        "strokes": {"left": 8, "right": 7},
    }  # fmt: skip
    return Outcome(session=name, status=status, **((known if status == "failed" else known | done) | more))


def plan(name: str, **more) -> Plan:
    return Plan(name=name, **({"videos": (f"/data/{name}/run.mp4",), "seeds": "/data/seeds.toml"} | more))


def season(*names: str, **more) -> Season:
    return Season(**({"name": "2026", "plans": tuple(plan(name) for name in sorted(names))} | more))


def write_season_of(
    out: Path, outcomes: Mapping[str, Outcome | None], recording: Path, own: Mapping[str, Path] | None = None, **more
) -> Path:  # fmt: skip
    """`out` as `dataset run` leaves it, each session's recording `recording`, if not its own; None was not run."""
    out.mkdir(parents=True)
    for name, one in outcomes.items():
        if one is not None:
            write_session(out / name, one, (own or {}).get(name, recording))
    write_season(out, season(*outcomes, **more))
    return out


def write_session(folder: Path, one: Outcome, recording: Path) -> None:
    folder.mkdir(parents=True)
    if one.status != "failed":
        (folder / RECORDING).write_bytes(recording.read_bytes())
        (folder / TABLES).mkdir()
        write_session_tables(recording, folder / TABLES, one)
    write_outcome(folder, one)


def many(count: int, seed: int = 0) -> dict[str, Outcome | None]:
    """Sessions of which some went wrong in all the ways that there are, alike each time."""
    rng = random.Random(seed)
    found: dict[str, Outcome | None] = {}
    for k in range(count):
        name = f"2026-{1 + k // 28 % 12:02d}-{1 + k % 28:02d}_athlete{k % 23:02d}_run{k}"
        fate, shares = rng.random(), [min(1.0, rng.gauss(0.975, 0.015)) for _ in WRISTS]
        if fate < 0.03:
            found[name] = None
            continue
        if fate < 0.06:
            reason = rng.choice(
                [
                    f"/data/{name}/run.mp4: not a video: moov atom not found",
                    "no seeds: there is no /data/seeds.toml: give circles (spheremcap annotate /data/run.mp4), or auto",
                    "out of memory: it needed more than its memory_gb = 8; give it more, or run fewer at once",
                ]
            )
            found[name] = outcome(name, "failed", reason=reason, subject=f"S{k % 23:02d}")
            continue
        if fate < 0.09:
            shares = [rng.uniform(0.2, 0.9), shares[1]]
        lost: tuple[str, ...] = ()
        if fate > 0.85:
            undecodable = f"{rng.randint(1, 40)} frames could not be decoded"
            lost = (rng.choice([undecodable, "sensor imu is left out: no span"]),)
        if fate > 0.98:
            lost += ("left_wrist was lost at the end",)
        residual = max(0.05, rng.gauss(0.4, 0.08)) if fate < 0.97 else rng.uniform(2, 9)
        questions = tuple(
            asked(rng.choice(WRISTS), rng.randint(1, 900), rng.choice(["", "", "circle at 9"]))
            for _ in range(max(0, int(rng.gauss(0, 3))))
        )
        found[name] = outcome(
            name, "lost" if lost else "done", lost=lost, subject=f"S{k % 23:02d}", requests=questions,
            markers=tuple(
                marker(wrist, round(1000 * share), gap_s=round(0.02 + (1 - share) * 4, 3))
                for wrist, share in zip(WRISTS, shares, strict=True)
            ),
            clocks=(clock("wheel", residual), clock("imu")), start_ns=START_NS + k * 10**13,
            duration_s=rng.uniform(30, 1800), strokes={"left": rng.randint(50, 900), "right": rng.randint(50, 900)},
        )  # fmt: skip
    return found
