"""The page without its HTTP: what it shows of an opened session, and what it does when a person answers."""

import math
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, InvalidStateError
from contextlib import suppress
from dataclasses import asdict
from datetime import UTC, datetime
from fractions import Fraction
from pathlib import Path
from typing import Any

from spheremcap import api
from spheremcap.api import Asked
from spheremcap.core.chair import CLICKED, RIM_POINTS, RIMS, ChairClick
from spheremcap.core.circle import Circle
from spheremcap.core.estimate import Status
from spheremcap.core.frame import Frame
from spheremcap.core.marker import Answer, Hidden, Keep, Seed
from spheremcap.core.presets import PRESETS
from spheremcap.core.time import NS_PER_S, format_time
from spheremcap.detection.hues import GREYS, HUES_MEANT
from spheremcap.errors import UsageError
from spheremcap.io.course import STATUSES
from spheremcap.io.pictures import Pictures
from spheremcap.io.sources import FromMcap
from spheremcap.operator.answers import kind_of
from spheremcap.operator.chair import fit_rim
from spheremcap.operator.desk import Desk
from spheremcap.operator.lanes import HiddenLayer, State, StretchLayer
from spheremcap.operator.opened import Opened, Request
from spheremcap.operator.words import CLICKED_ON, MEANING, failed, rim_said
from spheremcap.operator.words import asked as asked_words
from spheremcap.operator.work import Work, give_back
from spheremcap.proposals import Proposal
from spheremcap.stretch import Stretch

_MOST_STATES = 1000  # frames of which the states are given at once

Json = dict[str, Any]


class Page:
    """An opened session as the page has it. Methods that change something may be called from several threads.

    `author` is who answers, unless the page says another.
    """

    def __init__(self, opened: Opened, author: str = "") -> None:
        self.author = author
        self.work = Work(self._news)
        self.question: Asked | None = None
        self._questions = 0
        self._reply: Future[list[Answer]] = Future()
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
        self.trial: StretchLayer | None = None
        """A stretch that was tracked again, to be looked at beside what stands before either is chosen."""
        self._accepted: dict[Seed, Stretch] = {}
        self._reading: threading.Thread | None = None
        self._closing = closing = threading.Event()
        if opened.lanes is not None:
            for answer in opened.unwritten():
                self._show(answer)
            read = opened.lanes.read
            self._reading = threading.Thread(
                target=read, args=(closing.is_set, self._news), name="time line", daemon=True
            )
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
            "shows": self._shows(),
            "cameras": list(opened.cameras),
            "camera_name": opened.camera_name,
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
            "chair_file": None if opened.chair is None else opened.chair.path.name,
            "clicked": [{"on": on, "name": CLICKED_ON[on][0], "what": CLICKED_ON[on][1]} for on in CLICKED],
            "author": self.author,
            "markers": [
                {"name": m.name, "diameter_mm": round(m.diameter_m * 1000, 4), "colour": m.colour}
                for m in opened.markers
            ],
            "colours": [*HUES_MEANT, *GREYS],
            "camera": {
                "metric": metric,
                "note": note.replace("; give --camera", ""),
                "source": camera.source,
                "focal_sd": camera.focal_sd,
                "preset": given.preset,
                "given": given.given,
                "presets": list(PRESETS),
            },
            "statuses": [MEANING[Status(code)] if code else "nothing said" for code in STATUSES],
            "written": None if self.written is None else self.written.name,
        }

    def _shows(self) -> str:
        """What is open, by which the page knows that it is another."""
        return f"{self.opened.path.name} {self.opened.camera_name}"

    def pulse(self) -> Json:
        """What changes by itself: the job, and the numbers by which the page knows what to ask for again."""
        opened, job = self.opened, self.work.job
        opened.answers.answers()
        if opened.chair is not None:
            opened.chair.clicks()
        chair = -1 if opened.chair is None else opened.chair.revision
        return {
            "mark": f"{self.version}.{opened.answers.revision}.{chair}",
            "shows": self._shows(),
            "answers": opened.answers.revision,
            "chair": chair,
            "lanes": -1 if opened.lanes is None else opened.lanes.revision,
            "trial": self.trial is not None,
            "asked": self._questions if self.question is not None else 0,
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
            asked = [] if self.question is None else [_question_json(self.question)]
            return {"known_to": opened.first, "revision": -1, "lanes": {}, "requests": asked}
        answers = opened.answers.answers()
        return {
            "known_to": min(lanes.known_to, opened.last + 1),
            "revision": lanes.revision,
            "lanes": {marker: course.runs() for marker, course in lanes.courses().items()},
            "requests": [self._request(request, answers) for request in opened.asked(self._accepted.values())],
        }

    def _request(self, request: Request, answers: Sequence[Answer]) -> Json:
        first = request.asked
        return {
            "number": request.number,
            "marker": first.marker,
            "words": asked_words(first),
            "reasons": failed(first.reasons),
            "first_unverified": first.frame_index,
            "raised": first.raised_at_frame_index,
            "last_verified": request.last_verified,
            "end": request.end,
            "answered": request.answered(answers, self.opened.last),
            "at": (first.stamp_ns - self.opened.stamp_ns(self.opened.first)) / NS_PER_S,
        }

    def states(self, first: int, last: int) -> Json:
        """What stands of each marker on the frames from `first` to `last`, and what the trial would put there."""
        opened, trial = self.opened, self.trial
        first, last = max(first, opened.first), min(last, opened.last, first + _MOST_STATES - 1)
        lanes = {} if opened.lanes is None else opened.lanes.by_marker
        found: Json = {
            "first": first,
            "states": {m: list(map(_state_json, lane.states(first, last))) for m, lane in lanes.items()},
        }
        if trial is not None:
            new = [_state_json(trial.state(i)) if i in trial.stretch else None for i in range(first, last + 1)]
            found["trial"] = new if any(new) else None
        return found

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
        question = self.question
        if question is not None:
            question.check([answer])
        self.opened.answers.put(answer)
        self._show(answer)
        if question is not None and answer.marker == question.request.marker:
            self._answer_question([answer])
        self._news()
        return self.answers() | {"saved": _answer_json(answer)}

    def take_back(self, kind: str, marker: str, frame: int) -> Json:
        """Take an answer out of the file again; what it had changed on the time line is as in the recording."""
        taken = self.opened.answers.take_back(kind, marker, frame)
        if self.trial is not None and taken == self.trial.stretch.answer:
            self.trial = None
        if self.opened.lanes is not None:
            self.opened.lanes.remove(marker, _known_by(taken))
        if isinstance(taken, Seed):
            self._accepted.pop(taken, None)
        self._news()
        return self.answers()

    def _show(self, answer: Answer) -> None:
        """What an answer says by itself, on the time line."""
        lanes = self.opened.lanes
        if lanes is not None and isinstance(answer, Hidden):
            lanes.correct(answer.marker, _known_by(answer), HiddenLayer(answer.frame_index, answer.to_frame_index))

    # --- the chair ---

    def chair(self) -> Json:
        """The clicks on the chair, and how the points of each rim lie on an ellipse: `off_px` of a click is None where
        nothing can be said of it, `outline` is the ellipse in the picture."""
        opened = self.opened
        clicks = () if opened.chair is None else opened.chair.clicks()
        rows: list[Json] = [
            {"on": c.on, "frame": c.frame_index, "x_px": c.x_px, "y_px": c.y_px, "off_px": None, "doubted": False}
            for c in clicks
        ]
        rims = {}
        for rim in RIMS:
            numbers = [k for k, click in enumerate(clicks) if click.on == rim]
            fit = fit_rim([clicks[k] for k in numbers], opened.camera()[0])
            if fit is not None and len(numbers) > RIM_POINTS:
                for place, k in enumerate(numbers):
                    rows[k] |= {"off_px": round(fit.off_px[place], 2), "doubted": place == fit.doubted}
            rims[rim] = {
                "count": len(numbers),
                "said": rim_said(len(numbers), fit),
                "rms_px": None if fit is None or len(numbers) <= RIM_POINTS else round(fit.rms_px, 3),
                "outline": [] if fit is None else fit.outline.round(2).tolist(),
            }
        return {"revision": -1 if opened.chair is None else opened.chair.revision, "clicks": rows, "rims": rims}

    def click(self, was: ChairClick | None, now: ChairClick | None) -> Json:
        """Put a click on the chair in the place of another, or (None) of none, or none in its place; on disk when this
        returns. Raises UsageError."""
        if was is None and now is None:
            raise UsageError("a click is added, moved or taken out: neither was given")
        self.opened.click(was, now)
        self._news()
        return self.chair()

    # --- a run that waits ---

    def put(self, question: Asked) -> Future[list[Answer]]:
        """Ask the person about a marker of a run that is going on; what comes is the answer, or none for later."""
        self._reply = Future()
        self.question = question
        self._questions += 1
        self._news()
        return self._reply

    def later(self) -> None:
        """Leave the question open. Raises UsageError when there is none."""
        if self.question is None:
            raise UsageError("nothing is asked just now")
        self._answer_question([])
        self._news()

    def _answer_question(self, answers: list[Answer]) -> None:
        self.question = None
        with suppress(InvalidStateError):  # the run has ended meanwhile
            self._reply.set_result(answers)

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
            stretch = api.stretch_of(
                opened.path, opened.named(answer), others=others, progress=work.progress, stop=work.stopping
            )
            if work.stopping():
                return "stopped: what stands is as it was"
            self.trial = StretchLayer(stretch)
            return f"{marker} was followed on {len(stretch)} frames"

        others = [opened.named(one) for one in opened.unwritten() if one != answer]
        self.trial = None
        self.work.start(f"tracking {marker} from frame {frame}", run)

    def trial_shown(self) -> Json | None:
        """What the trial would change, in numbers; its states are among `states`."""
        trial, lanes = self.trial, self.opened.lanes
        if trial is None or lanes is None:
            return None
        stretch = trial.stretch
        frames = stretch.frames or (stretch.answer.frame_index,)
        first, last = frames[0], frames[-1]
        return {
            "answer": _answer_json(stretch.answer),
            "first": first,
            "last": last,
            "before": stretch.before,
            "after": stretch.after,
            "runs": trial.course.runs(),
            "measured_new": trial.course.measured_on(first, last),
            "measured_old": lanes.by_marker[stretch.marker].course.measured_on(first, last),
        }

    def accept(self) -> None:
        """Let the trial stand. Raises UsageError when there is none."""
        trial, lanes = self.trial, self.opened.lanes
        if trial is None or lanes is None:
            raise UsageError("there is nothing to accept any more")
        stretch = trial.stretch
        lanes.correct(stretch.marker, _known_by(stretch.answer), trial)
        self._accepted[stretch.answer] = stretch
        self.trial = None
        self._news()

    def discard(self) -> Json:
        """Throw the trial away, and take back the answer that it came from, which is returned."""
        trial = self.trial
        if trial is None:
            raise UsageError("there is nothing to discard any more")
        self.trial = None
        answer = trial.stretch.answer
        self.opened.answers.take_back("circle", answer.marker, answer.frame_index)
        self._news()
        return _answer_json(answer)

    # --- long jobs ---

    def track(self) -> None:
        """Track all markers through what is open, into a new recording beside it."""
        opened = self.opened
        if opened.kind in ("recording", "attended"):
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
            return f"Tracked {report.frames} frames into {output.name}, with {_counted(report.requests, 'request')}"

        self.work.start("tracking all markers", run)

    def write(self) -> None:
        """Write what the answers change into a new recording beside the old one."""
        opened = self.opened
        if opened.kind != "recording":
            raise UsageError("nothing has been tracked yet: track first")
        answers = list(opened.answers.everything())
        output = _free(opened.path.resolve())

        def run(work: Work) -> str:
            report = api.retrack(
                opened.path, output, answers, inputs=[opened.answers.path], progress=work.progress, stop=work.stopping
            )
            if report.stopped:
                return "stopped: nothing was written"
            self.written = output
            return f"Wrote {output.name} with {_counted(len(report.stretches), 'answer')}"

        self.work.start("writing the new recording", run)

    def open_written(self) -> None:
        """Open what was written last. Answers go on into the same file."""
        with self._changing:
            if self.written is None:
                raise UsageError("nothing new was written")
            self._open_instead(self.written, self.opened.camera_name or None)
            self.written = None
        self._news()

    def choose_camera(self, name: str) -> None:
        """Show another camera of the recording. Raises UsageError where it has none of that name."""
        with self._changing:
            self._open_instead(self.opened.path, name)
        self._news()

    def _open_instead(self, path: Path, camera: str | None) -> None:
        before = self.opened
        if self.work.job.ended == "":
            raise UsageError(f"wait until this has ended, or stop it: {self.work.job.name}")
        opened = Opened(path, seeds=before.answers.path, settings=before.settings_path, camera=camera)
        self._close()
        self._open(opened)
        del before
        give_back()

    def set_marker(
        self, name: str, diameter_m: float, was: str | None, colour: str | Sequence[float] | None = None
    ) -> None:
        """See `Opened.set_marker`."""
        self.opened.set_marker(name, diameter_m, was, colour)
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


def _counted(number: int, what: str) -> str:
    return f"{number} {what}{'s' * (number != 1)}"


def _question_json(asked: Asked) -> Json:
    """A question of a run, as a request."""
    request, last = asked.request, asked.last_measured
    return {
        "number": 0,
        "marker": request.marker,
        "words": asked_words(request),
        "reasons": failed(request.reasons),
        "first_unverified": request.frame_index,
        "raised": request.raised_at_frame_index,
        "last_verified": None if last is None else last.frame_index,
        "end": None,
        "answered": False,
        "circle": None if last is None or last.circle is None else list(last.circle),
    }


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
    return [STATUSES.index(state.status), circle, state.distance_m, state.vote_sum, failed(state.reasons)]
