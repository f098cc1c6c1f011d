"""A short recording and a viewer that connects to it."""

import sys
from pathlib import Path

import pytest

pytest.importorskip("foxglove")
TESTS = Path(__file__).parents[1]
sys.path[:0] = [str(Path(__file__).parent), str(TESTS)]

from clips import seed, write_clip  # noqa: E402
from spheremcap import api  # noqa: E402
from spheremcap.config import Settings, parse_seed  # noqa: E402

FRAMES = 120


@pytest.fixture(scope="session")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_clip(tmp_path_factory.mktemp("clip") / "clip.mp4", FRAMES)


@pytest.fixture(scope="session")
def recording(clip: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Half a second of video at 240 pictures a second, as `track` writes it."""
    out = tmp_path_factory.mktemp("recording") / "out.mcap"
    api.track(clip, out, Settings(), [parse_seed(seed("orange"))])
    return out
