"""No seed at all: whether the markers are among what is proposed in the first seconds, and what else is."""

import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

from spheremcap.api import propose
from spheremcap.chain import MarkerChain
from spheremcap.core.camera import Camera
from spheremcap.core.frame import Frame
from spheremcap.core.marker import MarkerSpec
from spheremcap.core.time import NS_PER_S
from spheremcap.errors import UsageError
from spheremcap.evaluation.lab import Lab
from spheremcap.evaluation.metrics import VISIBLE
from spheremcap.evaluation.protocol import Trial
from spheremcap.evaluation.result import Result, Table
from spheremcap.proposals import Proposal

_SECONDS, _BEFORE_S = 3.0, 1.0
_IS_IT = 0.6  # Dice with the true circle
_LEAST_SEEN = 2  # frames on which a marker has to be seen to be asked for
_BY_HAND = 60  # rows of truth, below which it is of single frames


@dataclass(frozen=True)
class _Found:
    """Of one clip: the markers to be found, the name or "" for each proposal in their order, their scores, and the
    seconds it took."""

    markers: tuple[str, ...]
    who: tuple[str, ...]
    scores: tuple[float, ...]
    took_s: float


def proposals(lab: Lab) -> Result:
    """Whether markers are proposed without a seed: all of them, first, and what else is, on sessions and --clips."""
    trials = [*lab.trials(), *lab.clip_trials()]
    if not trials:
        raise UsageError("proposals: nothing to look at")
    heading = ["clip", "markers", "found", "first", "false", "least score of a marker", "greatest of a false one", "s"]
    cells, total = [heading], Counter[str]()
    for trial, found in zip(
        trials, lab.each(partial(_look, seconds=1.0 if lab.quick else _SECONDS), trials), strict=True
    ):
        lab.tell(f"proposals: {trial.name}")
        own = [name for name in found.who if name]
        own_scores = [score for name, score in zip(found.who, found.scores, strict=True) if name]
        other = [score for name, score in zip(found.who, found.scores, strict=True) if not name]
        first = set(found.who[: len(found.markers)]) >= set(found.markers)
        hits = len(set(own) & set(found.markers))
        cells.append(
            [
                trial.name, str(len(found.markers)), str(hits), "yes" if first else "no", str(len(other)),
                f"{min(own_scores):.2f}" if own else "-", f"{max(other):.2f}" if other else "-", f"{found.took_s:.1f}",
            ]
        )  # fmt: skip
        total.update(clips=1, markers=len(found.markers), found=hits, first=int(first), false=len(other))
    cells.append(
        [
            "all",
            str(total["markers"]),
            str(total["found"]),
            f"{total['first']} of {total['clips']}",
            str(total["false"]),
        ]
        + [""] * 3
    )
    return Result(
        "proposals",
        "No seed at all",
        "What `spheremcap track --auto` is offered: proposals from the first three seconds (where truth begins "
        "later, from a second before that on). A marker has to be found when half of it or more is visible on at least "
        "two frames. A proposal is one when at least half of its circles on frames with truth have a Dice of 0.6 or "
        "more with it; where truth is made by hand, of single frames, when a chain that starts from it is on the "
        "marker at the next of these. All others are false, among them balls that the scene shows beside its markers; "
        "so are second proposals of one marker. First: nothing else comes before the markers.",
        "spheremcap experiment proposals --clips CLIPS",
        (Table("By clip", cells),),
    )


def _look(trial: Trial, seconds: float) -> _Found:
    camera, _ = trial.camera()
    truth = {(row.marker, row.frame_index): row for row in trial.truth}
    by_hand = len(trial.truth) < _BY_HAND
    shown: list[int] = []

    def told() -> Iterator[Frame]:
        for frame in _first_seconds(trial, seconds):
            shown.append(frame.index)
            yield frame

    started = time.perf_counter()
    found = propose(told(), trial.settings, camera)
    took_s = time.perf_counter() - started
    seen = Counter(
        row.marker
        for row in trial.truth
        if row.circle is not None and row.visible >= VISIBLE and shown[0] <= row.frame_index <= shown[-1]
    )
    markers = tuple(name for name in trial.markers if seen[name] >= (1 if by_hand else _LEAST_SEEN))
    who: list[str] = []
    for proposal in found:
        names = [_tracked_to(trial, camera, proposal)] if by_hand else _on_truth(proposal, truth, trial.markers)
        name, count = Counter(names).most_common(1)[0] if names else ("", 0)
        who.append(name if name and 2 * count >= len(names) and name not in who else "")
    return _Found(markers, tuple(who), tuple(p.score for p in found), took_s)


def _on_truth(proposal: Proposal, truth: dict, markers: list[str]) -> list[str]:  # type: ignore[type-arg]
    """Whose true circle is where the proposal's is, "" for nobody's, on each of its frames that has truth."""
    names = []
    for frame_index, circle in proposal.seen:
        rows = [truth[name, frame_index] for name in markers if (name, frame_index) in truth]
        hits = [row.marker for row in rows if row.circle is not None and row.circle.dice(circle) >= _IS_IT]
        names += hits[:1] or [""] if rows else []
    return names


def _tracked_to(trial: Trial, camera: Camera, proposal: Proposal) -> str:
    """The marker that a chain from one of the proposal's circles is on at the next frame with a true circle; "" for
    none."""
    rows = {row.frame_index: row for row in trial.truth if row.circle is not None}
    ways = [(end - start, start, end, circle) for start, circle in proposal.seen for end in rows if end >= start]
    if not ways:
        return ""
    _, start, end, circle = min(ways)
    chain = MarkerChain(MarkerSpec(""), camera, trial.settings.chain, metric=False)
    estimate = None
    for frame in trial.frames():
        if frame.index >= start:
            estimate = chain.seed(frame, circle) if estimate is None else chain.step(frame)
        if frame.index == end:
            break
    true, last = rows[end].circle, None if estimate is None else estimate.circle
    return rows[end].marker if true is not None and last is not None and last.dice(true) >= _IS_IT else ""


def _first_seconds(trial: Trial, seconds: float) -> Iterator[Frame]:
    """The frames from the clip's start on, or from shortly before the first true circle."""
    begins = min(row.frame_index for row in trial.truth if row.circle is not None)
    waiting: list[Frame] = []
    end_ns = None
    for frame in trial.frames():
        if end_ns is None:
            waiting = [one for one in waiting if frame.stamp_ns - one.stamp_ns <= _BEFORE_S * NS_PER_S] + [frame]
            if frame.index >= begins:
                end_ns = waiting[0].stamp_ns + round(seconds * NS_PER_S)
                yield from waiting
        elif frame.stamp_ns >= end_ns:
            return
        else:
            yield frame
