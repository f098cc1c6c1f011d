"""A viewer of its own, that speaks the published protocol of Foxglove's WebSocket."""

import json
import struct
from typing import NamedTuple

from websockets.sync.client import connect


class Told(NamedTuple):
    """One message: its topic, log time (ns) and bytes."""

    topic: str
    log_time: int
    data: bytes


class State(NamedTuple):
    """What the server says of its playback: 0 plays, 1 stands, 3 has ended."""

    status: int
    now_ns: int
    speed: float
    sought: bool
    request: str


class Viewer:
    def __init__(self, address: str) -> None:
        connecting = connect(address, subprotocols=["foxglove.sdk.v1"], max_size=None, compression=None)
        self.socket = connecting.__enter__()  # closed by whoever made this
        self.info = json.loads(self.socket.recv(5))
        self.channels: dict[str, dict] = {}
        self.states: list[State] = []
        self.texts: list[dict] = []
        self._topics: dict[int, str] = {}

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.socket.close()

    def send(self, **message) -> None:
        self.socket.send(json.dumps(message))

    def subscribe(self, *topics: str) -> None:
        """To channels that have been advertised; all of them without a name."""
        new = [t for t in topics or self.channels if self.channels[t]["id"] not in self._topics]
        self._topics |= {self.channels[topic]["id"]: topic for topic in new}
        ids = [self.channels[topic]["id"] for topic in new]
        self.send(op="subscribe", subscriptions=[{"id": id_, "channelId": id_} for id_ in ids])

    def ask(self, play: bool, speed: float = 1.0, seek_ns: int | None = None, request: bytes = b"r1") -> None:
        """Use the time bar."""
        sought = struct.pack("<BQ", seek_ns is not None, seek_ns or 0)
        self.socket.send(struct.pack("<BBf", 3, not play, speed) + sought + struct.pack("<I", len(request)) + request)

    def receive(self, timeout_s: float) -> Told | State | int | None:
        """The next message, state of playback or time; None for what the server says in words, or for nothing."""
        try:
            got = self.socket.recv(timeout_s)
        except TimeoutError:
            return None
        if isinstance(got, str):
            text = json.loads(got)
            self.texts.append(text)
            if text["op"] == "advertise":
                self.channels |= {channel["topic"]: channel for channel in text["channels"]}
            return None
        if got[0] == 1:
            id_, log_time = struct.unpack_from("<IQ", got, 1)
            return Told(self._topics[id_], log_time, got[13:])
        if got[0] == 2:
            return struct.unpack_from("<Q", got, 1)[0]
        assert got[0] == 5, got[0]
        status, now_ns, speed, sought, length = struct.unpack_from("<BQfBI", got, 1)
        state = State(status, now_ns, speed, bool(sought), got[19 : 19 + length].decode())
        self.states.append(state)
        return state
