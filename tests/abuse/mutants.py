"""Damaged recordings and videos, made from whole ones by a seed; and every verb run on them in this process.

Some mutants are hurt in their bytes, some inside their records under right checksums, where a decoder meets them.
"""

import contextlib
import http.cookiejar
import io
import os
import random
import resource
import signal
import sys
import tempfile
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import typer.main
from mcap.reader import NonSeekingReader
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from spheremcap.cli import main

FAULT = "a fault of spheremcap's own"
SEED = ("--seed", "orange@0=100,90,18")
LATER_SEED = ("--seed", "orange@8=126,101,20")
PAGES = (
    "session", "pulse", "lanes", "states?first=0&last=99", "answers", "proposals", "picture/0", "picture/9?exact=1",
    "patch/3?x=60&y=60&width=80&height=80", "crop/15?x=100&y=90&half=40", "time?seconds=0.03",
)  # fmt: skip
"""What the page of `annotate` asks for, besides itself."""
typer.main.get_command = cache(typer.main.get_command)  # a process has one command line, and here it has thousands
EXTREMES = (0, 1, 0x7F, 0x80, 0xFF, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**62, 2**63 - 1, 2**63, 2**64 - 1)


# --- mutants ---


def hurt_bytes(data: bytes, rng: random.Random) -> bytes:
    """One to three faults of the kinds that disks, copies and people make."""
    hurt = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 3))):
        if not hurt:
            break
        at, length = rng.randrange(len(hurt)), min(len(hurt), rng.choice((1, 4, 16, 200, 4096)))
        kind = rng.randrange(8)
        if kind == 0:
            for _ in range(rng.randint(1, 20)):
                hurt[rng.randrange(len(hurt))] ^= 1 << rng.randrange(8)
        elif kind == 1:
            hurt[at : at + length] = rng.randbytes(length)
        elif kind == 2:
            hurt[at : at + length] = rng.choice((b"\0", b"\xff")) * length
        elif kind == 3:
            del hurt[at:]
        elif kind == 4:
            del hurt[at : at + length]
        elif kind == 5:
            hurt[at:at] = hurt[at : at + length]
        elif kind == 6:
            hurt[at:at] = rng.randbytes(length)
        else:
            size = rng.choice((1, 2, 4, 8))
            hurt[at : at + size] = (rng.choice(EXTREMES) % 256**size).to_bytes(size, rng.choice(("little", "big")))
    return bytes(hurt)


def hurt_records(data: bytes, rng: random.Random) -> bytes:
    """The recording written anew, every checksum right, with a few of its records changed inside."""
    reader = NonSeekingReader(io.BytesIO(data))
    messages = [(s, c, m) for s, c, m in reader.iter_messages(log_time_order=False)]
    share = rng.choice((0.02, 0.2, 1.0))
    text = lambda old: rng.choice((old, "", "x" * 300, old + "\n\x1b[31m", "foxglove.RawImage", "spheremcap.ImuSample"))  # noqa: E731
    what = rng.randrange(7)
    out = io.BytesIO()
    kinds = (CompressionType.ZSTD, CompressionType.LZ4, CompressionType.NONE)
    writer = Writer(out, chunk_size=rng.choice((500, 20_000, 1 << 20)), compression=rng.choice(kinds))
    writer.start("", "a mutant")
    schemas: dict[int, int] = {0: 0}
    channels: dict[int, int] = {}
    for schema, channel, message in messages:
        if schema is not None and schema.id not in schemas:
            hit = rng.random() < 0.5
            body = hurt_bytes(schema.data, rng) if what == 0 and hit else schema.data
            name = text(schema.name) if what == 1 and hit else schema.name
            schemas[schema.id] = writer.register_schema(name, schema.encoding, body)
        if channel.id not in channels:
            hit = rng.random() < 0.5
            topic = text(channel.topic) if what == 2 and hit else channel.topic
            encoding = (
                rng.choice(("json", "cdr", "ros1", "protobuf", "?")) if what == 3 and hit else channel.message_encoding
            )
            metadata = {"focal_sd": "nan"} if what == 2 and hit else channel.metadata
            channels[channel.id] = writer.register_channel(topic, encoding, schemas[channel.schema_id], metadata)
        times = [message.log_time, message.publish_time]
        body = message.data
        if rng.random() < share:
            if what in (4, 5):
                body = hurt_bytes(body, rng)
            elif what == 6:
                times[rng.randrange(2)] = rng.choice(EXTREMES)
        writer.add_message(channels[channel.id], times[0], body, times[1], message.sequence)
    writer.finish()
    return out.getvalue()


def mutant(path: Path, seed: int) -> bytes:
    """The mutant of a whole file by this seed."""
    rng, data = random.Random(f"{path.name} {seed}"), path.read_bytes()
    return hurt_records(data, rng) if path.suffix == ".mcap" and rng.random() < 0.5 else hurt_bytes(data, rng)


# --- running ---


@dataclass(frozen=True)
class Outcome:
    """What a verb did: exit code, stdout, stderr and seconds."""

    code: int
    out: str
    err: str
    seconds: float


class Visitor(io.StringIO):
    """The stdout of `annotate`, which looks at every page as soon as the address is there, and then ends it.

    An answer of 500 or above stands in it as an `FAULT`.
    """

    def write(self, text: str) -> int:
        written = super().write(text)
        if text.startswith("http://"):
            browser = urllib.request.build_opener(urllib.request.HTTPCookieProcessor(http.cookiejar.CookieJar()))
            try:
                for page in ("", *PAGES):
                    address = text.split("?")[0] + page if page else text.strip()
                    try:
                        browser.open(address, timeout=30).read()
                    except urllib.error.HTTPError as error:
                        if error.code >= 500:
                            super().write(f"{FAULT}: {page}: {error.code} {error.read()!r}\n")
            finally:
                os.kill(os.getpid(), signal.SIGINT)
        return written


def run(*arguments: object) -> Outcome:
    """The command line in this process."""
    out, err, before, began = Visitor(), io.StringIO(), sys.argv, time.monotonic()
    sys.argv = ["spheremcap", *map(str, arguments)]
    code = 0
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            main()
    except SystemExit as stop:
        code = stop.code if isinstance(stop.code, int) else 1
    finally:
        sys.argv = before
    return Outcome(code, out.getvalue(), err.getvalue(), time.monotonic() - began)


def verbs(path: Path, folder: Path, track: bool) -> Iterator[tuple[str, list[object]]]:
    """Each verb with its arguments for a mutant; outputs go into `folder`."""
    yield "info", ["info", path]
    yield "check", ["info", "--check", path]
    if path.suffix == ".mcap":
        yield "export", ["export", path, "-o", folder / "export.csv"]
        yield "sync", ["sync", path, "--marker", "orange", "--sensor", "imu"]
        yield "merge", ["merge", path, "-o", folder / "merge.mcap"]
        yield "recover", ["recover", path, "-o", folder / "recover.mcap"]
        yield "retrack", ["retrack", path, "-o", folder / "retrack.mcap", *LATER_SEED]
        truth = folder / "truth.csv"
        truth.write_text("frame,x,y,r\n0,100,90,18\n9,122,99,18\n")
        yield "evaluate", ["evaluate", path, "--truth", truth]
        if track:
            topic = ["--topic", "/front/image" if path.name == "log.mcap" else "/camera/video"]
            yield "track", ["track", path, "-o", folder / "track.mcap", *topic, *SEED]
    elif track:
        yield "track", ["track", path, "-o", folder / "track.mcap", *SEED]
    if track:
        yield "annotate", ["annotate", path, "--no-browser"]


@dataclass
class Tally:
    """What was seen over many mutants."""

    mutants: int = 0
    runs: dict[str, int] = field(default_factory=dict)
    codes: dict[int, int] = field(default_factory=dict)
    wrong: list[str] = field(default_factory=list)
    slowest_s: float = 0.0

    def note(self, name: str, outcome: Outcome) -> None:
        self.runs[name] = self.runs.get(name, 0) + 1
        self.codes[outcome.code] = self.codes.get(outcome.code, 0) + 1
        self.slowest_s = max(self.slowest_s, outcome.seconds)


def abuse(wholes: list[Path], seeds: range, *, track_every: int, tally: Tally, say: Callable[[str], None]) -> None:
    """Make each seed's mutant of one of the files, run all verbs on it, and note what must not be."""
    for seed in seeds:
        whole = wholes[seed % len(wholes)]
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place)
            path = folder / whole.name
            path.write_bytes(mutant(whole, seed))
            say(f"{seed} {whole.name}")
            tally.mutants += 1
            for name, arguments in verbs(path, folder, seed // len(wholes) % track_every == 0):
                outcome = run(*arguments)
                tally.note(name, outcome)
                for fault in faults(name, path, folder, outcome):
                    tally.wrong.append(f"seed {seed}, {name} {whole.name}: {fault}")


def faults(name: str, path: Path, folder: Path, outcome: Outcome) -> Iterator[str]:
    """What must not be: tracebacks, unknown exit codes, silence about errors, messages lost without a word."""
    said = outcome.err + outcome.out
    if FAULT in said or "Traceback" in said:
        lines = said.strip().splitlines()
        first = next(k for k, line in enumerate(lines) if FAULT in line or "Traceback" in line)
        yield " | ".join(lines[max(0, first - 1) : first + 12])
    if outcome.code not in (0, 1, 2, 3):
        yield f"exit code {outcome.code}"
    if outcome.code and not outcome.err.strip():
        yield f"exit code {outcome.code} without a word"
    if outcome.code in (1, 2) and len(outcome.err.strip().splitlines()) > 3:
        yield f"{len(outcome.err.splitlines())} lines for an error"
    if outcome.code == 2 and list(folder.glob("*.part")):
        yield "a usage error left a part file"
    if name in ("merge", "recover") and outcome.code == 0:
        merged, tolerant = int(outcome.out.split()[0]), tolerant_count(path)
        if merged < tolerant:
            yield f"{merged} messages written without a word, a tolerant reader gets {tolerant}"
    if name == "retrack" and outcome.code in (0, 3):
        for topic in ("/camera/video", "/sensors/imu"):  # which no answer changes
            kept, tolerant = tolerant_count(folder / "retrack.mcap", topic), tolerant_count(path, topic)
            if kept < tolerant:
                yield f"{kept} messages of {topic} kept, a tolerant reader gets {tolerant}"
    if name == "check" and path.suffix == ".mcap" and outcome.code == 0:
        try:
            with path.open("rb") as file:
                list(StreamReader(file, validate_crcs=True).records)
        except Exception as error:
            yield f"checked and found whole, but the reference reader says: {error!r}"


def tolerant_count(path: Path, topic: str | None = None) -> int:
    """Messages that the mcap package's stream reader gives before it fails, of all topics or of one."""
    count, channels = 0, set()
    with path.open("rb") as file, contextlib.suppress(Exception):
        for record in StreamReader(file).records:
            if isinstance(record, Channel) and record.topic == topic:
                channels.add(record.id)
            count += isinstance(record, Message) and (topic is None or record.channel_id in channels)
    return count


def peak_mb() -> float:
    """The most memory that this process has held, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


# --- whole files ---


def whole_files(folder: Path) -> list[Path]:
    """Videos of three kinds, a recording of somebody's pictures, and one of ours with a sensor in it."""
    import media

    from clips import write_clip, write_recording

    files = [write_clip(folder / "clip.mp4"), write_recording(folder / "log.mcap", ["/front/image"])]
    files.append(media.video(folder / "clip.mkv", 10, size=(320, 240), options={"bf": "2", "g": "5"}))
    mjpeg = folder / "mjpeg.avi"
    files.append(media.video(mjpeg, 6, codec="mjpeg", pixel_format="yuvj420p", full_range=True, size=(320, 240)))
    files.append(media.video(folder / "bare.h264", 8, size=(320, 240), options={"bf": "0"}))
    imu = folder / "imu.csv"
    rows = ["t (s),acc_x (g),acc_y (g),acc_z (g)"]
    rows += [f"{1748772000 + i / 200:.3f},{i % 7},{i % 5},1" for i in range(100)]
    imu.write_text("\n".join(rows) + "\n")
    tracked = folder / "tracked.mcap"
    settings = folder / "settings.toml"  # a camera without a path, which would be another in each folder
    settings.write_text("[camera]\nwidth_px=320\nheight_px=240\nfx_px=550\nfy_px=550\ncx_px=159.5\ncy_px=119.5\n")
    assert run("track", files[0], "-o", tracked, *SEED, "-s", settings).code == 0
    ours = folder / "ours.mcap"
    merged = run("merge", tracked, imu, "-o", ours)
    assert merged.code == 0, merged.err
    tracked.unlink()
    imu.unlink()
    settings.unlink()
    return [*files, ours]
