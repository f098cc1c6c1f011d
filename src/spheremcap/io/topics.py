"""Every topic and coordinate frame that a recording of ours has, in one place."""

from dataclasses import dataclass

LOG = "log"
SCENE = "scene"
TRANSFORMS = "tf"
REQUESTS = "requests"
OVERVIEW = "debug/overview"
MARKERS = "markers"

WORLD_FRAME = "world"


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
        """foxglove.FrameTransforms; "" when none are written."""
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
