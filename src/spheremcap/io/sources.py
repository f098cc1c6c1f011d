"""What is tracked: a video, a folder of pictures, or image topics of a recording with what is copied of it."""

import hashlib
import itertools
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Literal

from spheremcap.core.time import LARGEST_RELATIVE_NS, NS_PER_S
from spheremcap.errors import UsageError
from spheremcap.io.chapters import Chapters, chapters_in, is_list
from spheremcap.io.folder import PictureFolder
from spheremcap.io.input_file import is_recording as is_recording
from spheremcap.io.join import McapStream
from spheremcap.io.mcap_images import McapImageSource, TimeBase, image_topics
from spheremcap.io.mcap_records import McapRecords
from spheremcap.io.source import Source
from spheremcap.io.topics import LOG, MARKERS, OVERVIEW, REQUESTS, SCENE, TRANSFORMS, Topics, TopicsBeside
from spheremcap.io.video import VideoSource

Copy = Literal["all", "images", "none"]
FAR_APART_NS = 10_000_000_000
"""Header stamps this far from the log times are on another clock."""


@dataclass(frozen=True)
class FromMcap:
    """Which pictures of a recording are tracked, by which of its times, and what the output takes over.

    `topics` are the image topics, one camera each; none takes the only one there is. `start_ns` and `end_ns`
    are in that time; below 10^17 (1973) they count from the first picture. `copy` says what of the input
    comes into the output, byte for byte: everything, the tracked pictures with their calibration, or nothing.
    """

    topics: tuple[str, ...] = ()
    time: TimeBase = "header"
    start_ns: int | None = None
    end_ns: int | None = None
    copy: Copy = "all"


@dataclass(frozen=True)
class CameraView:
    """One camera of the input. `name` goes before its markers' topics when there are several cameras.

    `taken` are the topics that come into the output from the input. `notes` are for the user. `live` is what does not
    wait for whoever is slower.
    """

    source: Source
    name: str = ""
    taken: frozenset[str] = frozenset()
    notes: tuple[str, ...] = ()
    live: bool = False

    def lost(self) -> list[str]:
        """What could not be read, one line each that names the file, once the pictures have been."""
        return _named(self.source.path, self.source.lost.lines() if self.source.lost else [])

    @property
    def copied(self) -> bool:
        """Whether the output has the pictures anyway."""
        return self.source.topic in self.taken

    @property
    def calibrated(self) -> bool:
        """Whether the output has the calibration anyway."""
        return self.source.calibration_topic in self.taken

    def topics(self, *, pictures: Literal["video", "image"] | None, calibration: bool) -> Topics:
        """Names for our channels that the input has not taken; beside the input's pictures where those are
        copied, so that viewers pair them.

        `pictures` is the topic of those that we write ourselves, if we do; `calibration` whether we write that.
        """
        if not self.copied:
            return Topics(self.name, self.name) if self.name else Topics()
        camera = ["annotations"] + ["calibration"] * calibration + ([pictures] if pictures else [])
        root = _free(self.name, [LOG, SCENE, REQUESTS, OVERVIEW, MARKERS], self.taken)
        frame_id = self.source.frame_id
        return TopicsBeside(
            _free(self.name or _prefix(self.source.topic), camera, self.taken),
            root,
            f"{_free(root, [TRANSFORMS], self.taken)}/{TRANSFORMS}",
            frame_id,
        )


@dataclass(frozen=True)
class Input:
    """What is read: the cameras, and of a recording what is copied."""

    path: Path
    views: tuple[CameraView, ...]
    records: McapRecords | None = None
    streams: tuple[McapStream, ...] = ()

    def lost(self) -> list[str]:
        """What could not be read by any of the cameras or for the copy."""
        lines = [line for view in self.views for line in view.lost()]
        if self.records is not None and self.streams:
            lines += _named(self.path, map(str, self.records.lost))
        return list(dict.fromkeys(lines))


def _named(path: Path, lines: Iterable[str]) -> list[str]:
    return [line if line.startswith(str(path)) else f"{path}: {line}" for line in lines]


@contextmanager
def open_input(
    path: Path,
    choice: FromMcap | None = None,
    *,
    start_time_ns: int | None = None,
    rate: Fraction | None = None,
    packets: bool = True,
) -> Iterator[Input]:
    """Open a video file, several by their list, a folder of pictures, or the chosen pictures of a recording; closed on
    the way out.

    `start_time_ns` is for videos and folders, `rate` (pictures a second) for folders, `packets` is VideoSource's.
    Raises SourceError for what cannot be read, UsageError where something has to be said, or was said of the wrong kind
    of input.
    """
    with ExitStack() as stack:
        if rate is not None and not _is_folder(path):
            raise UsageError(f"{path}: --rate is for a folder of pictures; what is here has its own times")
        if is_recording(path):
            if start_time_ns is not None:
                raise UsageError(f"{path}: a recording has its own times: choose with --time, not --start-time")
            yield _open_recording(path, choice or FromMcap(), stack)
        else:
            if choice is not None:
                raise UsageError(f"{path}: --topic, --time, --start, --end and --copy are for MCAP input")
            if _is_folder(path):
                if rate is None:
                    raise UsageError(f"{path}: is a folder: how many pictures a second? Give --rate, as in --rate 240")
                source: Source = PictureFolder(path, rate, start_time_ns=start_time_ns)
            elif is_list(path):
                source = stack.enter_context(Chapters(path, start_time_ns=start_time_ns, packets=packets))
            else:
                source = stack.enter_context(VideoSource(path, start_time_ns=start_time_ns, packets=packets))
            yield Input(path, (CameraView(source),))


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except OSError:
        return False


def _open_recording(path: Path, choice: FromMcap, stack: ExitStack) -> Input:
    for topic in choice.topics:
        if choice.topics.count(topic) > 1:
            raise UsageError(f"--topic {topic} is there twice")
    records = stack.enter_context(McapRecords(path))
    sources = _open_topics(path, choice, records)
    tracked = [source.topic for source in sources]
    beside = [s.calibration_topic for s in sources if s.calibration_topic is not None]
    taken: list[str] = []
    streams: tuple[McapStream, ...] = ()
    if choice.copy == "all":
        taken = [channel.topic for channel in records.channels.values()]
        streams = (McapStream(records),)
    elif choice.copy == "images":
        taken = [*tracked, *beside]
        streams = (McapStream(records, topics=set(taken), extras=False),)
    views = tuple(
        CameraView(
            source,
            _name(source.topic, tracked) if len(tracked) > 1 else "",
            frozenset(taken),
            _far_apart(records, choice, source),
        )
        for source in sources
    )
    return Input(path, views, records, streams)


def _open_topics(path: Path, choice: FromMcap, records: McapRecords) -> list[McapImageSource]:
    if not choice.topics and len(found := image_topics(records)) > 1:
        listed = ", ".join(map(str, found))
        raise UsageError(f"{path} has several image topics, name one (or more) with --topic: {listed}")
    wanted = choice.topics or (None,)
    given = {"start_ns": choice.start_ns, "end_ns": choice.end_ns}
    if any(ns is not None and ns < LARGEST_RELATIVE_NS for ns in given.values()):
        firsts = [McapImageSource(records, topic, time=choice.time).first_stamp_ns for topic in wanted]
        given = {k: min(firsts) + ns if ns is not None and ns < LARGEST_RELATIVE_NS else ns for k, ns in given.items()}
    return [McapImageSource(records, topic, time=choice.time, **given) for topic in wanted]


def _far_apart(records: McapRecords, choice: FromMcap, source: McapImageSource) -> tuple[str, ...]:
    """A note where the header stamps are on another clock than the recording."""
    first = next(records.messages({source.topic}), None)
    if first is None or choice.time != "header" or choice.start_ns is not None:
        return ()
    apart_ns = source.first_stamp_ns - first.log_time
    if abs(apart_ns) < FAR_APART_NS:
        return ()
    return (
        f"{source.topic}: the header stamps are {abs(apart_ns) / NS_PER_S:.0f} s "
        f"{'after' if apart_ns > 0 else 'before'} the log times, and so will be our channels: "
        "use --time log where that is not wanted",
    )


def _prefix(topic: str) -> str:
    """What picture, calibration and annotations share, by which viewers pair them."""
    return topic.rpartition("/")[0] or topic


def _name(topic: str, among: Sequence[str]) -> str:
    """What a camera is called: the prefix of its image topic, or the topic where two share that."""
    prefix = _prefix(topic)
    return prefix if sum(_prefix(other) == prefix for other in among) == 1 else topic


def _free(place: str, leaves: Sequence[str], taken: Collection[str]) -> str:
    """The place, or the next one below it, where none of the leaves is a topic already."""
    for number in itertools.count():
        tried = place if number == 0 else f"{place}/tracked{number if number > 1 else ''}"
        ours = [f"{tried}/{leaf}" for leaf in leaves]
        if not any(topic == mine or topic.startswith(f"{mine}/") for topic in taken for mine in ours):
            return tried
    raise AssertionError


def files_of(path: Path) -> list[Path]:
    """The files that an input is read from: a folder's, by name, or those that a list names; else the file itself."""
    if path.is_dir():
        return sorted(p for p in path.iterdir() if p.is_file())
    return chapters_in(path) if is_list(path) else [path]


def fingerprint(path: Path) -> tuple[int, str]:
    """Size in bytes and SHA-256 of a file; of the hashes of a folder's or a list's files one after another."""
    files = files_of(path)
    hashes = []
    for one in files:
        with one.open("rb") as file:
            hashes.append(hashlib.file_digest(file, "sha256"))
    whole = hashes[0] if files == [path] else hashlib.sha256(b"".join(one.digest() for one in hashes))
    return sum(one.stat().st_size for one in files), whole.hexdigest()
