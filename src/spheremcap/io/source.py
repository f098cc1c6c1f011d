"""What gives frames: a video file, pictures in a folder, an image topic. One more kind is one more class."""

from collections.abc import Generator
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Protocol

from spheremcap.core.camera import Camera
from spheremcap.core.frame import Frame


@dataclass
class Losses:
    """What could not be had from a source, counted while its frames are read; truthy when anything was lost."""

    undecodable: int = 0
    """Packets or messages that never became a picture."""
    damaged: int = 0
    """Pictures kept although the decoder had to patch them."""
    restamped: int = 0
    """Pictures without a time stamp of their own, or with one that did not come after the picture before."""
    out_of_order: int = 0
    """Pictures kept with a stamp that is not after the one before."""
    skipped: int = 0
    """Live pictures that nobody took before the next one came."""
    stopped: str | None = None
    """Why reading ended before the source's end, in one line; None when it did not."""
    first_reason: str | None = None
    """Why the first of the undecodable ones is one."""
    file: list[str] = field(default_factory=list)
    """Damage of the file itself, a line each."""

    def __bool__(self) -> bool:
        return bool(self.undecodable or self.damaged or self.skipped or self.stopped or self.file)

    def miss(self, reason: str) -> None:
        """One more that never became a picture."""
        self.undecodable += 1
        self.first_reason = self.first_reason or reason

    def lines(self) -> list[str]:
        """One line per kind of loss, for a person."""
        kinds = (
            (self.undecodable, "could not be decoded: missing"),
            (self.damaged, "damaged: kept as the decoder patched them"),
            (self.restamped, "without a usable time stamp: given one from their neighbours"),
            (self.out_of_order, "with a stamp that is not after the one before: kept"),
            (self.skipped, "skipped: tracking was slower than the camera, and took the newest"),
        )
        lines = [*self.file, *(f"{count} picture{'s' * (count != 1)} {what}" for count, what in kinds if count)]
        if self.first_reason is not None:
            lines[len(self.file)] += f"; the first: {self.first_reason}"
        if self.stopped:
            lines.append(self.stopped)
        return lines


class Source(Protocol):
    """Frames in order, each decoded once, and what is known of them before; closed by whoever opened it.

    `codec` says what the pictures are, and `passthrough_reason` why they cannot be handed on as they are (None: they
    can). `chroma_note` is what the pictures show of where their chroma lies, where nothing says it; else "". `topic`,
    `calibration_topic` and `frame_id` are those of a recording, "" or None elsewhere; `calibration` is the camera found
    beside the pictures. `first_index` is that of the first frame. `stated_rate` (frames/s) and `frame_count_hint` are
    for people and levels only.
    """

    path: Path
    width_px: int
    height_px: int
    pixel_aspect: float
    """How much wider than high a pixel is."""
    lost: Losses
    """Complete when all frames have been read."""

    @property
    def chroma_note(self) -> str: ...

    @property
    def codec(self) -> str: ...

    @property
    def passthrough_reason(self) -> str | None: ...

    @property
    def frame_count_hint(self) -> int | None: ...

    @property
    def first_index(self) -> int: ...

    @property
    def stated_rate(self) -> Fraction | None: ...

    @property
    def time_source(self) -> str: ...

    @property
    def topic(self) -> str: ...

    @property
    def calibration_topic(self) -> str | None: ...

    @property
    def calibration(self) -> Camera | None: ...

    @property
    def frame_id(self) -> str: ...

    def frames(self) -> Generator[Frame, None, None]: ...

    def close(self) -> None: ...
