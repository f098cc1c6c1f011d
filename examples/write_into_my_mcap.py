"""Add our channels to a recording that your own pipeline has open: `python write_into_my_mcap.py out.mcap`.

The writer stays yours: you start it, you write your own messages, you finish it. McapLog registers its
schemas and channels in it and adds messages; the frames may come from anywhere, here from a formula.
"""

import json
import math
import sys

import cv2
import numpy as np
from mcap.writer import Writer

from spheremcap.core.camera import Camera
from spheremcap.core.circle import Circle
from spheremcap.core.estimate import FrameResult, MarkerEstimate, Status
from spheremcap.core.frame import EncodedPicture
from spheremcap.core.marker import MarkerSpec
from spheremcap.io.mcap_log import McapLog
from spheremcap.io.topics import Topics

PERIOD_NS = 4_166_667
CAMERA = Camera(640, 360, 575.0, 575.0, 319.5, 179.5)
MARKER = MarkerSpec("wrist", diameter_m=0.04)


def frame(index: int) -> FrameResult:
    """What your own tracker says of frame `index`; what it does not know stays None."""
    xyz = np.array([0.2 * math.cos(index / 40), 0.2 * math.sin(index / 40), 1.5])
    x_px, y_px = CAMERA.project(xyz[None])[0].tolist()
    circle = Circle(x_px, y_px, CAMERA.fx_px * MARKER.radius_m / xyz[2])
    stamp_ns = index * PERIOD_NS
    estimate = MarkerEstimate(MARKER.name, index, stamp_ns, Status.VERIFIED, circle=circle, xyz_cam_m=xyz)
    return FrameResult(index, stamp_ns, (estimate,))


def picture(circle: Circle) -> EncodedPicture:
    """Your own picture of the frame; None instead when the recording has it already."""
    image = np.full((CAMERA.height_px, CAMERA.width_px, 3), 80, np.uint8)
    cv2.circle(image, (round(circle.x_px), round(circle.y_px)), round(circle.r_px), (60, 60, 220), -1, cv2.LINE_AA)
    return EncodedPicture(cv2.imencode(".jpg", image)[1].tobytes(), "jpeg", key=True)


def main(path: str) -> None:
    writer = Writer(path)
    writer.start(library="my pipeline")
    mine = writer.register_channel("/my/heartbeat", "json", schema_id=0)
    with McapLog(writer, camera=CAMERA, markers=[MARKER], topics=Topics(camera="/front", root="/front")) as log:
        log.log("INFO", "markers by spheremcap", 0)
        for index in range(240):
            stamp_ns = index * PERIOD_NS
            writer.add_message(mine, stamp_ns, json.dumps({"beat": index}).encode(), stamp_ns, index)
            result = frame(index)
            log.write(result, picture(result.estimates[0].circle))
    writer.finish()


if __name__ == "__main__":
    main(sys.argv[1])
