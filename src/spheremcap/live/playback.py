"""A recording, played to viewers over a WebSocket: in real time, or as a viewer with a time bar asks."""

import math
import queue
import time
from collections.abc import Callable, Collection
from typing import Self

from foxglove.websocket import (
    ChannelView,
    Client,
    PlaybackCommand,
    PlaybackControlRequest,
    PlaybackState,
    PlaybackStatus,
)

from spheremcap.core.time import NS_PER_S
from spheremcap.errors import SourceError, UsageError
from spheremcap.io.mcap_images import McapImageSource, image_topics
from spheremcap.io.mcap_records import McapRecords, RawMessage
from spheremcap.live.server import PORT, ViewerServer

_TURN_S = 0.005
_AT_ONCE = 500
"""Messages sent before a viewer's next request is looked at; one that asks for more than goes is played slower."""


class Playback:
    """All messages of an open recording at their pace, their bytes as they are in the file.

    It plays while a viewer is subscribed, until one has used the time bar: from then on as that says. After a seek, and
    for each new subscription, the last message of a topic up to the time is sent, of video all from its last key frame
    on, so that a viewer that stands still has a picture too. Use it as a context manager around `run`. Raises
    UsageError where there is no message.
    """

    def __init__(self, records: McapRecords, port: int = PORT) -> None:
        span_ns = records.span_ns
        if span_ns is None:
            raise UsageError(f"{records.path}: has no messages: there is nothing to view")
        self._first_ns, self._last_ns = span_ns
        self._all = records.index_of_channels(records.channels)
        self._by_topic = {c.topic: records.index_of(c.topic) for c in records.channels.values()}
        self._images = _images(records)
        self._asked: queue.Queue[PlaybackControlRequest | tuple[Client, ChannelView, bool]] = queue.Queue()
        self._watched: set[tuple[int, int]] = set()  # by client and channel
        self._steered = False
        self._playing, self._speed = False, 1.0
        self._now_ns, self._next = self._first_ns, 0  # the number of the message that comes next
        self._since = 0.0
        self.server = ViewerServer(port, listener=self, span_ns=span_ns)
        schemas = {
            schema.id: self.server.register_schema(schema.name, schema.encoding, schema.data)
            for schema in records.schemas.values()
        }
        self._channels = {
            channel.id: self.server.register_channel(
                channel.topic, channel.message_encoding, schemas.get(channel.schema_id, 0)
            )
            for channel in records.channels.values()
        }

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.server.__exit__(None, None, None)

    # --- the SDK's threads call these: they only leave word, for what is sent from here may wait for them ---

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        self._asked.put((client, channel, True))

    def on_unsubscribe(self, client: Client, channel: ChannelView) -> None:
        self._asked.put((client, channel, False))

    def on_playback_control_request(self, request: PlaybackControlRequest) -> PlaybackState:
        self._asked.put(request)
        sought = request.seek_time is not None
        plays = request.playback_command == PlaybackCommand.Play
        status = PlaybackStatus.Playing if plays else PlaybackStatus.Paused
        now_ns = self._now_ns if request.seek_time is None else self._within(request.seek_time)
        return PlaybackState(status, now_ns, _speed(request.playback_speed), sought, request.request_id)

    # --- and all else is done in the thread that runs ---

    def run(self, stop: Callable[[], bool]) -> None:
        """Play until `stop` says so. Raises SourceError where the recording cannot be read."""
        while not stop():
            self._hear(_TURN_S if self._playing else 20 * _TURN_S)
            if self._playing:
                self._play()

    def _hear(self, wait_s: float) -> None:
        """Do what viewers ask for; wait so long for it."""
        new: set[str] = set()
        watched = bool(self._watched)
        try:
            asked = self._asked.get(timeout=wait_s)
            while True:
                if isinstance(asked, PlaybackControlRequest):
                    self._steered = True
                    if asked.seek_time is not None:
                        self._seek(asked.seek_time)
                        new = set(self._by_topic)
                    self._speed = _speed(asked.playback_speed)
                    self._go(asked.playback_command == PlaybackCommand.Play)
                else:
                    client, channel, comes = asked
                    (self._watched.add if comes else self._watched.discard)((client.id, channel.id))
                    new |= {channel.topic} if comes else set()
                asked = self._asked.get_nowait()
        except queue.Empty:
            pass
        if not self._steered and watched != bool(self._watched):
            if self._watched and self._next == len(self._all):
                self._seek(self._first_ns)
            self._go(bool(self._watched))
            self._tell(PlaybackStatus.Playing if self._playing else PlaybackStatus.Paused)
        if new:
            self._show(new)

    def _go(self, playing: bool) -> None:
        self._playing, self._since = playing, time.monotonic()

    def _seek(self, now_ns: int) -> None:
        self._now_ns = self._within(now_ns)
        self._next = self._all.until(self._now_ns)

    def _within(self, now_ns: int) -> int:
        return min(max(now_ns, self._first_ns), self._last_ns)

    def _play(self) -> None:
        """What has become due since the last turn."""
        now = time.monotonic()
        due_ns = self._within(self._now_ns + round((now - self._since) * self._speed * NS_PER_S))
        due, before = self._all.until(due_ns), self._next
        self._next = min(due, self._next + _AT_ONCE)
        for number in range(before, self._next):
            self._send(self._all.message(number))
        self._now_ns = due_ns if self._next == due else self._all.log_time(self._next - 1)
        self._since = now
        self.server.show_time(self._now_ns)
        if self._next == len(self._all):
            self._playing = False
            self._tell(PlaybackStatus.Ended)

    def _show(self, topics: Collection[str]) -> None:
        """What a viewer needs to see these topics as they are now."""
        shown: list[RawMessage] = []
        for topic in topics:
            index = self._by_topic[topic]
            last = index.until(self._now_ns) - 1
            first = last
            if (source := self._images.get(topic)) is not None:
                while first > 0 and not source.is_key(index.message(first)):
                    first -= 1
            shown += (index.message(number) for number in range(max(first, 0), last + 1))
        for message in sorted(shown, key=lambda message: message.log_time):
            self._send(message)
        self.server.show_time(self._now_ns)

    def _send(self, message: RawMessage) -> None:
        channel = self._channels[message.channel.id]
        self.server.add_message(channel, message.log_time, message.data, message.publish_time, message.sequence)

    def _tell(self, status: PlaybackStatus) -> None:
        self.server.show_state(PlaybackState(status, self._now_ns, self._speed, False, None))


def _images(records: McapRecords) -> dict[str, McapImageSource]:
    """Who knows the key frames of each topic with pictures; a topic whose pictures cannot be read has nobody."""
    sources = {}
    for image in image_topics(records):
        try:
            source = McapImageSource(records, image.topic)
        except SourceError:
            continue
        source.forget_first()
        sources[image.topic] = source
    return sources


def _speed(asked: float) -> float:
    return asked if math.isfinite(asked) and 0.01 <= asked <= 100 else 1.0
