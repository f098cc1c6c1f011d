"""RGB box, HSV box and ColorSmartBoundary on the same pixels (figures 2.8 to 2.11, eq 2.26)."""

from functools import partial
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from spheremcap.chain import ChainConfig
from spheremcap.core.circle import Circle
from spheremcap.core.frame import Frame, Patch, Window
from spheremcap.detection.colour import ColourBox, disc_mask, disc_pixels, learn_box
from spheremcap.evaluation.lab import Lab
from spheremcap.evaluation.protocol import Trial
from spheremcap.evaluation.result import Plot, Result, Table

Image = npt.NDArray[np.uint8]
Counts = dict[str, tuple[int, int, int]]
"""Box to pixels (right, marked, true): in the mask and the disc, in the mask, in the disc."""
BOXES = ("RGB box", "HSV box", "CSB, 93 %", "CSB, eq 2.26")
_AROUND = 3.0  # half side of the searched patch in marker radii


def colours(lab: Lab) -> Result:
    """How well each box, learnt on the seed's frame, tells the marker from its surroundings later."""
    heading = ["session: marker"]
    for name in BOXES:
        heading += [f"{name}: volume %", "of the marker %", "of its mask right %", "F1"]
    cells = [heading]
    means: dict[str, list[float]] = {name: [] for name in BOXES}
    shown: Image | None = None
    trials = lab.trials()
    found = lab.each(partial(_learn_and_count, most=5 if lab.quick else 20), trials)
    for trial, learnt in zip(trials, found, strict=True):
        lab.tell(f"colours: {trial.name}")
        for marker, pixels, counts, volumes in learnt:
            line = [f"{trial.name}: {marker}"]
            for name in BOXES:
                right, marked, true = counts[name]
                recall, precision = right / max(1, true), right / max(1, marked)
                f1 = 2 * recall * precision / max(1e-9, recall + precision)
                means[name].append(f1)
                line += [
                    f"{100 * volumes[name]:.2f}",
                    f"{100 * recall:.1f}",
                    f"{100 * precision:.1f}",
                    f"{f1:.3f}",
                ]
            cells.append(line)
            shown = pixels if shown is None else shown
    summary = [["box", "mean F1", "least F1"]]
    summary += [[n, f"{np.mean(v):.3f}", f"{min(v):.3f}"] for n, v in means.items() if v]

    def draw(figure: Any) -> None:
        axes = figure.subplots(1, 3)
        assert shown is not None
        hsv = shown.reshape(-1, 3)
        box = learn_box(hsv, ChainConfig().colour)
        for ax, title, values, limits in zip(
            axes,
            ("hue, 2 degrees a step", "saturation", "value"),
            ((hsv[:, 0] - box.hue_mean + 90.0) % 180 - 90 + box.hue_mean, hsv[:, 1], hsv[:, 2]),
            ((box.hue_mean - box.hue_half, box.hue_mean + box.hue_half), box.saturation, box.value),
            strict=True,
        ):
            ax.hist(values, bins=60, color="tab:gray")
            for limit in limits:
                ax.axvline(limit, color="tab:red")
            ax.set_xlabel(title)

    return Result(
        "colours",
        "RGB box, HSV box and ColorSmartBoundary",
        "Each box is learnt from the seed's disc (0.8 of its radius). RGB and HSV boxes hold all of its "
        "pixels (hue around its circular mean); ColorSmartBoundary grows from the mean until 93 % are "
        "inside, or by the rule of eq 2.26, with the chain's least widths. Counted in a patch of three "
        "radii around the true circle on later frames where the marker is wholly visible, at the seed's "
        "exposure. Volume is in % of the whole colour space.",
        "spheremcap experiment colours",
        (Table("All sessions", summary), Table("By session", cells)),
        (Plot("colours", "Pixels of the first session's seed, and its box in red (figure 2.11)", draw),),
    )


def _learn_and_count(trial: Trial, most: int) -> list[tuple[str, Image, Counts, dict[str, float]]]:
    """For each marker: the seed's HSV pixels; right, marked and true pixels by box; volume of each box,
    0..1.
    """
    truth = {(row.marker, row.frame_index): row for row in trial.truth}
    first = {seed.marker: seed for seed in reversed(trial.seeds)}
    wanted = {
        name: [r.frame_index for r in trial.truth if r.marker == name and r.visible == 1.0] for name in trial.markers
    }
    some = {name: set(frames[:: max(1, len(frames) // most)]) for name, frames in wanted.items()}
    learnt: dict[str, tuple[Image, Image]] = {}
    counts: dict[str, Counts] = {}
    for frame in trial.frames():
        for name in trial.markers:
            if frame.index == first[name].frame_index:
                patch = _patch(frame, first[name].circle)
                inside = disc_mask(patch, first[name].circle, 0.8)
                learnt[name] = patch.bgr[inside], disc_pixels(patch, first[name].circle, 0.8)
                counts[name] = dict.fromkeys(BOXES, (0, 0, 0))
            elif name in learnt and frame.index in some[name]:
                circle = truth[name, frame.index].circle
                assert circle is not None
                patch = _patch(frame, circle)
                true = disc_mask(patch, circle, 1.0)
                for box, mask in _masks(patch, *learnt[name]).items():
                    a, b, c = counts[name][box]
                    counts[name][box] = a + int((mask & true).sum()), b + int(mask.sum()), c + int(true.sum())
    return [(name, learnt[name][1], counts[name], _volumes(*learnt[name])) for name in learnt]


def _patch(frame: Frame, circle: Circle) -> Patch:
    return Patch(frame, Window.around(circle, _AROUND * circle.r_px))


def _smart(hsv: Image) -> dict[str, ColourBox]:
    plain = ChainConfig().colour
    return {
        "CSB, 93 %": learn_box(hsv, plain.model_copy(update={"stop": "coverage"})),
        "CSB, eq 2.26": learn_box(hsv, plain.model_copy(update={"stop": "gain"})),
    }


def _turned(hsv: Image, mean: float) -> Image:
    """HSV with the hue turned so that `mean` is at 90."""
    out = hsv.copy()
    out[..., 0] = np.rint((hsv[..., 0] - mean + 90) % 180).astype(np.uint8)
    return out


def _masks(patch: Patch, bgr: Image, hsv: Image) -> dict[str, npt.NDArray[np.bool_]]:
    smart = _smart(hsv)
    mean = smart["CSB, 93 %"].hue_mean
    seed, here = _turned(hsv, mean), _turned(patch.hsv, mean)
    return {
        "RGB box": _inside(patch.bgr, bgr),
        "HSV box": _inside(here, seed),
        **{name: box.mask(patch.hsv) > 0 for name, box in smart.items()},
    }


def _inside(image: Image, pixels: Image) -> npt.NDArray[np.bool_]:
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    return cv2.inRange(image, tuple(map(float, low)), tuple(map(float, high))) > 0


def _volumes(bgr: Image, hsv: Image) -> dict[str, float]:
    smart = _smart(hsv)
    turned = _turned(hsv, smart["CSB, 93 %"].hue_mean)
    rgb = np.ptp(bgr.astype(float), axis=0).prod() / 255**3
    plain = np.ptp(turned.astype(float), axis=0).prod() / (180 * 255 * 255)
    return {
        "RGB box": float(rgb),
        "HSV box": float(plain),
        **{name: box.volume / (180 * 255 * 255) for name, box in smart.items()},
    }
