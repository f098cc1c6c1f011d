"""Make the README's picture from the demo's output: python docs/pictures.py [demo folder]"""

import sys
from pathlib import Path

import cv2
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from spheremcap.io import recording
from spheremcap.io.video import VideoSource

FRAME = 40


def main() -> None:
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "demo")
    data = recording.open(folder / "session.mcap")
    with VideoSource(folder / "session.mp4", packets=False) as source:
        picture = next(frame.full for frame in source.frames() if frame.index == FRAME)[..., ::-1]
    with (folder / "session.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        topic = "/markers/right_wrist/debug"
        messages = [decoded for *_, decoded in reader.iter_decoded_messages(topics=[topic])]
    debug = cv2.imdecode(np.frombuffer(messages[4].data, np.uint8), cv2.IMREAD_COLOR)

    figure, axes = plt.subplots(2, 2, figsize=(13, 8.2), width_ratios=[1.25, 1], layout="constrained")
    axes[0, 0].imshow(picture)
    for colour, (name, track) in zip(("#ffd000", "#00e0ff"), data.tracks.items(), strict=False):
        x, y, r = track.circle_px[FRAME]
        axes[0, 0].add_patch(plt.Circle((x, y), r, fill=False, color=colour, linewidth=2))
        axes[0, 0].plot(*track.circle_px[: FRAME + 1, :2].T, color=colour, linewidth=0.8)
        axes[0, 0].text(x + 1.4 * r, y, f"{name} {track.xyz_cam_m[FRAME, 2]:.3f} m", color=colour, fontsize=9)
        seconds = (track.stamp_ns - track.stamp_ns[0]) / 1e9
        for k, axis in enumerate("xyz"):
            axes[1, 0].plot(seconds, track.xyz_cam_m[:, k], label=f"{name} {axis}", linewidth=1)
        axes[1, 1].plot(seconds, track.vote_sum, label=name, linewidth=1, color=colour)
    axes[0, 1].imshow(debug[..., ::-1])
    axes[0, 0].set_title(f"frame {FRAME}: circles and paths")
    axes[0, 1].set_title("debug picture: what the stages saw")
    axes[1, 0].set(title="measured positions, camera frame (gaps: out of view)", xlabel="s", ylabel="m")
    axes[1, 0].legend(ncols=2, fontsize=7)
    axes[1, 1].axhline(4, color="k", linestyle=":", linewidth=1)
    axes[1, 1].set(title="sum of the six votes (verified above 4)", xlabel="s", ylim=(-0.2, 6.2))
    for axis in axes[0]:
        axis.axis("off")
    figure.savefig(Path(__file__).parent / "images" / "demo.png", dpi=90)


if __name__ == "__main__":
    main()
