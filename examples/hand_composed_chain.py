"""The chain of one marker on frames from anywhere: no session, no files.

usage: python examples/hand_composed_chain.py

The frames here are drawn; yours may come from a camera driver: anything that makes a BGR array and a stamp will do.
"""

import cv2
import numpy as np

from spheremcap.chain import ChainConfig, MarkerChain
from spheremcap.core.camera import Camera
from spheremcap.core.circle import Circle
from spheremcap.core.frame import BgrFrame
from spheremcap.core.marker import MarkerSpec


def drawn(index: int) -> BgrFrame:
    """A green ball of 20 px radius that moves right, on noise; 240 frames a second."""
    noise = np.random.default_rng(index).integers(70, 90, (480, 640, 3), np.uint8)
    centre = (round((200 + 1.5 * index) * 16), 240 * 16)
    image = cv2.circle(noise, centre, 20 * 16, (60, 190, 70), -1, cv2.LINE_AA, shift=4)
    return BgrFrame(index, index * 1_000_000_000 // 240, cv2.GaussianBlur(image, (0, 0), 0.6))


def main() -> None:
    camera = Camera(640, 480, fx_px=600, fy_px=600, cx_px=319.5, cy_px=239.5)
    chain = MarkerChain(MarkerSpec("ball", diameter_m=0.04), camera, ChainConfig())
    estimate = chain.seed(drawn(0), Circle(200, 240, 20))
    for index in range(1, 60):
        estimate = chain.step(drawn(index))
        if index % 10 == 0 and estimate.circle is not None and estimate.xyz_cam_m is not None:
            x, y, z = estimate.xyz_cam_m
            print(
                f"frame {index:2d} {estimate.status.value:9s} centre {estimate.circle.x_px:7.2f} px "
                f"votes {estimate.vote_sum:.2f} at ({x:+.4f}, {y:+.4f}, {z:.4f}) m"
            )


if __name__ == "__main__":
    main()
