"""Answers, stretches and requests in words, and which answer is to which request."""

from collections.abc import Callable, Sequence

from spheremcap.core.estimate import MarkerEstimate, OperatorRequest
from spheremcap.core.marker import Answer, Hidden, Keep, Seed
from spheremcap.stretch import Corrected, Stretch

HOW_TO_ANSWER = (
    "spheremcap annotate RECORDING, or one more row in the seeds and "
    "spheremcap retrack RECORDING --seeds SEEDS -o OTHER"
)


def said(answer: Answer) -> str:
    """An answer in words: "circle on frame 162, anna"."""
    frames = f"frame {answer.frame_index}"
    if not isinstance(answer, Seed):
        frames = f"frames {answer.frame_index} to {answer.to_frame_index}"
    what = {Seed: "circle", Hidden: "hidden", Keep: "kept"}[type(answer)]
    return f"{what} on {frames}" + (f", {answer.author}" if answer.author else "")


def lost_marker(place: str, marker: str, last: MarkerEstimate | None) -> str:
    """What to look at, and what to give, for a marker that is lost at the end and was measured `last` there."""
    told = f"{place}{marker} is LOST at the end"
    if last is None or last.circle is None:
        return f"{told}: it was never found after its seed: look whether the seed is on it"
    c, frame = last.circle, last.frame_index
    return (
        f"{told}, last seen on frame {frame} at {c.x_px:.0f},{c.y_px:.0f} with radius {c.r_px:.0f}: look where it "
        f"comes back after that, and give its circle there: {HOW_TO_ANSWER}"
    )


Request = tuple[str, int, int]


def key_of(request: OperatorRequest) -> Request:
    return request.marker, request.frame_index, request.raised_at_frame_index


def answered(
    asked: Sequence[OperatorRequest],
    corrected: Corrected,
    answers: Sequence[Answer],
    lost_before: Callable[[int], bool],
) -> dict[Request, str]:
    """What a person said to each request of a marker, "" where nobody did.

    An answer is to a request when it speaks of the frames that the request is about, or when its circle's stretch has
    them; and it is to the last one before it when the marker was LOST until what it changes, as `lost_before` says of a
    frame.
    """
    found: dict[Request, str] = {}
    for request in asked:
        about = request.frame_index, request.raised_at_frame_index
        there = [answer for answer in answers if answer.frame_index <= about[1] and _last(answer) >= about[0]]
        stretches = [stretch for index in about if (stretch := corrected.stretch_at(index)) is not None]
        there += [stretch.answer for stretch in stretches if request not in stretch.requests]
        found[key_of(request)] = said(there[0]) if there else ""
    for answer in answers:
        begins = _begins(answer, corrected)
        before = [request for request in asked if request.raised_at_frame_index < begins]
        latest = max(before, key=lambda request: request.raised_at_frame_index, default=None)
        if latest is not None and not found[key_of(latest)] and lost_before(begins):
            found[key_of(latest)] = said(answer)
    return found


def _begins(answer: Answer, corrected: Corrected) -> int:
    """The first frame that an answer changes."""
    own = (stretch.frames for stretch in corrected.stretches if stretch.answer == answer and len(stretch))
    return next((frames[0] for frames in own), answer.frame_index)


def _last(answer: Answer) -> int:
    return answer.frame_index if isinstance(answer, Seed) else answer.to_frame_index


def told_of(stretch: Stretch) -> str:
    """A stretch in a line."""
    if not len(stretch):
        return f"{stretch.marker}: {said(stretch.answer)}: {stretch.before}"
    first, last = stretch.frames[0], stretch.frames[-1]
    ends = f"{stretch.before}; {stretch.after}"
    return f"{stretch.marker}: frames {first} to {last} by the {said(stretch.answer)} ({ends})"
