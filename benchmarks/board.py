"""What a film of a board has to show: simulated corners, and how far off the camera is that they give.

python benchmarks/board.py

Corners of charuco:9x6:30mm at 1280x720, with 0.15 px of noise each and 0.1 px that a whole view shares; twelve films of
40 views in each row. `error` is the found focal length's root mean square error, `said` what is stated of it, both as a
share of it, `edge` how far the worst pixel of the picture's edge is beside its place. The limits are off here, so that
what they refuse is seen too.
"""

import cv2
import numpy as np

from spheremcap.analysis import board as module
from spheremcap.analysis.board import Board, Calibrated, View, solve
from spheremcap.core.camera import Camera

WIDTH, HEIGHT, FILMS, VIEWS = 1280, 720, 12, 40
CAMERA = Camera(WIDTH, HEIGHT, 1187, 1190, 645, 352, "plumb_bob", (-0.31, 0.17, 0.0005, -0.0003))
BOARD = Board.of("charuco:9x6:30mm:22mm")


def film(seed: int, *, tilt: float = 40, spread: float = 1.0, bend: float = 0.0, stretch: float = 1.0) -> list[View]:
    """Poses all over `spread` of the picture, tilted by up to `tilt` degrees; a board `bend` (m) behind at its sides,
    or printed wider by `stretch`."""
    rng = np.random.default_rng(seed)
    made: list[View] = []
    while len(made) < VIEWS:
        turn = np.eye(3)
        for axis, most in enumerate((tilt, tilt, 20)):
            turn = turn @ cv2.Rodrigues(np.eye(3)[axis] * np.radians(rng.uniform(-most, most)))[0]
        place = (rng.uniform(-0.5, 0.5, 2) * spread + 0.5) * (WIDTH, HEIGHT)
        shift = np.array([*(place - (CAMERA.cx_px, CAMERA.cy_px)) / (CAMERA.fx_px, CAMERA.fy_px), 1])
        shift *= rng.uniform(0.7, 1.2) if spread < 1 else rng.uniform(0.35, 0.8)
        own = BOARD.corners_m * (stretch, 1, 1)
        own[:, 2] = bend * (own[:, 0] / own[:, 0].max()) ** 2
        seen = CAMERA.project(own @ turn.T + shift)
        inside = ((seen > 3) & (seen < (WIDTH - 4, HEIGHT - 4))).all(axis=1)
        if inside.sum() >= 12:
            shared = np.c_[np.ones(len(seen)), (seen - (WIDTH / 2, HEIGHT / 2)) / 200] @ rng.normal(0, 0.1, (3, 2))
            seen = seen + shared + rng.normal(0, 0.15, seen.shape)
            made.append(View(len(made), BOARD.corners_m[inside], seen[inside]))
    return made


def edge_px(camera: Camera) -> float:
    """How far the worst pixel of the picture's edge is seen beside its place; infinite where it has none."""
    x, y = np.meshgrid(np.linspace(0, WIDTH - 1, 9), np.linspace(0, HEIGHT - 1, 7))
    pixels = np.stack([x.ravel(), y.ravel()], axis=1)
    apart = np.linalg.norm(camera.project(CAMERA.rays(pixels)) - pixels, axis=1)
    return float(np.nan_to_num(apart, nan=np.inf).max())


def main() -> None:
    module._LEAST_COVERED = module._LEAST_TILT_DEG = 0.0
    module._MOST_RMS = module._MOST_FOCAL_SD = 1.0
    print(f"{'':24s} error    said    edge      covered  rms      refused")
    for name, changes in (
        ("tilted by 40 degrees", {}),
        *((f"tilted by {tilt}", {"tilt": tilt}) for tilt in (20, 10, 5, 2, 0)),
        *((f"over {spread:.0%} of it", {"spread": spread}) for spread in (0.7, 0.5, 0.3, 0.1)),
        ("bent by 1 mm", {"bend": 0.001}),
        ("bent, tilted by 20", {"bend": 0.001, "tilt": 20}),
        ("0.5 % wider", {"stretch": 1.005}),
    ):
        made = [solve(film(seed, **changes), WIDTH, HEIGHT, "plumb_bob") for seed in range(FILMS)]
        found = [one for one in made if isinstance(one, Calibrated)]
        if not found:
            print(f"{name:24s} all refused: {made[0]}")
            continue
        error = np.sqrt(np.mean([(one.values["fx"] / CAMERA.fx_px - 1) ** 2 for one in found]))
        said = np.median([one.camera.focal_sd for one in found])
        edge = np.median([edge_px(one.camera) for one in found])
        covered, rms = (np.mean([getattr(one, what) for one in found]) for what in ("covered", "rms_px"))
        print(
            f"{name:24s} {error:7.3%} {said:7.3%} {edge:7.1f} px {covered:6.0%}  {rms:5.2f} px {FILMS - len(found):4d}",
            flush=True,
        )


if __name__ == "__main__":
    main()
