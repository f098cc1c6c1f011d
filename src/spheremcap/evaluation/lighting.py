"""Illumination: the same poses at 30 brightness levels, six colours, by exposure gain and by additive
clipping.
"""

from dataclasses import replace
from functools import partial
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from spheremcap.chain import ChainConfig
from spheremcap.core.circle import Circle
from spheremcap.core.estimate import MarkerEstimate
from spheremcap.core.frame import BgrFrame, BgrImage
from spheremcap.core.marker import MarkerSpec, Seed
from spheremcap.evaluation.lab import Lab
from spheremcap.evaluation.metrics import TruthRow, compare, score
from spheremcap.evaluation.result import Plot, Result, Table
from spheremcap.session import Session
from spheremcap.synth import Scene, build
from spheremcap.synth.scenarios import BLUE, CYAN, GREEN, MAGENTA, ORANGE, YELLOW

Levels = npt.NDArray[np.float64]
Lut = npt.NDArray[np.uint8]

COLOURS = {
    "green": GREEN, "magenta": MAGENTA, "orange": ORANGE, "blue": BLUE, "yellow": YELLOW, "cyan": CYAN,
}  # fmt: skip
GAINS: Levels = np.geomspace(0.02, 16, 30)
"""Exposure relative to that of the reference, in linear light."""
OFFSETS: Levels = np.linspace(-145, 145, 30)
"""Added to all three 8-bit channels, then clipped."""


def gain_lut(gain: float) -> Lut:
    """(256,) what an 8-bit sRGB value becomes when `gain` times the light comes in; clips at 255."""
    code = np.arange(256) / 255
    linear = np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4) * gain
    again = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)
    return np.asarray(np.rint(255 * np.clip(again, 0, 1)), np.uint8)


def offset_lut(offset: float) -> Lut:
    """(256,) an 8-bit value plus `offset`, clipped."""
    return np.asarray(np.rint(np.clip(np.arange(256) + offset, 0, 255)), np.uint8)


def illumination(lab: Lab) -> Result:
    """Accuracy against brightness (figure 2.14): each level is a video of its own, seeded on its first
    frame.
    """
    poses, step = (12, 10) if lab.quick else (100, 1)
    gains, offsets = GAINS[::step], OFFSETS[::step]
    colours = dict(list(COLOURS.items())[: 2 if lab.quick else None])
    by_gain = np.full((len(colours), len(gains), 2), np.nan)  # accuracy over visible frames %, measured %
    by_offset = np.full((len(colours), len(offsets), 2), np.nan)
    luts = [gain_lut(float(level)) for level in gains] + [offset_lut(float(level)) for level in offsets]
    found = lab.each(partial(_under, luts=luts, poses=poses), list(colours.values()))
    for c, (name, rows) in enumerate(zip(colours, found, strict=True)):
        lab.tell(f"illumination: {name}")
        by_gain[c], by_offset[c] = rows[: len(gains)], rows[len(gains) :]

    def cells(levels: Levels, values: npt.NDArray[np.float64], form: str) -> list[list[str]]:
        rows = [["level", *colours, "mean", "measured, mean %"]]
        for k, level in enumerate(levels):
            each = [f"{v:.2f}" for v in values[:, k, 0]]
            rows.append([format(level, form), *each, f"{values[:, k, 0].mean():.2f}", f"{values[:, k, 1].mean():.1f}"])
        return rows

    def draw(figure: Any) -> None:
        axes = figure.subplots(1, 2, sharey=True)
        for c, name in enumerate(colours):
            r, g, b = colours[name]
            shade = (r / 255, g / 255, b / 255)
            axes[0].semilogx(gains, by_gain[c, :, 0], color=shade, label=name)
            axes[1].plot(offsets, by_offset[c, :, 0], color=shade)
        axes[0].semilogx(gains, by_gain[..., 0].mean(axis=0), color="black", linewidth=2, label="mean")
        axes[1].plot(offsets, by_offset[..., 0].mean(axis=0), color="black", linewidth=2)
        axes[0].set_xlabel("exposure, times the reference's")
        axes[1].set_xlabel("added to the 8-bit values")
        axes[0].set_ylabel("accuracy over all frames, %")
        axes[0].legend(fontsize=7)

    return Result(
        "illumination",
        "Illumination",
        f"{poses} poses of a rendered marker, each level a video of its own that is seeded on its first "
        "frame with the true circle in whole pixels. Accuracy is 100 * Dice over all frames, where one "
        "without a circle counts 0. Gain is in linear light and clips at white; the offset is added to the "
        "8-bit values and clips at both ends.",
        "spheremcap experiment illumination",
        (
            Table("By exposure gain", cells(gains, by_gain, ".3f")),
            Table("By additive clipping", cells(offsets, by_offset, "+.0f")),
        ),
        (Plot("illumination", "Accuracy under illumination changes (figure 2.14)", draw),),
    )


def _under(colour: tuple[int, int, int], luts: list[Lut], poses: int) -> list[tuple[float, float]]:
    """What `_follow` finds of a ball of this colour with each table of brightness."""
    pictures, truth, scene = _poses(colour, poses)
    return [_follow(pictures, truth, scene, lut) for lut in luts]


def _poses(colour: tuple[int, int, int], count: int) -> tuple[list[BgrImage], list[TruthRow], Scene]:
    """Pictures of a ball of this colour as "clean" has it, not encoded, and their truth."""
    world = build("clean", frames=count)
    scene = Scene(replace(world, balls=(replace(world.balls[0], colour=colour),)))
    pictures, rows = [], []
    for index, (picture, _, truths) in enumerate(scene.frames(workers=1)):
        pictures.append(picture)
        rows.append(TruthRow("marker", index, truths[0].circle, truths[0].xyz_cam_m, truths[0].visible))
    return pictures, rows, scene


def _follow(pictures: list[BgrImage], truth: list[TruthRow], scene: Scene, lut: Lut) -> tuple[float, float]:
    """Accuracy over the visible frames and the share measured, both %, with every picture sent through
    `lut`.
    """
    start = truth[0].circle
    assert start is not None
    whole = Circle(round(start.x_px), round(start.y_px), round(start.r_px))
    session = Session(
        scene.camera, [MarkerSpec("marker")], [Seed("marker", 0, whole)], ChainConfig(),
        exposure_s=scene.world.sensor.exposure_s, readout_s=scene.world.sensor.readout_s,
    )  # fmt: skip
    frames = (
        BgrFrame(k, scene.stamp_ns(k), np.asarray(cv2.LUT(picture, lut), np.uint8))
        for k, picture in enumerate(pictures)
    )
    estimates: list[MarkerEstimate] = [e for result in session.run(frames) for e in result.estimates]
    row = score([compare(truth, estimates, "marker")])
    return row.accuracy_visible_pct or 0.0, 100 * row.measured_frames / max(1, row.frames)
