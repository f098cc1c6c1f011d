"""A film of a board, in a file or a recording: its sharpest pictures, the board's corners on them, the camera."""

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np

from spheremcap.analysis.board import Board, Calibrated, Grey, Model, View, differing, draw, other_board, solve
from spheremcap.analysis.sheet import sheet_svg
from spheremcap.core.frame import Frame
from spheremcap.core.time import NS_PER_S
from spheremcap.errors import OutputError, SourceError, UsageError
from spheremcap.io.calibration import write_camera_info
from spheremcap.io.output import checked_output, whole_file
from spheremcap.io.source import Source
from spheremcap.io.sources import FromMcap, is_recording, open_input

_APART_NS = NS_PER_S // 5
"""Of so much of the film one picture is looked at, the sharpest."""
_SHOWN = 8
_STILLS = Fraction(1)


@dataclass(frozen=True)
class FilmedBoard:
    """What came of a film: `looked` pictures were searched, the board was `seen` on so many of them.

    `picture` is the PNG beside the output. `lost` says what of the film could not be read, a line each.
    """

    found: Calibrated
    looked: int
    seen: int
    picture: Path
    lost: tuple[str, ...]


def calibrate_board(
    source_path: str | os.PathLike[str],
    output: str | os.PathLike[str],
    board: Board,
    *,
    model: Model = "plumb_bob",
    topic: str | None = None,
    overwrite: bool = False,
    progress: Callable[[int, int | None], None] = lambda done, total: None,
) -> FilmedBoard:
    """Write the camera that filmed a board as camera_info YAML, and beside it a PNG of where its corners were.

    The film is a video, a folder of pictures, each of which counts, or an image topic of an MCAP. `progress` is called
    with frames done and frames expected. Raises SourceError where there is no such film, and where it does not say
    enough of the camera: what was found, what is expected, what to film; UsageError, OutputError.
    """
    path, out = Path(source_path), Path(output)
    if out.suffix.lower() not in (".yaml", ".yml"):
        raise UsageError(f"{out}: a camera is written as .yaml")
    beside = out.with_suffix(".png")
    for place in (out, beside):
        checked_output(place, [path], overwrite=overwrite)
    choice = FromMcap((topic,) if topic else (), copy="none") if topic or is_recording(path) else None
    with open_input(path, choice, rate=_STILLS if path.is_dir() else None, packets=False) as given:
        source = given.views[0].source
        views, looked, greys = _views(source, board, progress)
        lost = tuple(given.lost())
        width_px, height_px = source.width_px, source.height_px
    if not views:
        other = other_board(greys, board)
        raise SourceError(
            f"{path}: no {board} on any of {looked} pictures; "
            + (f"there is a {other} there: give that as --board" if other else "is it all in the picture, and sharp?")
        )
    found = solve(differing(views, board, width_px), width_px, height_px, model)
    if isinstance(found, str):
        raise SourceError(f"{path}: {found}")
    with whole_file(out, [path], overwrite=overwrite) as part:
        write_camera_info(part.path, replace(found.camera, source=path.name))
    done, png = cv2.imencode(".png", draw(found))
    if not done:
        raise OutputError(f"{beside}: the picture could not be encoded as PNG")
    with whole_file(beside, [path], overwrite=overwrite) as part:
        part.path.write_bytes(png.tobytes())
    return FilmedBoard(found, looked, len(views), beside, lost)


def write_sheet(output: str | os.PathLike[str], board: Board, *, overwrite: bool = False) -> None:
    """Write the board as an SVG to print. Raises UsageError, OutputError."""
    if Path(output).suffix.lower() != ".svg":
        raise UsageError(f"{output}: a board is written as .svg, which a browser prints in true size")
    with whole_file(output, overwrite=overwrite) as part:
        part.path.write_text(sheet_svg(board), encoding="utf-8")


def _views(
    source: Source, board: Board, progress: Callable[[int, int | None], None]
) -> tuple[list[View], int, list[Grey]]:
    """Where the board is seen, how many pictures were looked at, and some of those, from all over the film."""
    boards = [board]
    if board.dictionary and board.rows % 2 == 0:
        boards.append(replace(board, legacy=True))
    views: list[View] = []
    kept: list[Grey] = []
    every, looked = 1, 0
    for index, grey in _sharpest(source, progress):
        for tried in boards:
            seen = tried.find(grey)
            if seen is not None:
                views.append(View(index, *seen))
                boards = [tried]
                break
        if not views and looked % every == 0:
            kept.append(grey)
            if len(kept) > _SHOWN:
                kept, every = kept[::2], 2 * every
        looked += 1
    return views, looked, kept


def _sharpest(source: Source, progress: Callable[[int, int | None], None]) -> Iterator[tuple[int, Grey]]:
    """Of each stretch of the film its sharpest picture, with its frame's number."""
    best: Frame | None = None
    best_sharpness, end_ns = -1.0, None
    for done, frame in enumerate(source.frames(), 1):
        if end_ns is None or frame.stamp_ns >= end_ns:
            if best is not None:
                yield best.index, _grey(best)
            end_ns, best_sharpness = frame.stamp_ns + _APART_NS, -1.0
        sharpness = _sharpness(frame)
        if sharpness > best_sharpness:
            best, best_sharpness = frame, sharpness
        progress(done, source.frame_count_hint)
    if best is not None:
        yield best.index, _grey(best)


def _grey(frame: Frame) -> Grey:
    return np.asarray(cv2.cvtColor(frame.full, cv2.COLOR_BGR2GRAY))


def _sharpness(frame: Frame) -> float:
    """How much neighbouring pixels differ: of pictures of the same thing, the larger the sharper."""
    return float(np.square(cv2.Laplacian(np.ascontiguousarray(frame.planes.y), cv2.CV_32F)).mean())
