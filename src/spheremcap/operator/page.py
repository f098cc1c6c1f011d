"""The page without its HTTP: what it shows of an opened session, and what it does when a person answers."""

import math
import threading
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from fractions import Fraction
from pathlib import Path
from typing import Any

from spheremcap import api
from spheremcap.core.circle import Circle
from spheremcap.core.estimate import Status
from spheremcap.core.frame import Frame
from spheremcap.core.marker import Answer, Hidden, Keep, Seed
from spheremcap.core.presets import PRESETS
from spheremcap.core.time import NS_PER_S, format_time
from spheremcap.errors import UsageError
from spheremcap.io.pictures import Pictures
from spheremcap.io.sources import FromMcap
from spheremcap.operator.answers import kind_of
from spheremcap.operator.desk import Desk
from spheremcap.operator.lanes import CODES, State, state_of
from spheremcap.operator.opened import Opened, Request
from spheremcap.operator.words import MEANING, asked, failed
from spheremcap.operator.work import Work
from spheremcap.proposals import Proposal

_MOST_STATES = 1000  # frames of which the states are given at once
_HIDDEN = State(Status.OUT_OF_VIEW.value, None, None, None, ("hidden",))

Json = dict[str, Any]


@dataclass(frozen=True)
class Trial:
    """A stretch that was tracked again from a circle, to be looked at beside what stands before either is chosen."""

    answer: Seed
    states: dict[int, State]
    before: str
    after: str


class Page:
    """An opened session as the page has it. Methods that change something may be called from several threads.

    `author` is who answers, unless the page says another.
    """

    def __init__(self, opened: Opened, author: str = "") -> None:
        self.author = author
        self.work = Work(self._news)
        self.version = 0
        """Grows with everything that is new."""
        self._changing = threading.Lock()
        self._closing = threading.Event()
        self._proposals: tuple[Proposal, ...] = ()
        self.written: Path | None = None
        """What was tracked last and is not open."""
        self._open(opened)

    def _open(self, opened: Opened) -> None:
        self.opened = opened
        self.desk = Desk(opened.pictures)
        self.trial: Trial | None = None
        self._reading: threading.Thread | None = None
        self._closing = closing = threading.Event()
        if opened.lanes is not None:
            lanes = opened.lanes

            def read() -> None:
                lanes.read(opened.path, opened.name_of, closing.is_set, self._news)

            for answer in opened.unwritten():
                self._show(answer)
            self._reading = threading.Thread(target=read, name="time line", daemon=True)
            self._reading.start()

    def close(self) -> None:
        """Stop what runs and close the file."""
        self.work.stop()
        self.work.join()
        self._close()

    def _close(self) -> None:
        self._closing.set()
        if self._reading is not None:
            self._reading.join()
        self.desk.close()
        self.opened.close()

    def _news(self) -> None:
        self.version += 1

    # --- what is shown ---

    def session(self) -> Json:
        """What is open, its markers, its camera and the files that are written."""
        opened = self.opened
        camera, metric, note = opened.camera()
        given = opened.settings.camera
        source = opened.pictures.source
        first_ns, last_ns = opened.stamp_ns(opened.first), opened.stamp_ns(opened.last)
        return {
            "name": opened.path.name,
            "kind": opened.kind,
            "first": opened.first,
            "last": opened.last,
            "width": opened.pictures.width_px,
            "height": opened.pictures.height_px,
            "start": format_time(first_ns),
            "duration_s": (last_ns - first_ns) / NS_PER_S,
            "rate": None if source.stated_rate is None else float(source.stated_rate),
            "seeds_file": opened.answers.path.name,
            "settings_file": opened.settings_path.name,
            "author": self.author,
            "markers": [{"name": m.name, "diameter_mm": round(m.diameter_m * 1000, 4)} for m in opened.markers],
            "camera": {
                "metric": metric,
                "note": note.replace("; give --camera", ""),
                "source": camera.source,
                "focal_sd": camera.focal_sd,
                "preset": given.preset,
                "given": given.given,
                "presets": list(PRESETS),
            },
            "statuses": [MEANING[Status(code)] if code else "nothing said" for code in CODES],
            "written": None if self.written is None else self.written.name,
        }

    def pulse(self) -> Json:
        """What changes by itself: the job, and the numbers by which the page knows what to ask for again."""
        opened, job = self.opened, self.work.job
        opened.answers.answers()
        return {
            "mark": f"{self.version}.{opened.answers.revision}",
            "name": opened.path.name,
            "answers": opened.answers.revision,
            "lanes": -1 if opened.lanes is None else opened.lanes.revision,
            "trial": self.trial is not None,
            "written": None if self.written is None else self.written.name,
            "job": asdict(job),
        }

    def answers(self) -> Json:
        """All answers, and which of them the recording does not have yet."""
        answers, unwritten = self.opened.answers.answers(), self.opened.unwritten()
        return {
            "revision": self.opened.answers.revision,
            "answers": [_answer_json(answer) | {"written": answer not in unwritten} for answer in answers],
            "unwritten": len(unwritten),
        }

    def lanes(self) -> Json:
        """The time line: runs of one status a marker, and the requests as far as it is known."""
        opened = self.opened
        lanes = opened.lanes
        if lanes is None:
            return {"known_to": opened.first, "revision": -1, "lanes": {}, "requests": []}
        answers = opened.answers.answers()
        return {
            "known_to": min(lanes.known_to, opened.last + 1),
            "revision": lanes.revision,
            "lanes": {marker: lane.runs() for marker, lane in lanes.by_marker.items()},
            "requests": [self._request(request, answers) for request in opened.asked()],
        }

    def _request(self, request: Request, answers: Sequence[Answer]) -> Json:
        first = request.asked
        return {
            "number": request.number,
            "marker": first.marker,
            "words": asked(first),
            "reasons": failed(first.reasons),
            "first_unverified": first.frame_index,
            "raised": first.raised_at_frame_index,
            "last_verified": request.last_verified,
            "end": request.end,
            "answered": request.answered(answers, self.opened.last),
            "at": (first.stamp_ns - self.opened.stamp_ns(self.opened.first)) / NS_PER_S,
        }

    def states(self, first: int, last: int) -> Json:
        """What stands of each marker on the frames from `first` to `last`, and the seconds since the first frame."""
        opened = self.opened
        first, last = max(first, opened.first), min(last, opened.last, first + _MOST_STATES - 1)
        frames = range(first, last + 1)
        lanes = {} if opened.lanes is None else opened.lanes.by_marker
        return {
            "first": first,
            "states": {m: [_state_json(lane.state(i)) for i in frames] for m, lane in lanes.items()},
        }

    def seconds(self, frame_index: int) -> float:
        """When a frame was taken, seconds after the first."""
        return (self.opened.stamp_ns(frame_index) - self.opened.stamp_ns(self.opened.first)) / NS_PER_S

    def frame_at(self, seconds: float) -> int:
        """The frame at so many seconds after the first."""
        if not math.isfinite(seconds):
            raise UsageError("a time is a number of seconds")
        return self.opened.frame_at(int(Fraction(max(0.0, min(seconds, 1e9))) * NS_PER_S) + 500)

    def snap(self, frame: Frame, circle: Circle, marker: str) -> api.Snap:
        """A circle as the chain would start from it; of a marker that is not listed the diameter is not known."""
        camera, metric, _ = self.opened.camera()
        sizes = {m.name: m.diameter_m for m in self.opened.markers}
        known = metric and marker in sizes
        return api.snap(
            frame, circle, self.opened.settings, camera if known else None, diameter_m=sizes.get(marker, 0.04)
        )

    # --- answers ---

    def answer(self, kind: str, marker: str, frame: int, said: Json, author: str | None = None) -> Json:
        """Save an answer of a person, with the time on the clock; on disk when this returns. Raises UsageError."""
        who = self.author if author is None else author
        now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
        if kind == "circle":
            answer: Answer = Seed(marker, frame, Circle(said["x_px"], said["y_px"], said["r_px"]), who, now)
        elif kind in ("hidden", "keep"):
            first, last = sorted((frame, said["to_frame"]))
            answer = (Hidden if kind == "hidden" else Keep)(marker, first, last, who, now)
        else:
            raise UsageError(f"an answer is a circle, hidden or keep, not {kind!r}")
        self.opened.answers.put(answer)
        self._show(answer)
        self._news()
        return self.answers() | {"saved": _answer_json(answer)}

    def take_back(self, kind: str, marker: str, frame: int) -> Json:
        """Take an answer out of the file again; what it had changed on the time line is as in the recording."""
        taken = self.opened.answers.take_back(kind, marker, frame)
        if self.trial is not None and taken == self.trial.answer:
            self.trial = None
        if self.opened.lanes is not None:
            self.opened.lanes.remove(marker, _known_by(taken))
        self._news()
        return self.answers()

    def _show(self, answer: Answer) -> None:
        """What an answer says by itself, on the time line."""
        lanes = self.opened.lanes
        if lanes is not None and isinstance(answer, Hidden):
            frames = range(answer.frame_index, answer.to_frame_index + 1)
            lanes.correct(answer.marker, _known_by(answer), dict.fromkeys(frames, _HIDDEN))

    # --- stretches ---

    def track_again(self, marker: str, frame: int) -> None:
        """Follow the circle given on a frame both ways, as a trial. Raises UsageError where there is none."""
        answer = next(
            (
                a
                for a in self.opened.answers.answers()
                if isinstance(a, Seed) and (a.marker, a.frame_index) == (marker, frame)
            ),
            None,
        )
        if answer is None:
            raise UsageError(f"no circle of {marker} was given on frame {frame}")
        if self.opened.kind != "recording":
            raise UsageError("nothing has been tracked yet: track first")
        opened = self.opened

        def run(work: Work) -> str:
            stretch = api.stretch_of(opened.path, answer, others=others, progress=work.progress, stop=work.stopping)
            if work.stopping():
                return "stopped: what stands is as it was"
            states = {r.frame_index: state_of(e) for r in stretch for e in r.estimates if e.marker == marker}
            self.trial = Trial(answer, states, stretch.before, stretch.after)
            return f"{marker} was followed on {len(states)} frames"

        others = [one for one in opened.unwritten() if one != answer]
        self.trial = None
        self.work.start(f"tracking {marker} from frame {frame}", run)

    def trial_shown(self) -> Json | None:
        """The trial beside what stands: per frame the new state and the old one."""
        trial, lanes = self.trial, self.opened.lanes
        if trial is None or lanes is None:
            return None
        lane, frames = lanes.by_marker[trial.answer.marker], sorted(trial.states)
        first, last = (frames[0], frames[-1]) if frames else (trial.answer.frame_index,) * 2
        every = range(first, last + 1)
        new = [trial.states.get(i) for i in every]
        old = [lane.state(i) for i in every]
        return {
            "answer": _answer_json(trial.answer),
            "first": first,
            "before": trial.before,
            "after": trial.after,
            "new": [_state_json(state) for state in new],
            "old": [_state_json(state) for state in old],
            "measured_new": sum(_measured(state) for state in new),
            "measured_old": sum(_measured(state) for state in old),
        }

    def accept(self) -> None:
        """Let the trial stand. Raises UsageError when there is none."""
        trial, lanes = self.trial, self.opened.lanes
        if trial is None or lanes is None:
            raise UsageError("there is nothing to accept any more")
        lanes.correct(trial.answer.marker, _known_by(trial.answer), trial.states)
        self.trial = None
        self._news()

    def discard(self) -> Json:
        """Throw the trial away, and take back the answer that it came from, which is returned."""
        trial = self.trial
        if trial is None:
            raise UsageError("there is nothing to discard any more")
        self.trial = None
        answer = trial.answer
        self.opened.answers.take_back("circle", answer.marker, answer.frame_index)
        self._news()
        return _answer_json(answer)

    # --- long jobs ---

    def track(self) -> None:
        """Track all markers through what is open, into a new recording beside it."""
        opened = self.opened
        if opened.kind == "recording":
            raise UsageError("this is tracked already: answers change parts of it")
        answers = list(opened.answers.answers())
        stem = opened.path.with_suffix("").name
        output = _free(
            opened.answers.path.with_name(f"{stem}.mcap" if opened.kind == "video" else f"{stem}.tracked.mcap")
        )

        def run(work: Work) -> str:
            inputs = [path for path in (opened.answers.path, opened.settings_path) if path.exists()]
            report = api.track(
                opened.path, output, opened.settings, answers, folder=opened.settings_path.parent, inputs=inputs,
                rate=opened.rate, mcap=FromMcap((opened.topic,)) if opened.topic is not None else None,
                progress=work.progress, stop=work.stopping,
            )  # fmt: skip
            if report.stopped:
                return f"stopped after {report.frames} frames"
            self.written = output
            return f"{report.frames} frames -> {output.name}"

        self.work.start("tracking all markers", run)

    def write(self) -> None:
        """Write what the answers change into a new recording beside the old one."""
        opened = self.opened
        if opened.kind != "recording":
            raise UsageError("nothing has been tracked yet: track first")
        answers = list(opened.answers.answers())
        output = _free(opened.path.resolve())

        def run(work: Work) -> str:
            report = api.retrack(
                opened.path, output, answers, inputs=[opened.answers.path], progress=work.progress, stop=work.stopping
            )
            if report.stopped:
                return "stopped: nothing was written"
            self.written = output
            return f"{len(report.stretches)} answer{'s' * (len(report.stretches) != 1)} -> {output.name}"

        self.work.start("writing the new recording", run)

    def open_written(self) -> None:
        """Open what was written last. Answers go on into the same file."""
        with self._changing:
            if self.written is None:
                raise UsageError("nothing new was written")
            before = self.opened
            opened = Opened(self.written, seeds=before.answers.path, settings=before.settings_path)
            self._close()
            self.written = None
            self._open(opened)
        self._news()

    def set_marker(self, name: str, diameter_m: float, was: str | None) -> None:
        """See `Opened.set_marker`."""
        self.opened.set_marker(name, diameter_m, was)
        self._news()

    def drop_marker(self, name: str) -> None:
        """See `Opened.drop_marker`."""
        self.opened.drop_marker(name)
        self._news()

    def set_preset(self, preset: str | None) -> None:
        """See `Opened.set_preset`."""
        self.opened.set_preset(preset)
        self._news()

    def set_calibration(self, text: str) -> None:
        """See `Opened.set_calibration`."""
        self.opened.set_calibration(text)
        self._news()

    def propose(self) -> None:
        """Look for coloured spheres in the first seconds; they are `proposed` when the job has ended."""
        opened = self.opened

        def first_seconds(pictures: Pictures, work: Work) -> Iterator[Frame]:
            until_ns = pictures.stamp_ns(pictures.first_index) + round(opened.settings.auto.seconds * NS_PER_S)
            last = pictures.index_at(until_ns)
            for index in range(pictures.first_index, last + 1):
                work.progress(index - pictures.first_index, last + 1 - pictures.first_index)
                frame = None if work.stopping() else pictures.frame(index)
                if frame is not None:
                    yield frame

        def run(work: Work) -> str:
            self._proposals = ()
            with opened.open_again() as own:
                camera, metric, _ = opened.camera()
                found = api.propose(first_seconds(own, work), opened.settings, camera if metric else None)
            self._proposals = tuple(found)
            count = len(self._proposals)
            return f"{count} proposed" if count else "no coloured sphere was found"

        self.work.start("looking for markers", run)

    def proposed(self) -> list[Json]:
        """What was found when it was looked for markers last."""
        return [
            {
                "frame": p.frame_index + self.opened.offset,
                "circle": list(p.circle),
                "colour": p.colour,
                "reason": p.reason,
            }
            for p in self._proposals
        ]


def _known_by(answer: Answer) -> tuple[str, int]:
    return kind_of(answer), answer.frame_index


def _free(path: Path) -> Path:
    """The path, or the same with a number, that no file has."""
    stem, number = path.with_suffix("").name, 1
    head, _, last = stem.rpartition(".")
    if path.exists() and head and last.isdigit():
        stem, number = head, int(last)
    while path.exists():
        number += 1
        path = path.with_name(f"{stem}.{number}{path.suffix}")
    return path


def _measured(state: State | None) -> bool:
    return state is not None and state.status in ("SEEDED", "VERIFIED")


def _answer_json(answer: Answer) -> Json:
    row: Json = {"kind": kind_of(answer), "marker": answer.marker, "frame": answer.frame_index}
    if isinstance(answer, Seed):
        row |= dict(zip(("x_px", "y_px", "r_px"), answer.circle, strict=True))
    else:
        row["to_frame"] = answer.to_frame_index
    return row | {"author": answer.author, "time": answer.time}


def _state_json(state: State | None) -> list[Any] | None:
    """[status code, x, y, r or None, metres, votes, reasons in words]."""
    if state is None:
        return None
    circle = None if state.circle is None else [round(v, 3) for v in state.circle]
    return [CODES.index(state.status), circle, state.distance_m, state.vote_sum, failed(state.reasons)]
