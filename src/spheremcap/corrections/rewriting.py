"""What of a run's messages changes with a person's answers; all other messages are not looked at."""

from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

from spheremcap.core.estimate import MarkerEstimate, OperatorRequest, Status
from spheremcap.core.marker import Answer
from spheremcap.corrections.footage import Footage
from spheremcap.corrections.run import Run
from spheremcap.corrections.told import Request, answered, key_of, said, told_of
from spheremcap.io import _pb, messages, overlays
from spheremcap.io.annotations import Annotations
from spheremcap.io.course import Course
from spheremcap.io.join import OutMessage
from spheremcap.io.mcap_log import SEQUENCES_A_FRAME, TRAIL_NS, Scene, debug_messages, marker_messages, schema_id
from spheremcap.io.mcap_records import McapRecords, Piece, RawMessage
from spheremcap.io.messages import Message
from spheremcap.io.recording import request_of
from spheremcap.io.rewrite import ChunkWriter, same
from spheremcap.io.states import as_before, channels_before, is_answered
from spheremcap.io.topics import ANSWERED, REPLACED
from spheremcap.session import hidden_estimate
from spheremcap.stretch import Corrected, Stretch, base_seeds


class _Spans:
    """Spans of log time, both ends included."""

    def __init__(self, spans: Iterable[tuple[int, int]]) -> None:
        self._starts: list[int] = []
        self._ends: list[int] = []
        for start, end in sorted(spans):
            if self._ends and start <= self._ends[-1]:
                self._ends[-1] = max(self._ends[-1], end)
            else:
                self._starts.append(start)
                self._ends.append(end)

    def meet(self, start: int, end: int) -> bool:
        """Whether anything from `start` to `end` is in one."""
        k = bisect_right(self._starts, end) - 1
        return k >= 0 and self._ends[k] >= start


class Rewriting:
    """What of one run's messages changes: those of the base come in, those with all answers go out."""

    def __init__(
        self, run: Run, records: McapRecords, answers: Sequence[Answer], corrected: Mapping[str, Corrected],
        footage: Footage | None, writer: ChunkWriter,
    ) -> None:  # fmt: skip
        self.run, self._corrected, self._footage, self._writer = run, corrected, footage, writer
        self._topics, self._states = run.topics, run.states
        self._base = {c.topic: c for c in reversed(records.channels.values()) if not is_answered(c.metadata)}
        self._roles = self._roles_in(records)
        numbers = {spec.name: number for number, spec in enumerate(run.specs)}
        self._annotations = Annotations(numbers, (run.camera.width_px, run.camera.height_px))
        self._spans, self._scene_spans = self._changed()
        self._scene, self._scene_number = Scene(run.specs, self._topics.optical_frame), -1
        self._told = self._answered(records, answers)
        self._log = self._log_lines()
        self._sequences = Counter[int]()
        self.statuses = {name: Counter[Status]() for name in corrected}
        """By how much the numbers of frames change."""
        self.courses = {name: Course() for name in corrected}
        """What the answers have made of the frames that they changed."""

    @property
    def open_requests(self) -> int:
        """How many requests nobody has answered."""
        return sum(not text for text in self._told.values())

    def changes(self, piece: Piece) -> bool:
        """Whether anything of this run in this piece of the file becomes another."""
        if piece.channels is not None:
            ours = [self._roles[id_] for id_ in piece.channels & self._roles.keys()]
            if not ours:
                return False
            if any(role == "late" for role, _ in ours) or (
                self._corrected and any(role == "asked" for role, _ in ours)
            ):
                return True
        return self._scene_spans.meet(piece.start, piece.end)

    def rewritten(self, raw: RawMessage) -> Iterator[OutMessage] | None:
        """What a message of this run becomes; None for one of another."""
        if raw.channel.id not in self._roles:
            return None
        role, marker = self._roles[raw.channel.id]
        if role == "late":
            if is_answered(raw.channel.metadata):
                return iter(())
            channel = self._base[raw.channel.topic.removeprefix(REPLACED)]
            raw = raw._replace(channel=channel, data=as_before(raw))
            role, marker = self._roles[channel.id]
        if role == "asked":
            return self._request(raw)
        number = self._number(raw)
        if role == "frame" and number is not None:
            return self._frame(raw, number)
        if role == "scene":
            return iter([self._replaced(raw) if self._scene_spans.meet(raw.log_time, raw.log_time) else same(raw)])
        if number is None:
            return iter([same(raw)])
        index = self._states.index(number)
        if role == "overview" and any(one.at(index) is not None for one in self._corrected.values()):
            return self._overview(raw, index)
        if role == "marker" and self._corrected[marker].at(index) is not None:
            return iter([self._replaced(raw)])
        return iter([same(raw)])

    def estimates(self, number: int) -> dict[str, MarkerEstimate]:
        """The markers on a frame after all answers."""
        index = self._states.index(number)
        base, found = self._states.at(index), {}
        for spec in self.run.specs:
            name = spec.name
            stands = self._corrected[name].at(index) if name in self._corrected else None
            if isinstance(stands, Stretch):
                found[name] = stands.estimate(index)
            elif stands is None:
                if name in base:
                    found[name] = base[name]
            elif name in base or self._corrected[name].stretch_at(index) is not None:
                found[name] = hidden_estimate(stands, index, self._states.stamp_ns(number))
        return found

    # -- messages ---------------------------------------------------------------------------------------------------

    def _frame(self, raw: RawMessage, number: int) -> Iterator[OutMessage]:
        """A frame begins with its annotations; all that is new of it comes behind them."""
        topics, index, log_time, stamp = self._topics, self._states.index(number), raw.log_time, raw.publish_time
        standing = {name: one.at(index) for name, one in self._corrected.items()}
        standing = {name: stands for name, stands in standing.items() if stands is not None}
        if not standing:
            yield same(raw)
            yield from self._scene_of(number, log_time, stamp)
            return
        after, base = self.estimates(number), self._states.at(index)
        yield self._replaced(raw)
        drawn = self._annotations.of(stamp, after.values())
        yield self._new(topics.annotations, index, log_time, stamp, drawn)
        results = {name: stands[index] for name, stands in standing.items() if isinstance(stands, Stretch)}
        for name in (name for name in standing if name in after):
            poses = results[name].smoothed if name in results else ()
            for topic, message in marker_messages(after[name], next(iter(poses), None), topics):
                yield self._new(topic, index, log_time, stamp, message)
            self.statuses[name][after[name].status] += 1
            self.courses[name].add(index, after[name].status.value)
            if name in base:
                self.statuses[name][base[name].status] -= 1
        yield from self._scene_of(number, log_time, stamp)
        for result in results.values():
            for request in result.requests:
                known = replace(request, answered=self._told.get(key_of(request), ""))
                yield self._new(topics.requests, index, log_time, stamp, messages.request(known))
            for topic, message in debug_messages(result, topics):
                yield self._new(topic, index, log_time, stamp, message)
        for text in self._log.get(index, ()):
            yield self._new(topics.log, index, log_time, stamp, messages.log(stamp, "INFO", text))

    def _scene_of(self, number: int, log_time: int, stamp_ns: int) -> Iterator[OutMessage]:
        """All markers in space, where a path of theirs has changed; what was a second before is followed too."""
        if not self._scene_spans.meet(log_time, log_time):
            return
        states = self._states
        if number != self._scene_number + 1 or self._scene_number < 0:
            self._scene = Scene(self.run.specs, self._topics.optical_frame)
            first = states.numbers_from(states.log_time(number) - TRAIL_NS)
            for before in range(first, number):
                self._scene.after(states.stamp_ns(before), self.estimates(before).values())
        self._scene_number = number
        scene = self._scene.after(stamp_ns, self.estimates(number).values())
        if scene is not None:
            yield self._new(self._topics.scene, states.index(number), log_time, stamp_ns, scene)

    def _request(self, raw: RawMessage) -> Iterator[OutMessage]:
        request = request_of(raw)
        text = self._told.get(key_of(request), "")
        if not text:
            yield same(raw)
            return
        yield self._replaced(raw)
        message = messages.request(replace(request, answered=text))
        yield self._new(raw.channel.topic, request.raised_at_frame_index, raw.log_time, raw.publish_time, message)

    def _overview(self, raw: RawMessage, index: int) -> Iterator[OutMessage]:
        frame = None if self._footage is None else self._footage.at(index)
        number = self._states.number(index)
        yield self._replaced(raw)
        if frame is not None and number is not None:
            step = overlays.overview_step(frame.width_px)
            drawn = overlays.overview_picture(frame.reduced(step), step, self.estimates(number).values())
            message = messages.image(raw.publish_time, drawn, self._topics.debug_frame)
            yield self._new(raw.channel.topic, index, raw.log_time, raw.publish_time, message)

    def _new(self, topic: str, index: int, log_time: int, stamp_ns: int, message: Message) -> OutMessage:
        """A message of frame `index` that rests on an answer, on a channel of its own."""
        writer = self._writer
        channel = writer.register_channel(topic, "protobuf", schema_id(writer, type(message)), dict(ANSWERED))
        behind_others = SEQUENCES_A_FRAME * index + SEQUENCES_A_FRAME // 2
        self._sequences[channel] = max(self._sequences[channel], behind_others) + 1
        return OutMessage(log_time, stamp_ns, self._sequences[channel], channel, message.SerializeToString())

    def _replaced(self, raw: RawMessage) -> OutMessage:
        """A message that an answer has put others in the place of: it is kept beside them."""
        writer, message = self._writer, _pb.Replaced(data=raw.data)
        channel = writer.register_channel(REPLACED + raw.channel.topic, "protobuf", schema_id(writer, type(message)))
        return OutMessage(raw.log_time, raw.publish_time, raw.sequence, channel, message.SerializeToString())

    def _number(self, raw: RawMessage) -> int | None:
        """The number of the frame that a message is of; None for one that is of none."""
        there = [n for n in self._states.numbers_at(raw.log_time) if n < self._states.count]
        if len(there) > 1:  # times did not rise: the frame's own stamp tells them apart
            there = [n for n in there if self._states.stamp_ns(n) == raw.publish_time] or there
        return there[0] if there else None

    # -- what changes -----------------------------------------------------------------------------------------------

    def _roles_in(self, records: McapRecords) -> dict[int, tuple[str, str]]:
        """What each channel of this run is for, and for which marker; "late" is what answers have put there."""
        t = self._topics
        roles = {t.annotations: ("frame", ""), t.scene: ("scene", ""), t.requests: ("asked", ""),
                 t.overview: ("overview", "")}  # fmt: skip
        for spec in self.run.specs:
            role = ("marker" if spec.name in self._corrected else "other", spec.name)
            mine = (t.state, t.votes, t.pose, t.smoothed, t.debug)
            roles |= {topic(spec.name): role for topic in mine}
        found = {}
        for channel in records.channels.values():
            if channel.topic.startswith(f"{REPLACED}/"):
                if channel.topic.removeprefix(REPLACED) in {*roles, t.log}:
                    found[channel.id] = ("late", "")
            elif is_answered(channel.metadata) and channel.topic in {*roles, t.log}:
                found[channel.id] = ("late", "")
            elif channel.topic in roles:
                found[channel.id] = roles[channel.topic]
        return found

    def _changed(self) -> tuple[_Spans, _Spans]:
        """When frames change, and when the scene does, where paths are drawn for a while."""
        states, ranges = self._states, list[tuple[int, int]]()
        for one in self._corrected.values():
            spans = [(hidden.frame_index, hidden.to_frame_index) for hidden in one.hidden]
            spans += [(stretch.frames[0], stretch.frames[-1]) for stretch in one.stretches if len(stretch)]
            for first, last in spans:
                start, end = states.next_number(first), states.next_number(last + 1) - 1
                if start <= end:
                    ranges.append((states.log_time(start), states.log_time(end)))
        trail_ns = TRAIL_NS if self.run.metric else 0
        return _Spans(ranges), _Spans((start, end + trail_ns) for start, end in ranges)

    def _answered(self, records: McapRecords, answers: Sequence[Answer]) -> dict[Request, str]:
        """What was said to each request of the run, "" to those that are open."""
        ids = set(channels_before(records, self._topics.requests))
        topics = {self._topics.requests, REPLACED + self._topics.requests}
        asked: dict[str, list[OperatorRequest]] = {spec.name: [] for spec in self.run.specs}
        for raw in records.messages(topics) if ids else ():
            if raw.channel.id in ids:
                request = request_of(raw._replace(data=as_before(raw)))
                asked.setdefault(request.marker, []).append(request)
        told: dict[Request, str] = {}
        begun = base_seeds(answers)
        for name, requests in asked.items():
            one = self._corrected.get(name)
            if one is None:
                told |= {key_of(request): "" for request in requests}
                continue
            own = [answer for answer in answers if answer.marker == name and answer not in begun]
            raised = [*requests, *(request for stretch in one.stretches for request in stretch.requests)]
            told |= answered(raised, one, own, self._lost_before(name))
        return told

    def _lost_before(self, marker: str) -> Callable[[int], bool]:
        """Whether the marker was LOST on the frame before one, after all answers."""

        def lost(frame_index: int) -> bool:
            number = self._states.next_number(frame_index) - 1
            estimate = self.estimates(number).get(marker) if number >= 0 else None
            return estimate is not None and estimate.status is Status.LOST

        return lost

    def _log_lines(self) -> dict[int, list[str]]:
        """What the log says, by the frame on which it says so: the first of each stretch and of what is hidden."""
        lines: dict[int, list[str]] = {}
        for one in self._corrected.values():
            for hidden in one.hidden:
                first = max(hidden.frame_index, self._states.first_index)
                lines.setdefault(first, []).append(f"{one.marker}: {said(hidden)}")
            for stretch in one.stretches:
                if len(stretch):
                    lines.setdefault(stretch.frames[0], []).append(told_of(stretch))
        return lines
