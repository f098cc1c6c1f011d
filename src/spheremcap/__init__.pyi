"""The public names with their types; `__init__.py` loads each when it is first asked for."""

from spheremcap.api import RetrackReport as RetrackReport
from spheremcap.api import TrackReport as TrackReport
from spheremcap.api import retrack as retrack
from spheremcap.api import stretch_of as stretch_of
from spheremcap.api import track as track
from spheremcap.chain import ChainConfig as ChainConfig
from spheremcap.chain import MarkerChain as MarkerChain
from spheremcap.config import Settings as Settings
from spheremcap.config import load_seeds as load_seeds
from spheremcap.config import load_settings as load_settings
from spheremcap.core.camera import Camera as Camera
from spheremcap.core.circle import Circle as Circle
from spheremcap.core.estimate import FrameResult as FrameResult
from spheremcap.core.estimate import MarkerEstimate as MarkerEstimate
from spheremcap.core.estimate import Status as Status
from spheremcap.core.frame import Frame as Frame
from spheremcap.core.marker import Answer as Answer
from spheremcap.core.marker import Hidden as Hidden
from spheremcap.core.marker import Keep as Keep
from spheremcap.core.marker import MarkerSpec as MarkerSpec
from spheremcap.core.marker import Seed as Seed
from spheremcap.core.vote import Verdict as Verdict
from spheremcap.core.vote import Vote as Vote
from spheremcap.errors import SpheremcapError as SpheremcapError
from spheremcap.io.mcap_images import McapImageSource as McapImageSource
from spheremcap.io.mcap_log import McapLog as McapLog
from spheremcap.io.mcap_log import RunInfo as RunInfo
from spheremcap.io.recording import Recording as Recording
from spheremcap.io.recording import open as open
from spheremcap.io.sources import FromMcap as FromMcap
from spheremcap.io.topics import Topics as Topics
from spheremcap.io.video import VideoSource as VideoSource
from spheremcap.merging.dataset import Source as Source
from spheremcap.merging.dataset import merge as merge
from spheremcap.session import Session as Session

__version__: str
