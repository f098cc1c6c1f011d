"""Numbers, words and tables as HTML. What comes in is HTML already, but for what is said to be text."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

NONE = "–"


def number(value: float | None, digits: int, *, sign: bool = False) -> str:
    """A number for people; a dash where there is none."""
    if value is None or not np.isfinite(value):
        return NONE
    text = f"{value:{'+' if sign else ''}.{digits}f}"
    if not text.strip("+-0."):
        text = text.lstrip("+-")
    return text.replace("-", "−")


def give_or_take(value: float, spread: float | None, digits: int, *, sign: bool = False) -> str:
    return number(value, digits, sign=sign) + ("" if spread is None else f" ± {number(spread, digits)}")


def unit(unit: str) -> str:
    return unit if unit == "°" else f" {unit}"


def percent(share: float | None, digits: int = 1) -> str:
    return NONE if share is None or not np.isfinite(share) else f"{number(100 * share, digits)} %"


def plural(count: int, word: str) -> str:
    return f"{count} {word}" if count == 1 else f"{count} {word}s"


def listed(words: Sequence[str]) -> str:
    return " and ".join(words) if len(words) < 3 else f"{', '.join(words[:-1])} and {words[-1]}"


def table(caption: str, head: str, rows: Iterable[str], look: str = "") -> str:
    kind = f' class="{look}"' if look else ""
    return (
        f'<div class="wide"><table{kind}><caption>{caption}</caption>\n<thead>{head}</thead>\n<tbody>\n'
        + "\n".join(rows)
        + "\n</tbody></table></div>"
    )


def heads(*words: str) -> str:
    return "<tr>" + "".join(f'<th scope="col">{word}</th>' for word in words) + "</tr>"


def row(head: str, cells: Iterable[str]) -> str:
    return f'<tr><th scope="row">{head}</th>' + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>"


def explained(pairs: Mapping[str, str]) -> str:
    return "<dl>" + "".join(f"<dt>{term}:</dt><dd>{said}</dd>" for term, said in pairs.items()) + "</dl>"
