"""A board as a known camera films it: every pixel's ray, by the camera's own model, meets the board's plane."""

from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from xml.etree import ElementTree

import cv2
import numpy as np

from spheremcap.analysis.board import Board
from spheremcap.analysis.sheet import sheet_svg
from spheremcap.core.camera import Camera
from spheremcap.io.encode import write_video

CAMERA = Camera(640, 360, 596.0, 599.0, 324.0, 176.0, "plumb_bob", (-0.28, 0.12, 0.0005, -0.0004))
CHARUCO = Board.of("charuco:7x5:30mm:22mm")
CHECKERBOARD = Board.of("checkerboard:8x6:30mm")
_FINER = 2
_PX_A_MM = 3


@dataclass(frozen=True)
class Pose:
    """Where the board's middle is seen (px), how far away (m), and how it is turned about x, y and z (degrees)."""

    at_px: tuple[float, float]
    away_m: float
    turned_deg: tuple[float, float, float]


def poses(count: int, seed: int = 0, *, tilt_deg: float = 38, spread: float = 0.9) -> list[Pose]:
    """All over the picture (`spread` of it), tilted by up to so much to all sides."""
    rng = np.random.default_rng(seed)
    places = [
        (0.5, 0.5),
        (0.1, 0.15),
        (0.9, 0.15),
        (0.1, 0.85),
        (0.9, 0.85),
        (0.5, 0.1),
        (0.5, 0.9),
        (0.1, 0.5),
        (0.9, 0.5),
    ]
    made = []
    for index in range(count):
        place = (np.array(places[index % len(places)]) - 0.5) * spread + 0.5
        angle = 2 * np.pi * index * 0.382
        tilt = tilt_deg * (0.5 + 0.5 * rng.random())
        made.append(
            Pose(
                tuple(place * (CAMERA.width_px, CAMERA.height_px)), rng.uniform(0.3, 0.55),
                (tilt * np.cos(angle), tilt * np.sin(angle), rng.uniform(-25, 25)),
            )
        )  # fmt: skip
    return made


@lru_cache
def sheet(board: Board) -> tuple[np.ndarray, float]:
    """The printed sheet as a picture, drawn from its SVG, and its margin in mm."""
    root = ElementTree.fromstring(sheet_svg(board))
    wide, high = (float(root.attrib[side].removesuffix("mm")) for side in ("width", "height"))
    drawn = np.full((round(high * _PX_A_MM), round(wide * _PX_A_MM)), 255, np.uint8)
    for rect in root.iter("{http://www.w3.org/2000/svg}rect"):
        if rect.attrib.get("fill") != "white":
            x, y, w, h = (float(rect.attrib[name]) for name in ("x", "y", "width", "height"))
            x0, y0, x1, y1 = (round(side * _PX_A_MM) for side in (x, y, x + w, y + h))
            drawn[y0:y1, x0:x1] = 0
    return drawn, board.square_m * 1e3


@lru_cache
def rays() -> np.ndarray:
    """x/z and y/z of a finer grid of pixels, (rows, columns, 2)."""
    y, x = np.mgrid[0 : CAMERA.height_px * _FINER, 0 : CAMERA.width_px * _FINER]
    pixels = (np.stack([x, y], axis=2).reshape(-1, 2) + 0.5) / _FINER - 0.5
    return CAMERA.normalise(pixels).reshape(*x.shape, 2)


def transform(pose: Pose, camera: Camera = CAMERA) -> tuple[np.ndarray, np.ndarray]:
    """The board's turn (3, 3) and shift (3,) in the camera's frame."""
    turn = np.eye(3)
    for axis in range(3):
        turn = turn @ cv2.Rodrigues(np.eye(3)[axis] * np.radians(pose.turned_deg[axis]))[0]
    middle = camera.normalise(np.array([pose.at_px]))[0]
    return turn, np.array([*middle, 1]) * pose.away_m


def picture(board: Board, pose: Pose, *, seed: int = 0, blur_px: float = 0.6) -> np.ndarray:
    """The board on a grey ground, (360, 640, 3) BGR, with a lens's blur and a sensor's noise."""
    drawn, margin_mm = sheet(board)
    turn, shift = transform(pose)
    own = rays() @ np.linalg.inv(np.column_stack([turn[:, 0], turn[:, 1], shift]))[:, :2].T
    own += np.linalg.inv(np.column_stack([turn[:, 0], turn[:, 1], shift]))[:, 2]
    mm = own[:, :, :2] / own[:, :, 2:] * 1e3
    middle = np.array([board.columns, board.rows]) * board.square_m * 1e3 / 2 + margin_mm
    on_sheet = ((mm + middle) * _PX_A_MM - 0.5).astype(np.float32)
    seen = cv2.remap(drawn, on_sheet[:, :, 0], on_sheet[:, :, 1], cv2.INTER_LINEAR, borderValue=110)
    seen = cv2.resize(seen, (CAMERA.width_px, CAMERA.height_px), interpolation=cv2.INTER_AREA)
    lit = 30 + 0.75 * cv2.GaussianBlur(seen.astype(np.float32), (0, 0), blur_px)
    lit += np.random.default_rng(seed).normal(0, 2, lit.shape)
    return cv2.cvtColor(np.clip(lit, 0, 255).astype(np.uint8), cv2.COLOR_GRAY2BGR)


def film(path: Path, board: Board, filmed: list[Pose], *, rate: int = 5) -> Path:
    """A video with one pose a picture."""
    write_video(path, (picture(board, pose, seed=i) for i, pose in enumerate(filmed)), Fraction(rate), crf=14)
    return path
