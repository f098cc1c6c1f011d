"""Runs that are killed, told to end, or run out of disk: is what they had written there, once, and the old file whole?

usage: python benchmarks/abuse/kills.py [--kills 100] [--ends 50] [--full 20] [--seed 1]

`kill -9`, then SIGTERM, SIGHUP and SIGINT, at random moments of `track` (a video, and a recording that is copied),
`merge`, `export`, `recover` and `retrack`, each with an output that exists already; disks that are full at so many
places (a small tmpfs where it can be mounted, else a limit on the size of files); and a table that is interrupted. Each
run is a process of its own, forked from this one, which has imported and compiled everything and has no other thread.
What is there afterwards is read with the mcap package's stream reader and held against the same run left alone: its
first messages, none missing, none twice, none changed, up to the last half second of log time that the run had come to,
and of what was tracked all but a second.
"""

import argparse
import importlib
import mmap
import os
import random
import resource
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, Writer

from spheremcap.__main__ import main as command_line
from spheremcap.core.circle import Circle
from spheremcap.core.estimate import FrameResult, MarkerEstimate, Status
from spheremcap.core.frame import Frame
from spheremcap.core.marker import MarkerSpec
from spheremcap.core.time import NS_PER_S
from spheremcap.io.encode import write_video
from spheremcap.io.export import tables
from spheremcap.io.mcap_log import McapLog
from spheremcap.io.mcap_records import Piece
from spheremcap.io.output import SharedWriter
from spheremcap.io.rewrite import ChunkWriter
from spheremcap.session import Session

for name in ("api", "cli", "io.recover", "merging.dataset"):  # before the runs are forked off
    importlib.import_module(f"spheremcap.{name}")

cv2.setNumThreads(1)  # threads do not come along into a fork
RATE_HZ = 25
LONGEST_S = 60
_HALF_NS = NS_PER_S // 2
_LONGEST_LOSS_NS = NS_PER_S + 3 * NS_PER_S // RATE_HZ  # and what is under way between threads
OLD = b"what was there before\n" * 1000
Row = tuple[int, int, int, bytes]


def picture(index: int) -> np.ndarray:
    """A green ball that goes round, on noise: 320 x 240 BGR."""
    noise = np.random.default_rng(index).integers(60, 100, (240, 320, 3), np.uint8)
    centre = (round((160 + 60 * np.cos(index / 15)) * 16), round((120 + 40 * np.sin(index / 15)) * 16))
    return cv2.GaussianBlur(cv2.circle(noise, centre, 18 * 16, (60, 190, 70), -1, cv2.LINE_AA, 4), (0, 0), 0.6)


@dataclass
class Job:
    """A command line, and what it writes when it is left alone."""

    name: str
    words: list[str]
    output: str
    rows: list[Row] = field(default_factory=list)
    whole: bytes = b""
    seconds: float = 0.0


@dataclass
class Ending:
    """How a run ended: exit code (below 0: the signal), the last log time that it had added, the stamp of the last
    frame that it had tracked (0: none), what it said."""

    code: int
    reached_ns: int
    tracked_ns: int
    said: str


def prepare(folder: Path, seconds: int) -> list[Job]:
    """The inputs, and each job done once without being disturbed."""
    names = ("clip.mp4", "tracked.mcap", "big.mcap", "long.mcap", "wheel.csv")
    clip, tracked, big, long, sensor = (folder / name for name in names)
    write_video(clip, (picture(k) for k in range(seconds * RATE_HZ)), Fraction(RATE_HZ),
                creation_time="2025-06-01T10:00:00Z")  # fmt: skip
    start = 1_748_772_000 * NS_PER_S
    sensor.write_text("time (s),angle (deg)\n" + "".join(f"{k / 100},{k % 360}\n" for k in range(seconds * 100)))
    noise = np.random.default_rng(1).bytes(3000)
    with big.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start()
        channels = [writer.register_channel(f"/sensor/{k}", "x", 0) for k in range(3)]
        for k in range(seconds * 600):
            data = noise[k % 1000 : k % 1000 + 1500] + k.to_bytes(4, "little")
            stamp = start + k * NS_PER_S // 600
            writer.add_message(channels[k % 3], stamp, data, stamp, k)
        writer.finish()  # type: ignore[no-untyped-call]
    with McapLog(long, camera=None, markers=[MarkerSpec("ball")]) as log:
        for k in range(seconds * 1000):
            stamp = start + k * NS_PER_S // 240
            seen = MarkerEstimate("ball", k, stamp, Status.VERIFIED, Circle(k % 300 / 7, 100.0, 18.0))
            log.write(FrameResult(k, stamp, (seen,)), None)
    seed = ["--seed", "ball@0=220,120,18"]
    jobs = [
        Job("track", ["track", str(clip), *seed], "tracked.mcap"),
        Job("track a recording", ["track", str(tracked), *seed, "--topic", "/camera/video"], "again.mcap"),
        Job("merge", ["merge", str(tracked), str(big), str(sensor)], "merged.mcap"),
        Job("recover", ["recover", str(big)], "recovered.mcap"),
        Job("retrack", ["retrack", str(tracked), "--seed", "ball@40=107,138,18"], "corrected.mcap"),
        Job("export", ["export", str(long)], "tracks.csv"),
    ]
    for job in jobs:
        started = time.monotonic()
        out = folder / job.output
        ending = run([*job.words, "-o", str(out)])
        job.seconds = time.monotonic() - started
        if ending.code not in (0, 3):
            raise SystemExit(f"{job.name}: {ending}")
        job.whole = out.read_bytes()
        job.rows = messages(out)[0]
    return jobs


def run(
    words: list[str], before: Callable[[], None] = lambda: None, disturb: Callable[[int, mmap.mmap], None] | None = None
) -> Ending:
    """The command line in a process of its own. `before` is called in it; `disturb` here, with its number and where the
    last log time that it has added can be read.
    """
    shared, (said, pipe) = mmap.mmap(-1, 16), os.pipe()
    pid = os.fork()
    if pid == 0:
        _child(words, before, shared, pipe)
    os.close(pipe)
    if disturb is not None:
        disturb(pid, shared)
    with os.fdopen(said, "rb") as file:
        text = file.read().decode(errors="replace")
    code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    assert code != -signal.SIGALRM, f"{words}: hangs"
    return Ending(code, *struct.unpack("<QQ", shared), text)


def _child(words: list[str], before: Callable[[], None], shared: mmap.mmap, pipe: int) -> None:
    code = 99
    signal.alarm(LONGEST_S)
    try:
        os.dup2(pipe, 1)
        os.dup2(pipe, 2)
        sys.stdout, sys.stderr = os.fdopen(1, "w"), os.fdopen(2, "w")
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_DFL)
        add = SharedWriter.add_message

        def noted(self: SharedWriter, channel_id: int, log_time: int, *rest: object) -> None:
            add(self, channel_id, log_time, *rest)  # type: ignore[arg-type]
            struct.pack_into("<Q", shared, 0, log_time)

        SharedWriter.add_message = noted  # type: ignore[assignment, method-assign]
        copy = ChunkWriter.copy

        def copied(self: ChunkWriter, piece: Piece, *rest: object) -> None:
            copy(self, piece, *rest)  # type: ignore[arg-type]
            struct.pack_into("<Q", shared, 0, piece.end)

        ChunkWriter.copy = copied  # type: ignore[method-assign]
        take = Session.take

        def taken(self: Session, frame: Frame, *rest: object) -> FrameResult:
            result = take(self, frame, *rest)  # type: ignore[arg-type]
            struct.pack_into("<Q", shared, 8, frame.stamp_ns)
            return result

        if words[0] == "track":  # what retrack tracks again is not what it writes next
            Session.take = taken  # type: ignore[assignment, method-assign]
        before()
        sys.argv = ["spheremcap", *words]
        command_line()
        code = 0
    except SystemExit as error:
        code = error.code if isinstance(error.code, int) else 1
    except BaseException:
        traceback.print_exc()
    finally:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        os._exit(code)


def messages(path: Path) -> tuple[list[Row], bool]:
    """What the stream reader gives of a file in its order, and whether it came to the end of it."""
    found: list[Row] = []
    with path.open("rb") as file:
        try:
            for record in StreamReader(file, emit_chunks=True, validate_crcs=True).records:
                inside = breakup_chunk(record, validate_crc=True) if isinstance(record, Chunk) else [record]
                found += [(m.channel_id, m.log_time, m.sequence, m.data) for m in inside if isinstance(m, Message)]
        except Exception:
            return found, False
    return found, True


def checked(job: Job, folder: Path, ending: Ending, killed: bool) -> str:
    """What the run left, in a word. Raises AssertionError when something is lost, twice, changed or not said."""
    out = folder / job.output
    parts = sorted(folder.glob(f"{job.output}*.part"))
    assert len(parts) <= 1, parts
    assert "Traceback" not in ending.said, ending.said
    content = out.read_bytes()
    if content == job.whole:
        assert not parts or killed  # killed between the two names, where there is no overwriting
        assert killed or ending.code in (0, 1, 3), ending
        return "whole"
    assert content == OLD, f"{job.name}: the old output is gone"
    starting = ending.code < 0 and not (ending.said or ending.reached_ns or parts)  # Python itself, on a busy machine
    if not killed and not starting:
        assert ending.code == 1, ending
        assert ending.said.count("\n") >= 1, ending
    half_s = ending.reached_ns // _HALF_NS
    there = sum(row[1] // _HALF_NS < half_s for row in job.rows)
    if not parts:
        assert there == 0, ending
        return "nothing written"
    if not job.rows:  # a table
        assert killed, ending
        return "part of a table"
    rows, ended = messages(parts[0])
    if not killed:
        assert rows, ending
        assert str(parts[0]) in ending.said, ending
    if "stopped after" in ending.said:  # in order: what is copied may have come further than what is tracked
        for channel in {row[0] for row in rows}:
            own, all_ = ([row for row in some if row[0] == channel] for some in (rows, job.rows))
            assert own == all_[: len(own)], f"{job.name}: not the first messages of channel {channel}, each once"
        return "part, ended"
    assert rows == job.rows[: len(rows)], f"{job.name}: not the first messages, each once"
    assert len(rows) >= there, f"{job.name}: {there - len(rows)} of {there} messages of full half seconds are lost"
    late_ns = ending.tracked_ns - rows[-1][1] if rows else 0
    assert not killed or late_ns <= _LONGEST_LOSS_NS, f"{job.name}: {late_ns} ns of what was tracked are lost"
    return "part, ended" if ended else "part, cut off"


@contextmanager
def old_output(job: Job, folder: Path) -> Iterator[list[str]]:
    """The job's command line in a folder where its output exists."""
    (folder / job.output).write_bytes(OLD)
    yield [*job.words, "-o", str(folder / job.output), "--overwrite"]
    for path in folder.glob(f"*{job.output}*"):
        path.unlink()
    for path in folder.glob(".*.part"):
        path.unlink()


def _signal(job: Job, number: int, after: float, by_time: bool, pid: int, shared: mmap.mmap) -> None:
    """A signal after that share of the run's time, or of the log times that it writes (starting takes most of some)."""
    if by_time:
        time.sleep(after * job.seconds)
    else:
        first, last = job.rows[0][1], max(row[1] for row in job.rows)
        while struct.unpack_from("<Q", shared)[0] < first + after * (last - first):
            time.sleep(0.0005)
            if os.waitid(os.P_PID, pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None:
                return
    os.kill(pid, number)


Left = Counter[tuple[str, str]]


def disturbed(jobs: list[Job], folder: Path, count: int, numbers: list[int], chance: random.Random) -> Left:
    """So many runs, each with a signal at a random moment; what they left, by job."""
    left = Left()
    for k in range(count):
        job, number, after = jobs[k % len(jobs)], chance.choice(numbers), chance.random()
        by_time = k // len(jobs) % 2 == 0 or not job.rows
        with old_output(job, folder) as words:
            ending = run(words, disturb=partial(_signal, job, number, after, by_time))
            try:
                left[job.name, checked(job, folder, ending, number == signal.SIGKILL)] += 1
            except AssertionError as error:
                raise AssertionError(f"run {k}, {job.name}, signal {number} at {after:.4f}: {error}") from error
    return left


def full_disks(jobs: list[Job], folder: Path, places: int) -> tuple[str, Left]:
    """Each job on disks that are full at so many places of its output; how it was done, and what was left."""
    left = Left()
    disk = folder / "disk"
    disk.mkdir(exist_ok=True)
    how = "a limit on the size of files"
    for k in range(places):
        job = jobs[k % len(jobs)]
        room = len(OLD) + int(len(job.whole) * (k + 0.5) / places)
        mount = ["mount", "-t", "tmpfs", "-o", f"size={max(room, 8192)}", "tmpfs", str(disk)]
        mounted = os.geteuid() == 0 and subprocess.run(mount, capture_output=True, check=False).returncode == 0
        how = "a small tmpfs" if mounted else how
        try:
            with old_output(job, disk) as words:
                ending = run(words, before=partial(_limit, None if mounted else room - len(OLD)))
                found = checked(job, disk, ending, killed=False)
                assert found == "whole" or ending.said.count("free some space") == 1, ending
                left[job.name, found] += 1
        finally:
            if mounted:
                subprocess.run(["umount", str(disk)], check=True)
    shutil.rmtree(disk)
    return how, left


def interrupted_table(jobs: list[Job], folder: Path) -> str:
    """What an export leaves that is told to end once the first rows of its table are written."""
    job = next(job for job in jobs if job.name == "export")

    def before() -> None:
        write = tables.write_csv

        def signalled(rest: Iterator[Any]) -> Iterator[Any]:
            os.kill(os.getpid(), signal.SIGTERM)
            yield from rest

        tables.write_csv = lambda path, first, rest, start_ns: write(path, first, signalled(rest), start_ns)

    with old_output(job, folder) as words:
        ending = run(words, before)
        assert (ending.code, ending.said) == (1, "spheremcap: interrupted\n"), ending
        return checked(job, folder, ending, killed=False)


def _limit(size: int | None) -> None:
    if size is not None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))


def table(title: str, left: Left) -> str:
    """What was left, a line for each job."""
    kinds = sorted({kind for _, kind in left})
    lines = [f"\n{title}", f"{'':20s}" + "".join(f"{kind:>18s}" for kind in kinds)]
    for job in dict.fromkeys(name for name, _ in left):
        lines.append(f"{job:20s}" + "".join(f"{left[job, kind]:18d}" for kind in kinds))
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in (("kills", 100), ("ends", 50), ("full", 20), ("seed", 1), ("seconds", 12)):
        parser.add_argument(f"--{name}", type=int, default=default)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        jobs = prepare(folder, given.seconds)
        for job in jobs:
            print(f"{job.name}: {len(job.rows)} messages, {len(job.whole)} bytes, {job.seconds:.2f} s")
        work = folder / "work"
        work.mkdir()
        print(f"seed {given.seed}")
        left = disturbed(jobs, work, given.kills, [signal.SIGKILL], random.Random(given.seed))
        print(table(f"{given.kills} times kill -9", left), flush=True)
        ends = [signal.SIGTERM, signal.SIGTERM, signal.SIGHUP, signal.SIGINT]
        left = disturbed(jobs, work, given.ends, list(ends), random.Random(given.seed + 1))
        print(table(f"{given.ends} times SIGTERM, SIGHUP or SIGINT", left), flush=True)
        how, left = full_disks(jobs, work, given.full)
        print(table(f"{given.full} full disks ({how})", left))
        print(f"\nan export that is told to end after its first rows: {interrupted_table(jobs, work)}")
    print("\neverything that had been written is there, once; no old output was touched; no traceback")


if __name__ == "__main__":
    main()
