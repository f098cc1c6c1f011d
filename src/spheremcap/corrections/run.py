"""A run of `track` in a recording: what it was tracked with, and which answers it has."""

import itertools
import json
import tomllib
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path

from spheremcap.config import Settings, answers_in
from spheremcap.core.camera import Camera
from spheremcap.core.marker import Answer, Seed
from spheremcap.errors import SettingsError, SourceError, UsageError
from spheremcap.io.mcap_log import RUN_METADATA, run_id
from spheremcap.io.mcap_records import McapRecords
from spheremcap.io.recording import runs_of
from spheremcap.io.states import FrameStates
from spheremcap.io.topics import Topics, topics_of
from spheremcap.session import check_answers
from spheremcap.stretch import KeepView, Terms, base_seeds

ANSWERS = "answers"
"""The line of a run's metadata that says what was answered."""
SEEDS, SETTINGS = "seeds.toml", "settings.toml"
_HELD_BYTES = 4 << 20  # decompressed chunks that are kept: what is asked for lies close together
ViewKeeper = Callable[[Settings], KeepView]


def camera_fact(camera: Camera, metric: bool) -> str:
    """What a recording says of the camera that it was tracked with, to the last digit."""
    return json.dumps(asdict(camera) | {"metric": metric})


def _camera_of(fact: str) -> tuple[Camera, bool]:
    """The camera, and whether its metres may be given out. Raises ValueError, TypeError or KeyError."""
    numbers = json.loads(fact)
    metric = bool(numbers.pop("metric"))
    return Camera(**numbers | {"distortion": tuple(numbers["distortion"])}), metric


class Run:
    """One camera's run in a recording: what it was tracked with and what was found, without any answer.

    `answers` are those that the recording has now, its first circles among them. `name` goes before its markers' names
    where a recording has several cameras. `seeds_place` says which of the attachments are its seeds.
    """

    def __init__(
        self, records: McapRecords, id_: str, facts: Mapping[str, str], settings: str, seeds: str, seeds_place: int
    ) -> None:
        self.id, self.facts, self.settings_toml, self.seeds_place = id_, facts, settings, seeds_place
        self.name = facts.get("name", "")
        records_own = (r.metadata for r in records.metadata if r.name == RUN_METADATA + id_)
        self.own_facts: dict[str, str] = next(records_own, {})  # without those of its outcome
        topics = topics_of(facts)
        if topics is None or "camera" not in facts:
            raise SourceError(f"{records.path}: an earlier version wrote it: track it again, and correct that")
        self.topics: Topics = topics
        try:
            self.settings = Settings.model_validate(tomllib.loads(settings))
            self.answers = answers_in(tomllib.loads(seeds), SEEDS)
            self.camera, self.metric = _camera_of(facts["camera"])
        except (ValueError, TypeError, KeyError, SettingsError) as error:
            raise SourceError(f"{records.path}: what it says of its settings cannot be read: {error}") from error
        self.specs = tuple(marker.spec() for marker in self.settings.markers)
        self.states = FrameStates(records, topics, [spec.name for spec in self.specs])

    def terms(self, view_keeper: ViewKeeper) -> Terms:
        """How it was tracked."""
        known = self.settings.camera
        return Terms(
            self.camera, self.metric, self.specs, self.settings.chain, self.settings.session, known.exposure_s,
            known.readout_s, self.states.first_index, self.states.last_index, lambda: view_keeper(self.settings),
        )  # fmt: skip


def runs_in(records: McapRecords, ids: Collection[str] | None = None) -> list[Run]:
    """The runs of a recording, or those of these ids, by the settings and seeds that go with each.

    One that is in what was tracked again is called after where its topics are. Raises SourceError where there is none.
    """
    facts, found = runs_of(records), dict[str, Run]()
    texts = [
        (place, attachment.name, attachment.data.decode("utf-8", "replace"))
        for place, attachment in enumerate(records.attachments())
        if attachment.name in (SEEDS, SETTINGS)
    ]
    for (_, before, settings), (place, name, seeds) in itertools.pairwise(texts):
        if (before, name) != (SETTINGS, SEEDS):
            continue
        for id_, lines in facts.items():
            wanted = id_ not in found and (ids is None or id_ in ids)
            if wanted and id_ == new_id(lines, settings, seeds):
                found[id_] = Run(records, id_, lines, settings, seeds, place)
                break
    if not found:
        raise SourceError(f"{records.path}: no run of spheremcap track is in it: only what it wrote can be corrected")
    runs = list(found.values())
    if len({run.name for run in runs}) < len(runs):
        for run in runs:
            run.name = run.topics.root.strip("/")
    return runs


def new_id(facts: Mapping[str, str], settings: str, seeds: str) -> str:
    """The id that a run of these facts has with such settings and seeds."""
    given = facts.get("input_sha256") or facts.get("input_name", "")
    return run_id(facts.get("version", ""), given, settings, seeds, facts.get("name", ""))


def merged_answers(run: Run, given: Sequence[Answer]) -> list[Answer]:
    """What was given, begun by the circles that the run began with. Raises UsageError where one of them is another."""
    first = base_seeds(run.answers)
    merged = list(given)
    for seed in reversed(first):
        same = [
            a for a in merged if isinstance(a, Seed) and (a.marker, a.frame_index) == (seed.marker, seed.frame_index)
        ]
        if any(one.circle != seed.circle for one in same):
            raise UsageError(
                f"{seed.marker} was tracked from another circle on frame {seed.frame_index}: where that is to change, "
                "track it again, or give the right circle on the frame after it"
            )
        own = [a for a in merged if isinstance(a, Seed) and a.marker == seed.marker]
        if not same or own[0] is not same[0]:
            merged = [*same, *(a for a in merged if a not in same)] if same else [seed, *merged]
    return merged


def check(run: Run, answers: Sequence[Answer], path: Path) -> None:
    """Raises UsageError for answers that do not fit the recording."""
    names = [spec.name for spec in run.specs]
    check_answers(answers, names, run.camera.width_px, run.camera.height_px)
    first, last = run.states.first_index, run.states.last_index
    for answer in answers:
        end = answer.frame_index if isinstance(answer, Seed) else answer.to_frame_index
        if not first <= answer.frame_index <= end <= last:
            there = (
                f"frame {answer.frame_index}" if isinstance(answer, Seed) else f"frames {answer.frame_index} to {end}"
            )
            raise UsageError(f"{path}: seed of {answer.marker} on {there}: there are frames {first} to {last}")


@contextmanager
def opened(path: Path, ids: Collection[str] | None = None) -> Iterator[tuple[McapRecords, list[Run]]]:
    """A recording and its runs, or those of these ids. Raises SourceError for one that is damaged or not of ours."""
    with McapRecords(path, held_bytes=_HELD_BYTES) as records:
        if records.lost:
            raise SourceError(
                f"{path}: is damaged ({records.lost[0]}): make it whole first: spheremcap recover {path} -o OTHER.mcap"
            )
        yield records, runs_in(records, ids)


def by_run(runs: Sequence[Run], answers: Sequence[Answer], path: Path) -> list[list[Answer]]:
    """Each run's own answers, merged with its first circles and checked. With several runs a marker's name begins with
    its camera's. Raises UsageError."""
    own: list[list[Answer]] = [[] for _ in runs]
    for answer in answers:
        camera, _, marker = answer.marker.rpartition("/") if len(runs) > 1 else ("", "", answer.marker)
        names = [run.name if len(runs) > 1 else "" for run in runs]
        if camera not in names:
            raise UsageError(f"{path}: seed of {answer.marker!r}: which camera? There are {', '.join(names)}")
        own[names.index(camera)].append(replace(answer, marker=marker))
    merged = [merged_answers(run, some) for run, some in zip(runs, own, strict=True)]
    for run, some in zip(runs, merged, strict=True):
        check(run, some, path)
    return merged


def answered_markers(answers: Sequence[Answer]) -> list[str]:
    """The markers of which more was said than where they begin."""
    begun = base_seeds(answers)
    return list(dict.fromkeys(answer.marker for answer in answers if answer not in begun))


def named_answers(run: Run, runs: Sequence[Run]) -> list[Answer]:
    """A run's answers by the names that they have in a seeds file."""
    return [replace(a, marker=f"{run.name}/{a.marker}") for a in run.answers] if len(runs) > 1 else run.answers
