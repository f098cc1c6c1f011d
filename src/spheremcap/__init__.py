"""Track coloured sphere markers in video and write every circle, 3D pose and vote into an annotated MCAP."""

import importlib
from typing import Any

__version__ = "0.1.0"


_HOMES = {
    "api": ["RetrackReport", "TrackReport", "retrack", "stretch_of", "track"],
    "chain": ["ChainConfig", "MarkerChain"],
    "config": ["Settings", "load_seeds", "load_settings"],
    "core.camera": ["Camera"],
    "core.circle": ["Circle"],
    "core.estimate": ["FrameResult", "MarkerEstimate", "Status"],
    "core.frame": ["Frame"],
    "core.marker": ["Answer", "Hidden", "Keep", "MarkerSpec", "Seed"],
    "core.vote": ["Verdict", "Vote"],
    "errors": ["SpheremcapError"],
    "io.mcap_images": ["McapImageSource"],
    "io.mcap_log": ["McapLog", "RunInfo"],
    "io.recording": ["Recording", "open"],
    "io.sources": ["FromMcap"],
    "io.topics": ["Topics"],
    "io.video": ["VideoSource"],
    "merging.dataset": ["Source", "merge"],
    "session": ["Session"],
}
"""Where each public name is at home. It is loaded when it is first asked for: `import spheremcap` costs nothing."""

__all__ = sorted(name for names in _HOMES.values() for name in names)


def __getattr__(name: str) -> Any:
    for home, names in _HOMES.items():
        if name in names:
            found = getattr(importlib.import_module(f"{__name__}.{home}"), name)
            globals()[name] = found
            return found
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*globals(), *__all__]
