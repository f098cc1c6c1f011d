"""Coloured spheres in the first seconds, with no seed at all.

Every now and then all that is round and of a colour of its own is taken for a marker and followed by a chain of its own
over the next few frames. What has a clear outline, is followed, moves against the background, has a colour that hardly
anything else in the picture has, and is there whenever one looks, comes first. Each says why in words.
"""

import math
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from spheremcap.chain import ChainConfig, MarkerChain
from spheremcap.core.camera import Camera
from spheremcap.core.circle import Circle
from spheremcap.core.estimate import MarkerEstimate, Status
from spheremcap.core.frame import BgrImage, Frame, Patch, Window
from spheremcap.core.marker import MarkerSpec
from spheremcap.core.time import NS_PER_S
from spheremcap.detection.colour import box_mask
from spheremcap.detection.hues import name_of
from spheremcap.detection.outline import Outline
from spheremcap.detection.spots import Spot, described, reduced, spots

_EVERY_S = 0.4  # between two looks
_FOLLOWED_S, _FOLLOWED_FRAMES = 0.04, 4  # that a spot is followed after a look, at least
_MOST_SPOTS, _MOST_FOLLOWED = 16, 10  # at one look
_LEAST_CLEAR, _LEAST_VISIBLE = 0.1, 0.35  # of what is worth being followed
_MOVES_RADII = 0.5  # against the background while it is followed: more tells no more
_RESTS_RADII = 0.15  # below this it moves with the background
_ALIKE = 2.0  # of `_unlike`, up to which what was seen at two looks may be one thing
_Map = Callable[..., Iterator[Any]]
_LEAST_SCORE, _LEAST_SHARE = 0.05, 0.25  # what scores less, or less than this share of the best, is not proposed


@dataclass(frozen=True, slots=True)
class Proposal:
    """A thing that may be a marker: where to start it from, what it looks like, and what speaks for it.

    `circle` (pixels) on frame `frame_index` is the first clear sight of it; `seen` holds all, (frame, circle), one a
    look. `colour` is its colour's name, `hsv` that colour (hue 0..180, saturation and value 0..255). `score` in [0, 1]
    ranks it among others; `reason` says why in words.
    """

    circle: Circle
    frame_index: int
    colour: str
    hsv: tuple[float, float, float]
    score: float
    reason: str
    seen: tuple[tuple[int, Circle], ...]


@dataclass(frozen=True, slots=True)
class _Sight:
    """One spot at one look. `visible` and `verified` are the mean share of its outline and the share of frames verified
    while it was followed, `alone` the share of what has its colours in the picture that it is itself, `moved_radii` how
    far it moved against the background, which itself moved by `carried_px`."""

    look: int
    frame_index: int
    spot: Spot
    visible: float
    verified: float
    alone: float
    moved_radii: float
    carried_px: float

    @property
    def strength(self) -> float:
        """What speaks for its being a marker, 0..1."""
        return (
            self.spot.promise
            * self.visible**2
            * (0.3 + 0.7 * self.verified)
            * (0.3 + 0.7 * math.sqrt(self.alone))
            * (0.4 + 0.6 * min(1.0, self.moved_radii / _MOVES_RADII))
        )


def propose(frames: Iterable[Frame], camera: Camera, chain: ChainConfig) -> list[Proposal]:
    """What may be a marker on frames in a row, the likeliest first; none twice. On a single frame nothing is known of
    how it moves. Frames are gone through once, one at a time."""
    looks = 0
    threads: list[list[_Sight]] = []
    with ThreadPoolExecutor(os.cpu_count() or 1, "spots") as pool:
        for found in _looks(frames, camera, chain, pool.map):
            _join(threads, found)
            looks += 1
    proposals = [_proposal(sights, looks) for sights in threads]
    proposals.sort(key=lambda proposal: -proposal.score)
    return [p for p in proposals if p.score >= max(_LEAST_SCORE, _LEAST_SHARE * proposals[0].score)]


def _looks(frames: Iterable[Frame], camera: Camera, chain: ChainConfig, side_by_side: _Map) -> Iterator[list[_Sight]]:
    """The sights of one look after another."""
    outline = Outline(MarkerSpec("").radius_m, camera, chain.edge, chain.position)
    look: _Look | None = None
    count, next_ns = 0, None
    for frame in frames:
        if look is not None:
            look.follow(frame, side_by_side)
            if look.ended:
                yield look.sights(count)
                count, look = count + 1, None
        elif next_ns is None or frame.stamp_ns >= next_ns:
            look = _Look(frame, outline, camera, chain, side_by_side)
            next_ns = frame.stamp_ns + round(_EVERY_S * NS_PER_S)
    if look is not None:
        yield look.sights(count)


@dataclass(frozen=True, slots=True)
class _Followed:
    """A spot that was taken for a marker, and what its chain says, the seed's estimate first."""

    chain: MarkerChain
    spot: Spot
    seen: list[MarkerEstimate]


class _Look:
    """The spots of one frame, each with a chain that follows it over the next ones."""

    def __init__(self, frame: Frame, outline: Outline, camera: Camera, config: ChainConfig, side_by_side: _Map) -> None:
        self._first, self._before = frame, _grey(frame)
        self._last: Frame | None = None
        self._frames = 0

        def begun(spot: Spot) -> _Followed | None:
            chain = MarkerChain(MarkerSpec(""), camera, config, metric=False)
            seeded = chain.seed(frame, spot.circle)
            circle, visible = seeded.circle or spot.circle, seeded.visible or 0.0
            if visible < _LEAST_VISIBLE or not _centred(circle, frame):
                return None
            return _Followed(chain, described(frame, circle, visible), [seeded])

        found = [one for one in side_by_side(begun, spots(frame, outline, _MOST_SPOTS)) if one is not None]
        found = [one for one in found if one.spot.clear >= _LEAST_CLEAR]
        self._followed = sorted(found, key=lambda one: -one.spot.promise * one.spot.visible)[:_MOST_FOLLOWED]

    def follow(self, frame: Frame, side_by_side: _Map) -> None:
        """Each spot's chain goes on to the next frame."""
        steps = side_by_side(lambda one: one.chain.step(frame), self._followed)
        for one, estimate in zip(self._followed, list(steps), strict=True):
            one.seen.append(estimate)
        self._last = frame
        self._frames += 1

    @property
    def ended(self) -> bool:
        """Whether the spots were followed for long enough."""
        assert self._last is not None
        since_s = (self._last.stamp_ns - self._first.stamp_ns) / NS_PER_S
        return since_s >= _FOLLOWED_S and self._frames >= _FOLLOWED_FRAMES

    def sights(self, look: int) -> list[_Sight]:
        """What became of the spots."""
        carried = np.zeros(2) if self._last is None else _carried_px(self._before, self._last)
        step = max(1, round(max(self._first.width_px, self._first.height_px) / 640))
        picture, _ = reduced(self._first, step)
        found = []
        for one in self._followed:
            spot, seen, circle = one.spot, one.seen, one.spot.circle
            last = next(e.circle for e in reversed(seen) if e.circle is not None and e.status.measured)
            way = np.array([last.x_px - circle.x_px, last.y_px - circle.y_px]) - carried
            limits = one.chain.colours(Patch(self._first, Window.around(circle, 2 * circle.r_px + 2)), circle)
            own = math.pi * (circle.r_px / step) ** 2 * spot.inside
            after = seen[1:]
            found.append(
                _Sight(
                    look,
                    seen[0].frame_index,
                    spot,
                    float(np.mean([e.visible or 0.0 for e in seen])),
                    sum(e.status is Status.VERIFIED for e in after) / len(after) if after else 0.0,
                    min(1.0, own / max(1, int(np.count_nonzero(box_mask(picture, limits))))),
                    float(np.hypot(*way)) / circle.r_px,
                    float(np.hypot(*carried)),
                )
            )
        return found


_GREY_PX = 320  # longer side of the picture in which the background's motion is seen


def _grey(frame: Frame) -> tuple[BgrImage, int]:
    """A small grey picture of a frame, and by how much it is reduced."""
    step = max(1, round(max(frame.width_px, frame.height_px) / _GREY_PX))
    return cv2.cvtColor(reduced(frame, step)[0], cv2.COLOR_BGR2GRAY), step  # type: ignore[return-value]


def _carried_px(before: tuple[BgrImage, int], frame: Frame) -> npt.NDArray[np.float64]:
    """How far the picture as a whole has moved (2,): the median over corners; none where it has hardly any."""
    grey, step = before
    corners = cv2.goodFeaturesToTrack(grey, 200, 0.01, 8)
    if corners is None or len(corners) < 8:
        return np.zeros(2)
    moved, found, _ = cv2.calcOpticalFlowPyrLK(grey, _grey(frame)[0], corners, None, winSize=(15, 15), maxLevel=3)  # type: ignore[call-overload]
    ways = (moved - corners).reshape(-1, 2)[found.ravel() > 0]
    return np.median(ways, axis=0).astype(np.float64) * step if len(ways) >= 8 else np.zeros(2)


def _centred(circle: Circle, frame: Frame) -> bool:
    return 0 <= circle.x_px <= frame.width_px - 1 and 0 <= circle.y_px <= frame.height_px - 1


def _unlike(one: Spot, other: Spot) -> float:
    """How different two spots look, wherever they are: 0 for the same."""
    (hue, saturation, value), (hue2, saturation2, value2) = one.hsv, other.hsv
    off = abs(hue - hue2) % 180
    coloured = min(1.0, min(saturation, saturation2) / 60)  # a grey's hue is chance
    size = abs(math.log(one.circle.r_px / other.circle.r_px))
    return (
        size / 0.35
        + coloured * min(off, 180 - off) / 10
        + abs(saturation - saturation2) / 60
        + abs(value - value2) / 80
    )


def _join(threads: list[list[_Sight]], found: Sequence[_Sight]) -> None:
    """Put the sights of a look to those of earlier ones that look most like them; the rest begin a thread each."""
    pairs = [
        (min(_unlike(before.spot, sight.spot) for before in thread[-2:]), k, n)
        for k, thread in enumerate(threads)
        for n, sight in enumerate(found)
    ]
    taken: set[int] = set()
    longer: set[int] = set()
    for unlike, k, n in sorted(pairs):
        if unlike < _ALIKE and k not in longer and n not in taken:
            threads[k].append(found[n])
            longer.add(k)
            taken.add(n)
    threads += [[sight] for n, sight in enumerate(found) if n not in taken]


def _proposal(sights: Sequence[_Sight], looks: int) -> Proposal:
    """What the sights of one thing say, of so many looks."""
    strengths = [sight.strength for sight in sights]
    score = float(np.mean(strengths)) * math.sqrt(len(sights) / looks)
    first = next(sight for sight in sights if sight.strength >= 0.6 * max(strengths))
    colour = name_of(first.spot.hsv)
    seen = tuple((sight.frame_index, sight.spot.circle) for sight in sights)
    return Proposal(
        first.spot.circle, first.frame_index, colour, first.spot.hsv, score, _reason(sights, looks, colour), seen
    )


def _reason(sights: Sequence[_Sight], looks: int, colour: str) -> str:
    """Why it may be a marker, in words."""

    def middle(values: Iterable[float]) -> float:
        return float(np.median(list(values)))

    moved, carried = middle(s.moved_radii for s in sights), middle(s.carried_px for s in sights)
    if moved >= _RESTS_RADII:
        way = f"moves against the background by {moved:.1f} radii while it is followed"
    else:
        way = "moves with the background" if carried > 1 else "at rest"
    return (
        f"round, {middle(s.visible for s in sights):.0%} of the outline seen; {colour}, with a colour difference of "
        f"{middle(s.spot.contrast for s in sights):.0f} to what is around it and {middle(s.alone for s in sights):.0%} "
        f"of all that has its colours in the picture; "
        f"seen at {len(sights)} of {looks} look{'s' * (looks != 1)}; {way}"
    )
