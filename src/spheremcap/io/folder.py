"""A folder of numbered pictures as a video: JPEG, PNG or WebP, in the order of their numbers, at a stated rate."""

import itertools
import math
import re
from bisect import bisect_left
from collections import Counter
from collections.abc import Generator
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Self

from spheremcap.core.camera import Camera
from spheremcap.core.frame import BgrFrame, EncodedPicture, Frame
from spheremcap.core.time import ticks_to_ns
from spheremcap.errors import SourceError, UsageError, short
from spheremcap.io.input_file import checked_input
from spheremcap.io.picture import is_cut_jpeg, is_jpeg, still_image
from spheremcap.io.source import Losses

PICTURE_ENDINGS = (".jpg", ".jpeg", ".png", ".webp")
_NUMBERED = re.compile(r"(.*?)(\d+)(\D*)", re.ASCII)
_LARGEST_FILE_BYTES = 256 << 20


class PictureFolder:
    """Numbered pictures in a folder as frames; also a context manager. Other files in it are passed over.

    Picture `frame_0012.png` stands 12 - (the first number) pictures after the first, at so many times 1/`rate` seconds
    after `start_time_ns` (Unix time; 0 when it is not known): one that is missing in between leaves a gap, in `index`
    too. Where all numbers are apart by a multiple of the same step, the step counts as one. JPEG pictures can be handed
    on as they are.

    Raises UsageError where the folder has pictures of several series, SourceError where it has none that can be read.
    """

    pixel_aspect = 1.0
    chroma_note = ""
    first_index = 0
    topic = ""
    calibration_topic: str | None = None
    calibration: Camera | None = None
    frame_id = ""

    def __init__(self, path: Path, rate: Fraction, *, start_time_ns: int | None = None) -> None:
        self.path = path
        self.lost = Losses()
        self.stated_rate: Fraction | None = rate
        self._rate = rate
        self.start_time_ns = start_time_ns or 0
        self.time_source = f"{rate} pictures a second, stated" + ("" if start_time_ns is None else ", from start-time")
        self._pictures = _numbered(path)
        self.notes = _gaps([index for index, _ in self._pictures])
        first = next(self._read(), None)
        if first is None:
            raise SourceError(f"{path}: no picture in it can be decoded: {'; '.join(self.lost.lines())}")
        self.width_px, self.height_px, self._first = first.width_px, first.height_px, first.encoded
        self.first_index = first.index

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Nothing is open between two pictures."""

    @property
    def codec(self) -> str:
        """jpeg when the pictures can be handed on."""
        return "" if self._first is None else self._first.format

    @property
    def passthrough_reason(self) -> str | None:
        """Why the pictures cannot be handed on as they are; None when they can."""
        mixed = len({path.suffix.lower() in (".jpg", ".jpeg") for _, path in self._pictures}) > 1
        return "the pictures are not all JPEG" if self._first is None or mixed else None

    @property
    def frame_count_hint(self) -> int:
        """One more than the last index."""
        return self._pictures[-1][0] + 1

    def stamp_ns(self, index: int) -> int:
        """When the picture with that index was taken."""
        return self.start_time_ns + ticks_to_ns(index, 1 / self._rate)

    def frames(self, first: int = 0) -> Generator[Frame, None, None]:
        """All pictures from index `first` on, in the order of their numbers; `lost` is complete at the end. Calling
        again starts over."""
        self.lost = Losses()
        self.lost.file = list(self.notes)
        for frame in self._read(first):
            if (frame.width_px, frame.height_px) != (self.width_px, self.height_px):
                self.lost.stopped = (
                    f"{self.path}: the picture size changes from {self.width_px}x{self.height_px} to "
                    f"{frame.width_px}x{frame.height_px} at picture {frame.index}; the rest is left out"
                )
                return
            yield frame

    def _read(self, first: int = 0) -> Generator[Frame, None, None]:
        for index, path in self._pictures[bisect_left(self._pictures, (first,)) :]:
            try:
                if checked_input(path, "a picture") > _LARGEST_FILE_BYTES:
                    raise ValueError(f"more than {_LARGEST_FILE_BYTES >> 20} MB")
                data = path.read_bytes()
                frame = BgrFrame(index, self.stamp_ns(index), still_image(data))
            except (ValueError, SourceError, OSError) as error:
                self.lost.miss(f"{path.name}: {short(error)}")
                continue
            if is_jpeg(data):
                self.lost.damaged += is_cut_jpeg(data)
                frame.encoded = EncodedPicture(data, "jpeg", True)
            yield frame


def _numbered(folder: Path) -> list[tuple[int, Path]]:
    """(index from 0, path) of the pictures by their last number."""
    try:
        names = sorted(path for path in folder.iterdir() if path.suffix.lower() in PICTURE_ENDINGS)
    except OSError as error:
        raise SourceError(f"{folder}: cannot be opened: {error.strerror}") from error
    if not names:
        raise SourceError(f"{folder}: is a folder without pictures ({', '.join(PICTURE_ENDINGS)}); name a video file")
    found = {path: _NUMBERED.fullmatch(path.stem[::-1]) for path in names}
    series: Counter[tuple[str, str]] = Counter()
    numbers: dict[int, Path] = {}
    for path, match in found.items():
        if match is None:
            raise UsageError(f"{folder}: {path.name} has no number: leave only the numbered pictures in the folder")
        series[match[3][::-1], match[1][::-1]] += 1
        number = int(match[2][::-1])
        if number in numbers and len(series) == 1:
            raise UsageError(f"{folder}: {numbers[number].name} and {path.name} have the same number")
        numbers[number] = path
    if len(series) > 1:
        listed = ", ".join(f"{before}#{behind} ({count})" for (before, behind), count in series.most_common(4))
        raise UsageError(f"{folder}: pictures of several series ({listed}): put each into a folder of its own")
    first = min(numbers)
    step = math.gcd(*(number - first for number in numbers)) or 1
    return [((number - first) // step, numbers[number]) for number in sorted(numbers)]


def _gaps(indices: list[int]) -> list[str]:
    """A line about the numbers that are missing; none when there is no gap."""
    missing = indices[-1] + 1 - len(indices)
    if not missing:
        return []
    gaps = [(a + 1, b - 1) for a, b in itertools.pairwise(indices) if b - a > 1]
    shown = ", ".join(str(a) if a == b else f"{a} to {b}" for a, b in gaps[:3]) + (", ..." if len(gaps) > 3 else "")
    return [f"{missing} picture{'s' * (missing != 1)} missing in the numbering (frame{'s' * (missing != 1)} {shown})"]
