"""A WebSocket server that viewers of this machine connect to. It tells them messages and takes none.

It listens on the loopback address alone, and offers no service, parameter, asset or connection graph: any page that a
browser has open may connect, and then reads messages, and what `Playback` lets it ask for, but no file and no path.
"""

from types import TracebackType
from typing import Any, Self

import foxglove
from foxglove.websocket import Capability, PlaybackState

from spheremcap.errors import UsageError, short

HOST = "127.0.0.1"
PORT = 8765
"""Where viewers look for a server first."""


class ViewerServer:
    """A `Sink` of io.mcap_log: what is added to it is sent to each viewer that has subscribed to the channel.

    Nothing waits for a viewer: of one that does not keep up the oldest messages are dropped. `port` 0 takes a free one.
    `listener` is the SDK's ServerListener; `span_ns` are the first and last log time of what is played, for a time
    bar. Raises UsageError where the port is taken.
    """

    def __init__(self, port: int = PORT, *, listener: Any = None, span_ns: tuple[int, int] | None = None) -> None:
        self._context = foxglove.Context()
        self._schemas: list[foxglove.Schema | None] = [None]  # 0 is none, as in MCAP
        self._channels: list[foxglove.Channel] = []
        try:
            self._server = foxglove.start_server(
                name="spheremcap", host=HOST, port=port, context=self._context, server_listener=listener,
                capabilities=[Capability.Time] if span_ns is not None else [], playback_time_range=span_ns,
            )  # fmt: skip
        except RuntimeError as error:
            raise UsageError(f"no server on {HOST}, port {port}: {short(error)}; choose another --port") from error
        self.address = f"ws://{HOST}:{self._server.port}"
        self.app_url = self._server.app_url() or ""
        """Foxglove's page, which connects by itself."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.stop()

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """The id of one more schema."""
        self._schemas.append(foxglove.Schema(name=name, encoding=encoding, data=data))
        return len(self._schemas) - 1

    def register_channel(
        self, topic: str, message_encoding: str, schema_id: int, metadata: dict[str, str] | None = None
    ) -> int:
        """The id of one more channel; viewers are told of it. They are not told its metadata."""
        channel = foxglove.Channel(
            topic, message_encoding=message_encoding, schema=self._schemas[schema_id], context=self._context
        )
        self._channels.append(channel)
        return len(self._channels) - 1

    def add_message(self, channel_id: int, log_time: int, data: bytes, publish_time: int, sequence: int) -> None:
        """Send a message; the protocol has no other time than the log time (ns)."""
        self._channels[channel_id].log(data, log_time=log_time)

    def add_metadata(self, name: str, data: dict[str, str]) -> None:
        """Viewers of a connection have no place for it."""

    def add_attachment(self, create_time: int, log_time: int, name: str, media_type: str, data: bytes) -> None:
        """Viewers of a connection have no place for it."""

    def show_time(self, now_ns: int) -> None:
        """Move the time bar."""
        self._server.broadcast_time(now_ns)

    def show_state(self, state: PlaybackState) -> None:
        """Tell viewers with a time bar whether it plays, and where."""
        self._server.broadcast_playback_state(state)
