"""The pictures that a run was tracked on, wherever they are now."""

from collections import Counter
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from copy import copy
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import cast

from spheremcap.core.frame import Frame
from spheremcap.corrections.run import Run
from spheremcap.errors import SourceError, UsageError
from spheremcap.io.mcap_images import TimeBase
from spheremcap.io.mcap_records import McapRecords
from spheremcap.io.pictures import Pictures, open_pictures, recorded_pictures
from spheremcap.io.sources import files_of, fingerprint

_HELD_PICTURES, _HELD_BYTES = 24, 24 << 20
"""Decoded pictures that are kept, for going backwards: so many, or as many as that takes: 17 of 1280x720."""


class Footage:
    """The frames that a run was tracked on, by its own indices and stamps. `note` says where they are not the same.

    Without `source` the recording's own pictures are taken where they are those of the input, else the input beside
    it, else the recording's own after all. Raises SourceError where there are none, UsageError for another input.
    """

    def __init__(self, run: Run, records: McapRecords, source: Path | None, checked: bool, files: ExitStack) -> None:
        self._states = run.states
        self._shift_ns: int | None = None
        self._right: Future[None] | None = None
        self.note = ""
        self.pictures: Pictures
        own = _own_pictures(run, records)
        beside = records.path.parent / run.facts.get("input_name", "")
        if source is None and own is not None and own.exact:
            self.pictures = _recorded(records, own)
            return
        path = source or beside
        if source is None and not _fits(path, run.facts):
            if own is None:
                raise SourceError(
                    f"{records.path}: the pictures that it was tracked on are needed: put {beside.name} beside it, or "
                    "say with --source where it is"
                )
            self.note = (
                f"tracked on the recording's own pictures, which were encoded once: {beside.name} is not beside it"
            )
            self.pictures = _recorded(records, own)
            return
        if not checked:
            if not _fits(path, run.facts):
                raise UsageError(f"{path}: is not what {records.path} was tracked on: another size, or not there")
            pool = files.enter_context(ThreadPoolExecutor(1, "hash"))
            self._right = pool.submit(_compare_hash, path, run.facts, records.path)
        rate = run.facts.get("rate")
        topic, time = run.facts.get("image_topic"), cast(TimeBase, run.facts.get("image_time", "header"))
        self.pictures = files.enter_context(
            open_pictures(path, topic=topic, time=time, rate=None if rate is None else Fraction(rate))
        )
        _hold_few(self.pictures)

    @property
    def path(self) -> Path:
        return self.pictures.path

    def at(self, index: int) -> Frame | None:
        """The frame of that index with the stamp that the recording has; None where it cannot be decoded."""
        if not self.pictures.first_index <= index < self.pictures.count:
            return None
        frame = self.pictures.frame(index)
        if frame is None:
            return None
        if self._shift_ns is None:
            states = self._states
            self._shift_ns = states.stamp_ns(states.count - 1) - self.pictures.stamp_ns(states.last_index)
        if self._shift_ns:
            frame = copy(frame)
            frame.stamp_ns += self._shift_ns
        return frame

    def confirm(self) -> None:
        """Wait until the input is known to be the very one. Raises UsageError where it is not."""
        if self._right is not None:
            self._right.result()


@dataclass(frozen=True)
class _Own:
    """The recording's own pictures, and whether they are those of the input, to the pixel and by the same numbers."""

    topic: str
    time: TimeBase
    exact: bool


def _recorded(records: McapRecords, own: _Own) -> Pictures:
    pictures = recorded_pictures(records, own.topic, own.time)
    _hold_few(pictures)
    return pictures


def _hold_few(pictures: Pictures) -> None:
    size = pictures.width_px * pictures.height_px * 3 // 2
    pictures.held_bytes = min(_HELD_BYTES, _HELD_PICTURES * size)


def _own_pictures(run: Run, records: McapRecords) -> _Own | None:
    counts: Counter[str] = Counter()
    for channel in records.channels.values():
        counts[channel.topic] += records.counts.get(channel.id, 0)
    topic = run.facts.get("image_topic", "")
    if counts[topic]:
        return _Own(topic, cast(TimeBase, run.facts.get("image_time", "header")), True)
    for topic in (run.topics.video, run.topics.image):
        if counts[topic] == run.states.last_index + 1:  # none was lost, so messages go by the frames' numbers
            return _Own(topic, "header", run.facts.get("video", "").startswith("video passed through"))
    return None


def _fits(path: Path, facts: Mapping[str, str]) -> bool:
    """Whether a file or folder of the input's name and size is there."""
    try:
        if path.is_dir():
            return bool(facts.get("rate"))
        return path.is_file() and str(sum(p.stat().st_size for p in files_of(path))) == facts.get("input_size")
    except (OSError, SourceError):
        return False


def _compare_hash(path: Path, facts: Mapping[str, str], recording: Path) -> None:
    if fingerprint(path)[1] != facts.get("input_sha256"):
        raise UsageError(f"{path}: is not what {recording} was tracked on: its content is another")
