"""What a request and a status say, in a person's words."""

from collections.abc import Sequence

from spheremcap.core.estimate import OperatorRequest, Status

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
