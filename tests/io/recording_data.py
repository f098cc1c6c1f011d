"""Frames as a session would give them, and small H.264 pictures, for the tests of recordings."""

import av
import numpy as np

from spheremcap.core.camera import Camera
from spheremcap.core.circle import Circle
from spheremcap.core.estimate import FrameResult, MarkerEstimate, OperatorRequest, SmoothedPose, Status
from spheremcap.core.frame import EncodedPicture, Window
from spheremcap.core.marker import MarkerSpec
from spheremcap.core.view import ResponseMap, StageView
from spheremcap.core.vote import Verdict, Vote

CAMERA = Camera(160, 120, 150.0, 151.0, 79.5, 59.5, "plumb_bob", (-0.3, 0.1, 0.0, 0.0), 0.03, "a test")
MARKERS = (MarkerSpec("left_wrist", 0.04), MarkerSpec("left_elbow", 0.05))
START_NS = 1_700_000_000_123_456_789
PERIOD_NS = 4_170_837
MATCHERS = ("ccorr", "ccorr_normed", "ccoeff", "ccoeff_normed", "sqdiff", "sqdiff_normed")

STATUSES = [
    Status.SEEDED,
    Status.VERIFIED,
    Status.VERIFIED,
    Status.ESTIMATED,
    Status.LOST,
    Status.OUT_OF_VIEW,
]


def stamp(index: int) -> int:
    return START_NS + index * PERIOD_NS


def estimate(marker: str, index: int, status: Status) -> MarkerEstimate:
    """An estimate with all that its status can have, and nothing else."""
    x, y, r = 60 + 3.3 * index, 50 + 0.7 * index, 9.25
    circle, search = Circle(x, y, r), Window(int(x) - 30, int(y) - 30, 61, 61)
    if status is Status.OUT_OF_VIEW:
        return MarkerEstimate(marker, index, stamp(index), status)
    if status is Status.LOST:
        return MarkerEstimate(marker, index, stamp(index), status, claim=circle.shifted(9, 4), search=search)
    votes = tuple(Vote(m, circle.shifted(0.3 * i, 0), 0.9 - 0.01 * i, 0.98 - 0.05 * i) for i, m in enumerate(MATCHERS))
    measured = status.measured
    return MarkerEstimate(
        marker, index, stamp(index), status,
        circle=circle, circle_sd_px=(0.02, 0.03, 0.04) if measured else None,
        claim=circle if measured else circle.shifted(2, 2), proposer="hough",
        proposals=(("hough", circle), ("colour", circle.shifted(1, 1))), search=search, votes=votes,
        vote_sum=sum(v.overlap for v in votes), verdict=Verdict.VERIFIED if measured else Verdict.DOUBTFUL,
        visible=0.9 if measured else None, xyz_cam_m=np.array([0.01 * index, 0.02, 1.5]),
        covariance_m2=np.diag([1e-6, 2e-6, 3e-5]), velocity_cam_mps=np.array([2.4, 0.0, -0.1]),
        reasons=() if measured else ("colour", "no outline"),
    )  # fmt: skip


def result(index: int, statuses: list[Status] | None = None, view: bool = False) -> FrameResult:
    """Frame `index`: by default the first marker goes through STATUSES, the second is always VERIFIED."""
    statuses = statuses or [STATUSES[index % len(STATUSES)], Status.VERIFIED]
    estimates = tuple(estimate(m.name, index, s) for m, s in zip(MARKERS, statuses, strict=False))
    smoothed = tuple(
        SmoothedPose(e.marker, index, e.stamp_ns, e.xyz_cam_m + 0.001, e.covariance_m2 / 2, e.velocity_cam_mps)
        for e in estimates
        if e.xyz_cam_m is not None and e.covariance_m2 is not None and e.velocity_cam_mps is not None
    )
    asked = tuple(
        OperatorRequest(
            e.marker, max(0, index - 1), stamp(max(0, index - 1)), index, stamp(index), "5 frames doubted", ("gate",)
        )
        for e in estimates
        if e.status is Status.LOST
    )
    return FrameResult(index, stamp(index), estimates, smoothed, asked, (stage_view(estimates[0]),) if view else ())


def stage_view(of: MarkerEstimate) -> StageView:
    circle = of.circle or of.claim or Circle(60, 50, 9)
    window = Window.around(circle, 30)
    rows, columns = np.mgrid[: window.height, : window.width]
    far = np.hypot(columns + window.x - circle.x_px, rows + window.y - circle.y_px)
    disc = np.clip(circle.r_px + 0.5 - far, 0, 1)
    patch = np.stack([70 + 20 * disc, 70 + 60 * disc, 70 + 150 * disc], axis=2).astype(np.uint8)
    angles = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    edges = np.stack([circle.x_px + circle.r_px * np.cos(angles), circle.y_px + circle.r_px * np.sin(angles)], axis=1)
    values = np.exp(-((far[:40, :40] / 12) ** 2)).astype(np.float32)
    peak = (int(values.argmax() % 40), int(values.argmax() // 40))
    responses = tuple(
        ResponseMap(m, 1 - values if "sqdiff" in m else values, "sqdiff" in m, peak, circle) for m in MATCHERS
    )
    mask = (disc > 0.5).astype(np.uint8) * 255
    hough = (circle.shifted(0.8, -0.5), circle.shifted(3, 5))
    return StageView(of.marker, window, patch, mask, hough, edges, np.linspace(0, 1, 40), responses)


def h264_pictures(count: int, width: int = 160, height: int = 120) -> list[EncodedPicture]:
    """A moving gradient in H.264 as viewers want it: Annex B, no B-frames, SPS and PPS on every IDR."""
    codec = av.CodecContext.create("libx264", "w")
    codec.width, codec.height, codec.pix_fmt, codec.thread_count = width, height, "yuv420p", 1
    codec.options = {
        "tune": "zerolatency",
        "preset": "ultrafast",
        "x264-params": "keyint=30:bframes=0:repeat-headers=1",
    }
    pictures = []
    for index in range(count):
        image = np.add.outer(np.arange(height), np.arange(width) + 3 * index).astype(np.uint8)
        frame = av.VideoFrame.from_ndarray(image, "gray8").reformat(format="yuv420p")
        frame.pts = index
        pictures += codec.encode(frame)
    pictures += codec.encode(None)
    return [EncodedPicture(bytes(p), "h264", bool(p.is_keyframe)) for p in pictures]
