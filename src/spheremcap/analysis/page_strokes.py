"""Strokes on a session's page: means, left against right, sentences, and the table of all."""

from collections import Counter
from collections.abc import Mapping, Sequence
from html import escape

from spheremcap.analysis.findings import Findings
from spheremcap.analysis.markup import (
    NONE,
    explained,
    give_or_take,
    heads,
    listed,
    number,
    percent,
    plural,
    row,
    table,
    unit,
)
from spheremcap.analysis.settings import SIDES
from spheremcap.analysis.summary import QUANTITIES, Mean, Quantity, compared, contact_lags, mean_of, sd_of, value_of
from spheremcap.core.stroke import Stroke
from spheremcap.core.time import NS_PER_S

SHOWN_ROWS = 100
"""Of a long session so many strokes are in the table from its start, and so many from its end."""


def _hands(found: Findings) -> dict[str, tuple[Stroke, ...]]:
    """Strokes of the hands that have any."""
    return {side: found.hands[side].strokes for side in SIDES if side in found.hands and found.hands[side].strokes}


def means_part(found: Findings) -> str:
    """Means over strokes of each hand, and their difference."""
    hands = _hands(found)
    if not hands:
        return "<p>No strokes were found. Why is said at the top of the page.</p>"
    absent = [side for side in SIDES if side not in hands]
    alone = f"<p>There are no strokes of the {absent[0]} hand: nothing can be compared.</p>" if absent else ""
    rows = []
    for quantity in QUANTITIES:
        means = {side: mean_of(strokes, quantity) for side, strokes in hands.items()}
        if not any(means.values()):
            continue
        cells = [cell for mean in means.values() for cell in _mean_cells(mean, quantity)]
        if not absent:
            cells += _compared_cells(means["left"], means["right"], quantity)
        rows.append(row(f"{quantity.label},&nbsp;{quantity.unit}", cells))
    rows.append(_patterns_row(hands, compares=not absent))
    first = '<tr><th scope="col" rowspan="2">Per stroke</th>'
    second = ""
    for side in hands:
        first += f'<th scope="colgroup" colspan="3" class="{side}">{side.capitalize()} hand</th>'
        second += (
            '<th scope="col">mean ± SD</th><th scope="col">one stroke measured to</th><th scope="col">strokes</th>'
        )
    if not absent:
        first += '<th scope="colgroup" colspan="2">Left − right</th>'
        second += '<th scope="col">difference ± SE</th><th scope="col">asymmetry</th>'
    words = {
        "Mean ± SD": "SD is the standard deviation over strokes: how much the athlete varies from stroke to stroke "
        "(with what measuring adds).",
        "One stroke measured to": "the uncertainty of a single stroke's value, as one standard deviation: how well "
        "it was measured. Where it is as large as the SD, the variation is the measurement's and not the athlete's.",
    }
    if not absent:
        words["Difference ± SE"] = (
            "mean of the left hand minus mean of the right, with its standard error from the variation over strokes. "
            "A difference of more than twice its SE is hardly chance; what errs alike on all strokes (the chair's "
            "frame) is not in it."
        )
        words["Asymmetry"] = (
            "the difference over the mean of both hands: positive where the left is larger. A position on the rim "
            "has none, for its zero is only where we count from."
        )
    counts = [f"{sum(_whole(s) for s in some)} of {len(some)} of the {side} hand" for side, some in hands.items()]
    caption = f"Means over strokes. Whole strokes (contact, release and next contact seen): {listed(counts)}."
    return alone + table(caption, f"{first}</tr><tr>{second}</tr>", rows) + explained(words)


def _whole(stroke: Stroke) -> bool:
    return stroke.push_s is not None and stroke.cycle_s is not None


def _patterns_row(hands: Mapping[str, Sequence[Stroke]], *, compares: bool) -> str:
    cells = "".join(f'<td class="across" colspan="3">{_patterns(strokes) or NONE}</td>' for strokes in hands.values())
    return f'<tr><th scope="row">Path of the recovery</th>{cells}{"<td></td>" * 2 if compares else ""}</tr>'


def _patterns(strokes: Sequence[Stroke]) -> str:
    """How often each path of the recovery is, most often first; "" where none is known."""
    counts = Counter(stroke.pattern for stroke in strokes if stroke.pattern)
    return listed([f"{count} × {escape(name)}" for name, count in sorted(counts.items(), key=lambda c: (-c[1], c[0]))])


def _mean_cells(mean: Mean | None, quantity: Quantity) -> list[str]:
    if mean is None:
        return [NONE, NONE, "0"]
    fine = quantity.digits + (quantity.digits == 0)
    to = f"± {number(mean.measured_to, fine)}" if mean.measured_to is not None else NONE
    return [give_or_take(mean.value, mean.sd, quantity.digits), to, str(mean.strokes)]


def _compared_cells(left: Mean | None, right: Mean | None, quantity: Quantity) -> list[str]:
    both = compared(left, right, quantity)
    if both is None:
        return [NONE, NONE]
    fine = quantity.digits + (quantity.digits == 0)
    index = f"{number(both.index, 1, sign=True)} %" if both.index is not None else NONE
    return [give_or_take(both.difference, both.error, fine, sign=True), index]


def sentences_part(found: Findings) -> str:
    """Each number of the table once in words."""
    parts = []
    for side, strokes in _hands(found).items():
        means = {q.field: (mean, q) for q in QUANTITIES if (mean := mean_of(strokes, q)) is not None}
        said = []
        for field, words in _WORDS.items():
            if field in means:
                mean, quantity = means[field]
                value = mean.value
                text = give_or_take(_shown(field, value), mean.sd, quantity.digits) + unit(quantity.unit)
                line = words.format(side=side, value=text, where=_where(value), share=_share(means))
                if mean.measured_to is not None:
                    fine = quantity.digits + (quantity.digits == 0)
                    line += f" (each measured to {number(mean.measured_to, fine)}{unit(quantity.unit)})"
                said.append(f"{line}.")
        if patterns := _patterns(strokes):
            said.append(f"Its wrist comes back on these paths, and so often: {patterns}.")
        parts.append(
            f"<h3>The {side} hand in words</h3>\n<ul>" + "".join(f"<li>{line}</li>" for line in said) + "</ul>"
        )
    which = "<p>±: how much it varies from stroke to stroke; “measured to”: how well a single stroke is known.</p>"
    return "\n".join([which, *parts] if parts else [])


_WORDS = {
    "push_s": "The {side} hand is on the rim for {value}{share}",
    "recovery_s": "It is off the rim for {value}",
    "cycle_s": "From one contact to the next it takes {value}",
    "frequency_hz": "That is {value}",
    "contact_deg": "It takes hold {value} {where} the top of the wheel",
    "release_deg": "It lets go {value} {where} the top of the wheel",
    "push_deg": "It goes with the rim through {value}",
    "contact_mps": "Just before contact its wrist moves at {value}",
    "recovery_end_mps": "Over the last tenth of the recovery its wrist moves at {value}",
}
"""What is said of a quantity; the share of the cycle is said with the push."""


def _shown(field: str, value: float) -> float:
    return abs(value) if field in ("contact_deg", "release_deg") else value


def _where(value: float) -> str:
    return "past" if value >= 0 else "before"


def _share(means: Mapping[str, tuple[Mean, Quantity]]) -> str:
    return f", {number(means['push_share'][0].value, 0)} % of its stroke" if "push_share" in means else ""


def timing_part(found: Findings) -> str:
    """Which hand takes hold first."""
    hands = _hands(found)
    if len(hands) < 2:
        return ""
    lags_ms = contact_lags(found.hands["left"].events, found.hands["right"].events, hands)
    title = "<h3>Left and right in time</h3>"
    if not len(lags_ms):
        return title + "<p>No contact of one hand has one of the other within half a cycle.</p>"
    mean, sd = float(lags_ms.mean()), float(lags_ms.std(ddof=1)) if len(lags_ms) > 1 else None
    late = "later" if mean >= 0 else "earlier"
    return (
        f"{title}<p>In the mean the left hand takes hold {give_or_take(abs(mean), sd, 1)} ms {late} than the right "
        f"(±: standard deviation over {plural(len(lags_ms), 'pair')} of contacts).</p>"
    )


def strokes_part(found: Findings) -> str:
    """The table of all strokes, of a long session those at its ends."""
    strokes = sorted((s for some in _hands(found).values() for s in some), key=lambda s: (s.stamp_ns, s.side))
    if not strokes:
        return "<p>There are none.</p>"
    columns = [q for q in QUANTITIES if q.field != "push_share" and any(value_of(s, q) is not None for s in strokes)]
    wheel = any(s.wheel_rad_s is not None for s in strokes)
    some, caption = strokes, f"{plural(len(strokes), 'stroke')} of both hands by time."
    if len(strokes) > 2 * SHOWN_ROWS:
        some = strokes[:SHOWN_ROWS] + strokes[-SHOWN_ROWS:]
        caption = f"The first {SHOWN_ROWS} and the last {SHOWN_ROWS} of {len(strokes)} strokes by time."
    caption += (
        " ±: uncertainty of the value (one standard deviation). The file beside this page whose name ends in "
        ".strokes.csv has all strokes with all digits, and says why a value is not there."
    )
    head = heads(
        "Time, s", "Hand", "No.", *(f"{q.label}, {q.unit}" for q in columns), *(["Wheel, rad/s"] if wheel else []),
        "Path", "Measured",
    )  # fmt: skip
    start_ns = int(found.stamp_ns[0]) if len(found.stamp_ns) else 0
    rows = []
    for k, stroke in enumerate(some):
        if k == SHOWN_ROWS and len(some) < len(strokes):
            across = 5 + len(columns) + wheel
            rows.append(
                f'<tr><td class="note" colspan="{across}">… {len(strokes) - len(some)} strokes left out …</td></tr>'
            )
        cells = [f'<td class="hand {stroke.side}">{stroke.side}</td>', f"<td>{stroke.stroke}</td>"]
        cells += [f"<td>{_stroke_cell(stroke, q)}</td>" for q in columns]
        cells += [f"<td>{number(stroke.wheel_rad_s, 2)}</td>"] if wheel else []
        cells.append(f'<td class="word">{escape(stroke.pattern) or NONE}</td>')
        cells.append(f"<td>{percent(stroke.measured, 0)}</td>")
        time_s = number((stroke.stamp_ns - start_ns) / NS_PER_S, 3)
        rows.append(f'<tr><th scope="row">{time_s}</th>{"".join(cells)}</tr>')
    return table(caption, head, rows, "strokes")


def _stroke_cell(stroke: Stroke, quantity: Quantity) -> str:
    value, sd = value_of(stroke, quantity), sd_of(stroke, quantity)
    if value is None:
        return NONE
    text = number(value * quantity.factor, quantity.digits)
    fine = quantity.digits + (quantity.digits == 0)
    return text if sd is None else f"{text} <small>± {number(sd * quantity.factor, fine)}</small>"
