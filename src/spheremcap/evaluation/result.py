"""What an experiment gives: tables and plots, and how they are kept in a folder, for the report to gather."""

import importlib
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from spheremcap.errors import UsageError
from spheremcap.evaluation.metrics import layout
from spheremcap.io.output import make_folder, whole_file


@dataclass(frozen=True)
class Table:
    """Rows of cells, the first the heading, and a line that says what they are."""

    caption: str
    cells: Sequence[Sequence[str]]

    def text(self, markdown: bool = False) -> str:
        return layout(self.cells, markdown)


@dataclass(frozen=True)
class Plot:
    """A picture: `draw` is given a matplotlib Figure of `size_in` inches and fills it."""

    name: str
    caption: str
    draw: Callable[[Any], None]
    size_in: tuple[float, float] = (9.0, 4.0)


@dataclass(frozen=True)
class Result:
    """An experiment's outcome. `command` is what repeats it."""

    name: str
    title: str
    about: str
    command: str
    tables: tuple[Table, ...] = ()
    plots: tuple[Plot, ...] = ()

    def text(self) -> str:
        """The tables for a terminal."""
        parts = [self.title, self.about, *(f"{t.caption}\n{t.text()}" for t in self.tables)]
        return "\n\n".join(parts)


def save(result: Result, folder: Path) -> None:
    """Write FOLDER/NAME/result.json and a PNG for each plot. Raises UsageError without matplotlib."""
    into = folder / result.name
    make_folder(into)
    for old in into.glob("*.png"):
        old.unlink()
    for plot in result.plots:
        figure = _figure(plot.size_in)
        plot.draw(figure)
        with whole_file(into / f"{plot.name}.png", overwrite=True) as part:
            figure.savefig(part.path, format="png", dpi=100, metadata={"Software": None})
    kept = {
        "title": result.title,
        "about": result.about,
        "command": result.command,
        "tables": [asdict(table) for table in result.tables],
        "plots": [{"name": p.name, "caption": p.caption} for p in result.plots],
    }
    with whole_file(into / "result.json", overwrite=True) as part:
        part.path.write_text(json.dumps(kept, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


@dataclass(frozen=True)
class Kept:
    """A saved result: its words and tables, and its plots as (caption, PNG file)."""

    name: str
    title: str
    about: str
    command: str
    tables: tuple[Table, ...]
    pictures: tuple[tuple[str, Path], ...]


def load(folder: Path, name: str) -> Kept | None:
    """A result that `save` wrote; None when there is none."""
    path = folder / name / "result.json"
    if not path.exists():
        return None
    kept = json.loads(path.read_text(encoding="utf-8"))
    return Kept(
        name, kept["title"], kept["about"], kept["command"],
        tuple(Table(t["caption"], t["cells"]) for t in kept["tables"]),
        tuple((p["caption"], path.parent / f"{p['name']}.png") for p in kept["plots"]),
    )  # fmt: skip


def _figure(size_in: tuple[float, float]) -> Any:
    try:
        backend = importlib.import_module("matplotlib.backends.backend_agg")
        figure = importlib.import_module("matplotlib.figure").Figure(figsize=size_in, layout="constrained")
    except ImportError:
        raise UsageError("plots need matplotlib: pip install 'spheremcap[report]'") from None
    backend.FigureCanvasAgg(figure)
    return figure
