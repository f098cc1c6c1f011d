"""Tracking while it is shown: the same run as `api.track`, whose messages go to the recording and to viewers."""

from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path

import numpy as np

from spheremcap import api
from spheremcap.config import Settings
from spheremcap.core.marker import Answer
from spheremcap.core.time import NS_PER_S
from spheremcap.errors import UsageError
from spheremcap.io.contents import Contents, to_come
from spheremcap.io.mcap_log import RunInfo, Sink
from spheremcap.io.source import Source
from spheremcap.io.sources import CameraView, Input, fingerprint
from spheremcap.io.topics import Topics
from spheremcap.live.server import ViewerServer
from spheremcap.live.sources import Stop, open_live
from spheremcap.positioning.sphere import sphere_of_circle
from spheremcap.stretch import base_seeds

PICTURES_HZ = 30
"""Pictures that viewers are sent at most, a second and topic; the recording has all of those that were tracked."""
_PERIOD_NS = NS_PER_S // PICTURES_HZ
_PICTURES = "foxglove.CompressedImage"


class Shown:
    """A `Sink` for both: what is added goes into the recording, and the same bytes to the viewers."""

    def __init__(self, recording: Sink, server: ViewerServer) -> None:
        self._recording, self._server = recording, server
        self._schemas: dict[int, tuple[int, str]] = {}  # the viewers' id and the name, by the recording's id
        self._channels: dict[int, int] = {}
        self._next_ns: dict[int, int] = {}  # of channels with pictures: when the next one may go to viewers

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """In both; the id is the recording's."""
        id_ = self._recording.register_schema(name, encoding, data)
        self._schemas[id_] = self._server.register_schema(name, encoding, data), name
        return id_

    def register_channel(
        self, topic: str, message_encoding: str, schema_id: int, metadata: dict[str, str] | None = None
    ) -> int:
        """In both; the id is the recording's."""
        id_ = self._recording.register_channel(topic, message_encoding, schema_id, metadata or {})
        schema, name = self._schemas[schema_id]
        self._channels[id_] = self._server.register_channel(topic, message_encoding, schema)
        if name == _PICTURES:
            self._next_ns[id_] = 0
        return id_

    def add_message(self, channel_id: int, log_time: int, data: bytes, publish_time: int, sequence: int) -> None:
        """To the recording, and to viewers unless it is a picture too many."""
        self._recording.add_message(channel_id, log_time, data, publish_time, sequence)
        if (next_ns := self._next_ns.get(channel_id)) is not None:
            if log_time < next_ns:
                return
            on_time = log_time < next_ns + _PERIOD_NS
            self._next_ns[channel_id] = (next_ns if on_time else log_time) + _PERIOD_NS
        self._server.add_message(self._channels[channel_id], log_time, data, publish_time, sequence)

    def add_metadata(self, name: str, data: dict[str, str]) -> None:
        """To the recording alone."""
        self._recording.add_metadata(name, data)

    def add_attachment(self, create_time: int, log_time: int, name: str, media_type: str, data: bytes) -> None:
        """To the recording alone."""
        self._recording.add_attachment(create_time, log_time, name, media_type, data)


def track_live(
    source: str,
    output: Path,
    settings: Settings,
    seeds: Sequence[Answer],
    server: ViewerServer,
    *,
    folder: Path = Path(),
    inputs: Sequence[Path] = (),
    overwrite: bool = False,
    start_time_ns: int | None = None,
    begins: Callable[[Contents], None] = lambda found: None,
    progress: Callable[[int, int], None] = lambda done, skipped: None,
    stop: Stop = lambda: False,
) -> api.TrackReport:
    """Track a camera, a stream or a video file in real time, until it ends or `stop` says so.

    Pictures are JPEG, and poses are smoothed by the one that follows alone, so that all is shown at once. `begins` gets
    what the recording will have before anything is tracked, for viewers to be told how to show it. `progress` gets the
    pictures that were tracked and those that were skipped. The other parameters, and what is raised, are
    those of `api.track`.
    """
    if len(base_seeds(seeds)) < len(seeds):
        raise UsageError("a live picture does not come again: give one circle a marker, and correct the recording")
    live = settings.model_copy(
        update={
            "output": settings.output.model_copy(update={"video": "jpeg"}),
            "session": settings.session.model_copy(update={"smoother_lag_frames": 1}),
        }
    )
    with closing(open_live(source, stop, {seed.frame_index for seed in seeds}, start_time_ns)) as opened:
        path = opened.path

        def shown(writer: Sink) -> Sink:
            begins(_to_come(opened, live, seeds, folder))  # all that was given is found to be right by now
            return Shown(writer, server)

        run = RunInfo(path.name, *fingerprint(path)) if path.is_file() else RunInfo(path.name)
        return api.track_input(
            Input(path, (CameraView(opened, live=True),)), run, output, live, seeds,
            folder=folder, inputs=inputs, overwrite=overwrite, sink=shown,
            progress=lambda done, total: progress(done, opened.lost.skipped),
        )  # fmt: skip


def _to_come(opened: Source, settings: Settings, seeds: Sequence[Answer], folder: Path) -> Contents:
    """What the recording will have; where markers are is where the seeds have them."""
    camera, metric, _ = api.resolve_camera(settings.camera, opened.width_px, opened.height_px, folder)
    specs = {marker.name: marker.spec() for marker in api.with_seeded_markers(settings, seeds).markers}
    given = base_seeds(seeds) if metric else []
    places = [sphere_of_circle(seed.circle, specs[seed.marker].radius_m, camera) for seed in given]
    return to_come(Topics(), tuple(specs), np.array(places).reshape(-1, 3), PICTURES_HZ)
