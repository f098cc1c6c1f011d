"""Numbers, words, tables and figures as HTML. What comes in is HTML already, but for what is said to be text."""

from collections.abc import Iterable, Mapping, Sequence
from html import escape

import numpy as np
import numpy.typing as npt

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


def figure(title: str, caption: str, width: int, height: int, content: str) -> str:
    """A figure with its caption; `caption` is HTML, `title` is text."""
    return (
        f'<figure><svg viewBox="0 0 {width} {height}" role="img" aria-label="{escape(title)}">'
        f"{content}</svg><figcaption>{caption}</figcaption></figure>"
    )


def ticks(low: float, high: float, about: int) -> npt.NDArray[np.float64]:
    """Round numbers between two."""
    if not high > low:
        return np.array([low])
    rough = (high - low) / about
    power = 10.0 ** np.floor(np.log10(rough))
    step = next(power * k for k in (1, 2, 5, 10) if power * k >= rough * (1 - 1e-9))
    return np.arange(np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9) + 1) * step


def plain(value: float) -> str:
    return f"{value + 0.0:.6g}".replace("-", "−")


def section(title: str, parts: Iterable[str]) -> str:
    """A section of a page, of those parts that are there."""
    return f"<section>\n<h2>{title}</h2>\n" + "\n".join(part for part in parts if part) + "\n</section>"


def document(title: str, css: str, content: Iterable[str], footer: str) -> str:
    """A whole page, self-contained, of those parts that are there."""
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{title}</title>\n<style>\n{css}</style>\n</head>\n<body>\n<main>\n"
        + "\n".join(part for part in content if part)
        + f"\n</main>\n<footer>{footer}</footer>\n</body>\n</html>\n"
    )
