"""Every topic and coordinate frame that a recording of ours has, in one place."""

from collections.abc import Mapping
from dataclasses import dataclass

from spheremcap.io.messages import OPTICAL_IN_CAMERA, UPRIGHT, Fields

LOG = "log"
SCENE = "scene"
TRANSFORMS = "tf"
REQUESTS = "requests"
OVERVIEW = "debug/overview"
MARKERS = "markers"

WORLD_FRAME = "world"

REPLACED = "/replaced"
"""What goes before a topic whose messages a person's answers have put others in the place of."""
ANSWERED = {"made_by": "answers"}
"""The metadata of a channel whose messages rest on what a person answered; the topic's own channel has the others."""


@dataclass(frozen=True, slots=True)
class Topics:
    """The names of one camera's topics.

    `camera` is the prefix that picture, calibration and annotations share, by which viewers pair them.
    `root` goes before all other topics: give a second camera in the same recording another `camera` and
    another `root` (`Topics("/left", "/left")`), or its markers would mix with the first one's.
    """

    camera: str = "/camera"
    root: str = ""

    @property
    def video(self) -> str:
        """foxglove.CompressedVideo."""
        return f"{self.camera}/video"

    @property
    def image(self) -> str:
        """foxglove.CompressedImage, when the pictures are JPEG."""
        return f"{self.camera}/image"

    @property
    def calibration(self) -> str:
        """foxglove.CameraCalibration."""
        return f"{self.camera}/calibration"

    @property
    def annotations(self) -> str:
        """foxglove.ImageAnnotations."""
        return f"{self.camera}/annotations"

    @property
    def scene(self) -> str:
        """foxglove.SceneUpdate."""
        return f"{self.root}/{SCENE}"

    @property
    def transforms(self) -> str:
        """foxglove.FrameTransforms."""
        return f"{self.root}/{TRANSFORMS}"

    @property
    def log(self) -> str:
        """foxglove.Log."""
        return f"{self.root}/{LOG}"

    @property
    def requests(self) -> str:
        """spheremcap.OperatorRequest."""
        return f"{self.root}/{REQUESTS}"

    @property
    def overview(self) -> str:
        """foxglove.CompressedImage: whole pictures, reduced, with the circles burnt in."""
        return f"{self.root}/{OVERVIEW}"

    def pose(self, marker: str) -> str:
        """foxglove.PoseInFrame: measured positions only (SEEDED and VERIFIED)."""
        return f"{self.root}/{MARKERS}/{marker}/pose"

    def smoothed(self, marker: str) -> str:
        """foxglove.PoseInFrame: after the fixed-lag smoother, bridged frames included."""
        return f"{self.root}/{MARKERS}/{marker}/smoothed"

    def state(self, marker: str) -> str:
        """spheremcap.MarkerState, one message a frame whatever the status is."""
        return f"{self.root}/{MARKERS}/{marker}/state"

    def votes(self, marker: str) -> str:
        """spheremcap.MarkerVotes, on every frame on which the matchers searched."""
        return f"{self.root}/{MARKERS}/{marker}/votes"

    def debug(self, marker: str) -> str:
        """foxglove.CompressedImage: what the stages saw."""
        return f"{self.root}/{MARKERS}/{marker}/debug"

    @property
    def camera_frame(self) -> str:
        """The camera's body: x forward, y left, z up."""
        return self.camera.strip("/")

    @property
    def optical_frame(self) -> str:
        """The camera's optical frame: x right, y down, z forward; all our poses are in it."""
        return f"{self.camera_frame}_optical"

    @property
    def debug_frame(self) -> str:
        """The frame of the debug pictures, so that viewers take none of them for what the camera sees."""
        return f"{self.optical_frame}_debug"

    def edges(self) -> tuple[tuple[str, str, Fields], ...]:
        """Which frame stands in which, and how it is turned. The camera stands at the world's origin, for nothing is
        known of where it really is."""
        return (
            (WORLD_FRAME, self.camera_frame, UPRIGHT),
            (self.camera_frame, self.optical_frame, OPTICAL_IN_CAMERA),
            (self.optical_frame, self.debug_frame, UPRIGHT),
        )

    def facts(self) -> dict[str, str]:
        """What a recording says of its topics, so that they are found again: see `topics_of`."""
        return {
            "topics.camera": self.camera,
            "topics.root": self.root,
            "topics.tf": self.transforms,
            "topics.frame_id": self.optical_frame,
        }


@dataclass(frozen=True)
class TopicsBeside(Topics):
    """Topics beside those of the input: /tf is often taken, and the camera's coordinate frame is the input's where
    it has one; where that stands is then the input's to say.
    """

    tf: str = ""
    frame_id: str = ""

    @property
    def transforms(self) -> str:
        return self.tf

    @property
    def optical_frame(self) -> str:
        return self.frame_id or f"{self.camera_frame}_optical"

    def edges(self) -> tuple[tuple[str, str, Fields], ...]:
        edges = super().edges()
        return edges[-1:] if self.frame_id else edges


def topics_of(facts: Mapping[str, str]) -> Topics | None:
    """The topics of a run by what the recording says of it; None where it does not."""
    if "topics.camera" not in facts:
        return None
    return TopicsBeside(*(facts.get(f"topics.{name}", "") for name in ("camera", "root", "tf", "frame_id")))
