"""What is inside a video, without tracking anything."""

import os
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

from spheremcap.core.time import NS_PER_S
from spheremcap.io.chapters import Chapters, is_list
from spheremcap.io.video import VideoSource


@dataclass(frozen=True)
class VideoSummary:
    """What is inside a video. `frames` is as the container states it, and None where it does not; `checked` says
    that all of them were decoded, and `frames` and `lost` then are of that. Sizes are those of the picture as shown.
    `chapters` are the files that a list names, none for a video of one file.
    """

    path: Path
    chapters: tuple[Path, ...]
    size_bytes: int
    frames: int | None
    checked: bool
    rate: Fraction | None
    width_px: int
    height_px: int
    codec: str
    pixel_format: str
    interlaced: bool
    start_time_ns: int
    start_time_source: str
    duration_s: float | None
    rotation_deg: int
    pixel_aspect: float
    passthrough_reason: str | None
    lost: tuple[str, ...]


def summarise_video(path: str | os.PathLike[str], *, check: bool = False) -> VideoSummary:
    """Say what is inside a video file or the list of several; `check` decodes all of it. Raises SourceError when there
    is no picture in it."""
    path = Path(path)
    with Chapters(path) if is_list(path) else VideoSource(path) as source:
        chapters, notes = (source.files, source.notes) if isinstance(source, Chapters) else ((), [])
        frames, duration_s = source.frame_count_hint, None
        reason = source.passthrough_reason
        if check:
            frames, first_ns, last_ns = 0, 0, 0
            for frame in source.frames():
                first_ns = frame.stamp_ns if not frames else first_ns
                frames, last_ns = frames + 1, frame.stamp_ns
            duration_s = (last_ns - first_ns) / NS_PER_S
        return VideoSummary(
            path=source.path,
            chapters=chapters,
            size_bytes=sum(file.stat().st_size for file in chapters or (path,)),
            frames=frames,
            checked=check,
            rate=source.stated_rate,
            width_px=source.width_px,
            height_px=source.height_px,
            codec=source.codec,
            pixel_format=source.pixel_format,
            interlaced=source.interlaced,
            start_time_ns=source.start_time_ns,
            start_time_source=source.start_time_source,
            duration_s=duration_s,
            rotation_deg=source.rotation_deg,
            pixel_aspect=source.pixel_aspect,
            passthrough_reason=reason,
            lost=tuple(source.lost.lines() if check and source.lost else notes),
        )
