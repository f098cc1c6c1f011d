"""A recording's pictures as a video with what was found burnt in: to send to somebody who has no viewer."""

import itertools
import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np

from spheremcap.core.circle import Circle
from spheremcap.core.frame import BgrImage, Frame
from spheremcap.core.status import Status
from spheremcap.core.time import NS_PER_S, format_time
from spheremcap.errors import SourceError, UsageError
from spheremcap.io import recording
from spheremcap.io.contents import CameraContents, contents
from spheremcap.io.encode import write_video
from spheremcap.io.mcap_images import McapImageSource
from spheremcap.io.mcap_records import McapRecords
from spheremcap.io.messages import STATUS_RGB, Rgb, marker_rgb
from spheremcap.io.output import checked_output, whole_file
from spheremcap.io.recording import Track
from spheremcap.io.selection import Selection

TRAIL_NS = NS_PER_S
CROP_RADII = 6.0
"""Half the side of a cut-out, in radii of the marker."""
CROP_PX = 480
_SUB = 4  # bits behind the point that OpenCV draws to


@dataclass(frozen=True)
class Marked:
    """What became of a video: its pictures, and lines for the user."""

    pictures: int
    notes: tuple[str, ...]


def render(
    recording_path: str | os.PathLike[str],
    out_path: str | os.PathLike[str],
    *,
    wanted: Selection | None = None,
    crop: str = "",
    slow: Fraction = Fraction(1),
    overwrite: bool = False,
    progress: Callable[[int, int | None], None] = lambda done, total: None,
    stop: Callable[[], bool] = lambda: False,
) -> Marked:
    """Write the pictures of a recording as H.264 with circles, names, trails, status, votes, distance and time.

    `crop` follows this marker with a cut-out of `CROP_RADII` radii on each side, `slow` is how many times longer the
    video takes than what it shows. Every picture is shown as long: a recording of uneven times has its mean rate.
    Where `stop` says so the video ends there. Raises SourceError where there are no pictures, UsageError for a marker
    that is not there or is on another camera, OutputError.
    """
    path, out = Path(recording_path), Path(out_path)
    if out.suffix.lower() not in (".mp4", ".mkv"):
        raise UsageError(f"{out}: a marked-up video is .mp4 or .mkv, not {out.suffix or 'no ending'!r}")
    checked_output(out, [path], overwrite=overwrite)
    found, tracks = contents(path), recording.open(path).tracks
    chosen = wanted or Selection()
    chosen.check(tracks, path)
    camera = _camera(found.cameras, crop, path)
    place = camera.topics.root.strip("/")
    own = {name: tracks[f"{place}/{name}" if place else name] for name in camera.markers}
    if crop and crop.rpartition("/")[2] not in own:
        raise UsageError(f"{path}: no marker {crop!r} to follow; there are: {', '.join(own)}")
    with McapRecords(path) as records:
        chosen = chosen.from_start_of(records)
        source = McapImageSource(records, camera.picture, time="log")
        shown = {name: t for name, t in own.items() if not chosen.markers or t.marker in chosen.markers}
        drawing = _Drawing(shown, list(own), source.first_stamp_ns)
        window = _Window(own[crop.rpartition("/")[2]]) if crop else None
        total = source.frame_count_hint

        def pictures() -> Iterator[BgrImage]:
            for number, frame in enumerate(source.frames()):
                progress(number, total)
                if stop() or (chosen.end_ns is not None and frame.stamp_ns >= chosen.end_ns):
                    return
                if chosen.start_ns is None or frame.stamp_ns >= chosen.start_ns:
                    yield drawing.on(frame, window)

        each = pictures()
        beginning = next(each, None)
        if beginning is None:
            raise UsageError(f"{path}: there is no picture in the time that was asked for")
        rate = Fraction(found.rate_hz or 30).limit_denominator(1001) / slow
        with whole_file(out, [path], overwrite=overwrite) as part:
            # FFmpeg chooses the format by the name, and the part's has another ending.
            made = part.path.with_name(f"{part.path.name}{out.suffix}")
            try:
                count = write_video(made, itertools.chain([beginning], each), rate)
                made.replace(part.path)
            finally:
                made.unlink(missing_ok=True)
        return Marked(count, part.notes)


def _camera(cameras: Sequence[CameraContents], crop: str, path: Path) -> CameraContents:
    """The camera of the marker that is followed; else the first one that has pictures."""
    place = crop.strip("/").rpartition("/")[0]
    with_pictures = [c for c in cameras if c.picture and (not place or c.topics.root.strip("/") == place)]
    if not with_pictures:
        raise SourceError(f"{path}: has no pictures of ours to draw on: was it tracked with --video none?")
    return with_pictures[0]


class _Drawing:
    """Draws each marker's row of a frame, and where it was in the last second."""

    def __init__(self, tracks: dict[str, Track], markers: Sequence[str], first_ns: int) -> None:
        self._first_ns = first_ns
        self._tracks = tracks
        self._rows = {name: {int(t): k for k, t in enumerate(track.stamp_ns)} for name, track in tracks.items()}
        self._rgb = {name: marker_rgb(number) for number, name in enumerate(markers)}
        self._trails: dict[str, deque[tuple[int, Circle | None]]] = {name: deque() for name in tracks}

    def on(self, frame: Frame, window: "_Window | None") -> BgrImage:
        """The frame's picture (rows, columns, 3), of even size, marked up."""
        stamp_ns = frame.stamp_ns
        elapsed_s = (stamp_ns - self._first_ns) / NS_PER_S
        lines: list[tuple[str, Rgb]] = [
            (f"{format_time(stamp_ns)}   {elapsed_s:.3f} s   frame {frame.index}", (1.0, 1.0, 1.0))
        ]
        canvas, scale, (x0, y0) = (_even(frame.full), 1.0, (0.0, 0.0)) if window is None else window.cut(frame)

        def at(circle: Circle) -> tuple[int, int]:
            """Where a centre is on the canvas, in the parts of a pixel that OpenCV draws to."""
            x, y = ((p + 0.5 - o) * scale - 0.5 for p, o in ((circle.x_px, x0), (circle.y_px, y0)))
            return round(x * 2**_SUB), round(y * 2**_SUB)

        for name, track in self._tracks.items():
            row = self._rows[name].get(stamp_ns)
            if row is None:
                continue
            status, rgb = Status(track.status[row]), self._rgb[name]
            x, y, r = track.circle_px[row].tolist()
            circle = Circle(x, y, r) if x == x else None
            trail = self._trails[name]
            trail.append((stamp_ns, circle if status.measured else None))
            while trail[0][0] < stamp_ns - TRAIL_NS:
                trail.popleft()
            for (_, before), (_, after) in itertools.pairwise(trail):
                if before is not None and after is not None:
                    cv2.line(canvas, at(before), at(after), _bgr(rgb), 1, cv2.LINE_AA, _SUB)
            if circle is not None:
                thickness = 2 if status.measured else 1
                radius = max(1, round(r * scale * 2**_SUB))
                cv2.circle(canvas, at(circle), radius, _bgr(rgb), thickness, cv2.LINE_AA, _SUB)
                left, top = (v / 2**_SUB for v in at(circle))
                _text(canvas, name, (int(left + 0.8 * r * scale), int(top - r * scale)), rgb)
            lines.append((_words(name, track, row), STATUS_RGB[status]))
        for number, (text, rgb) in enumerate(lines, 1):
            _text(canvas, text, (8, 22 * number), rgb)
        return canvas


def _words(name: str, track: Track, row: int) -> str:
    """What is said of a marker: status, votes, distance from the camera, what spoke against it."""
    parts = [f"{name} {track.status[row]}"]
    if track.vote_sum[row] == track.vote_sum[row]:
        parts.append(f"votes {track.vote_sum[row]:.1f}")
    distance_m = float(np.linalg.norm(track.xyz_cam_m[row]))
    if distance_m == distance_m:
        parts.append(f"{distance_m:.3f} m")
    if track.reasons[row]:
        parts.append(track.reasons[row].replace(";", ", "))
    return "   ".join(parts)


class _Window:
    """A cut-out of one size that follows a marker, and waits where it was seen last."""

    def __init__(self, track: Track) -> None:
        seen = np.flatnonzero(np.isfinite(track.circle_px[:, 0]))
        if not len(seen):
            raise UsageError(f"{track.marker} has no circle on any frame: there is nothing to follow")
        self._half_px = CROP_RADII * float(np.median(track.circle_px[seen, 2]))
        self._circles = {int(track.stamp_ns[k]): track.circle_px[k, :2] for k in seen}
        self._centre = track.circle_px[seen[0], :2]

    def cut(self, frame: Frame) -> tuple[BgrImage, float, tuple[float, float]]:
        """The cut-out (CROP_PX, CROP_PX, 3), its pixels for one of the picture's, and where its corner is there."""
        self._centre = self._circles.get(frame.stamp_ns, self._centre)
        scale = CROP_PX / (2 * self._half_px)
        x0, y0 = (float(c) + 0.5 - self._half_px for c in self._centre)
        shift = np.array([[scale, 0, (0.5 - x0) * scale - 0.5], [0, scale, (0.5 - y0) * scale - 0.5]])
        cut = cv2.warpAffine(frame.full, shift, (CROP_PX, CROP_PX), flags=cv2.INTER_LINEAR)
        return cut, scale, (x0, y0)  # type: ignore[return-value]


def _even(image: BgrImage) -> BgrImage:
    """A copy without a last row or column that H.264 has no place for."""
    height, width = image.shape[:2]
    return image[: height // 2 * 2, : width // 2 * 2].copy()


def _text(canvas: BgrImage, text: str, place: tuple[int, int], rgb: Rgb) -> None:
    """Text in a colour on black, moved so far that it stays on the canvas."""
    (width, height), below = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.5, 1)
    x = max(2, min(place[0], canvas.shape[1] - width - 2))
    y = max(height + 2, min(place[1], canvas.shape[0] - below - 2))
    cv2.rectangle(canvas, (x - 2, y - height - 2), (x + width + 2, y + below), (0, 0, 0), -1)
    cv2.putText(canvas, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, 0.5, _bgr(rgb), 1, cv2.LINE_AA)


def _bgr(rgb: Rgb) -> tuple[int, int, int]:
    r, g, b = (round(255 * c) for c in rgb)
    return b, g, r
