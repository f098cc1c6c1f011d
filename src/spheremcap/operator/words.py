"""What a request and a status say, in a person's words."""

from collections.abc import Sequence

from spheremcap.core.chair import RIM_POINTS
from spheremcap.core.estimate import OperatorRequest, Status
from spheremcap.operator.chair import RimFit

FAILED = {
    "votes": "the six matchers do not agree enough",
    "outline": "too little of its outline shows an edge",
    "no outline": "no outline was found",
    "little outline": "little of its outline shows an edge",
    "seed": "it does not look like the circle that was given",
    "colour": "it has not the marker's colours",
    "part": "its colours go on around it, so it may be part of something larger",
    "gate": "it is where the marker cannot have got to",
    "size": "it is larger or smaller than the marker can be",
    "likeness": "what was found does not look like the marker that was lost",
    "stood there": "it stood there already while the marker was seen elsewhere",
    "unconfirmed": "it has to be seen again on the next frames",
    "covered": "another marker covers it",
    "out of view": "it should be outside the picture",
    "not found": "nothing like it was found",
    "hidden": "a person said that it is not to be seen",
}
"""What each named check, when it fails, says of the claim (docs/method.md 2.8)."""

MEANING = {
    Status.SEEDED: "circle given by a person",
    Status.VERIFIED: "found and verified",
    Status.ESTIMATED: "estimated, not seen",
    Status.LOST: "lost",
    Status.OUT_OF_VIEW: "out of view",
}

CLICKED_ON = {
    "left_axle": ("Left axle", "the centre of the left wheel's hub"),
    "right_axle": ("Right axle", "the centre of the right wheel's hub"),
    "left_rim": ("Left rim", "points all around the left push rim, on the middle line of its tube"),
    "right_rim": ("Right rim", "points all around the right push rim, on the middle line of its tube"),
    "front": ("Front", "a point of the chair that was measured, such as the front hub"),
}
"""What each thing of a chair is called, and where it is clicked; left and right are the athlete's."""


def rim_said(count: int, fit: RimFit | None) -> str:
    """How well so many points of a rim fit, "" where there are none."""
    if count == 0:
        return ""
    if count < RIM_POINTS:
        return f"{count} of at least {RIM_POINTS} points"
    if fit is None:
        return "they lie on no ellipse: spread them over all that shows of the rim"
    if count == RIM_POINTS:
        return "an ellipse goes through any five: one more shows how well they fit"
    said = f"{fit.rms_px:.2f} px off the ellipse (rms)"
    if fit.rms_without_px is not None:
        return f"{said}; {fit.rms_without_px:.2f} px without the one that is marked: is it on the rim?"
    return f"{said}; with one more, a wrong one can be told" if count == RIM_POINTS + 1 else said


def failed(reasons: Sequence[str]) -> list[str]:
    """The failed checks in words; a name that has none stands for itself."""
    return [FAILED.get(reason, reason) for reason in reasons]


def asked(request: OperatorRequest) -> str:
    """What is asked and why, in a sentence or two."""
    said = failed(request.reasons)
    why = f" What spoke against what was found: {'; '.join(said)}." if said else f" {_sentence(request.reason)}"
    return (
        f"Where is {request.marker}? It was not verified from frame {request.frame_index} on "
        f"and given up on frame {request.raised_at_frame_index}.{why}"
    )


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}." if text else ""
