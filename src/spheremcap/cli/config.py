"""spheremcap config: what can be set, and with which value, unit and source."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from spheremcap.cli.progress import loaded

if TYPE_CHECKING:
    from pydantic import BaseModel

    from spheremcap.config import Settings

app = typer.Typer(no_args_is_help=True, help="Show the settings and the camera presets.")


@app.command()
def show(
    settings: Annotated[Path | None, typer.Argument(help="A settings file; without one, the defaults.")] = None,
) -> None:
    """Print every settings key with its value, as TOML that `track --settings` reads."""
    from spheremcap.config import Settings, load_settings

    loaded()
    chosen = load_settings(settings) if settings is not None else Settings()
    typer.echo(_commented(chosen), nl=False)


@app.command()
def presets() -> None:
    """List the camera presets with where their numbers come from."""
    from spheremcap.core.presets import PRESETS

    for name, camera in PRESETS.items():
        typer.echo(f"{name}: {camera.width_px}x{camera.height_px}, fx {camera.fx_px:g} px, {camera.model}")
        typer.echo(f"    {camera.source}")


def _commented(settings: "Settings") -> str:
    """The settings' TOML with each key's description behind it."""
    notes: dict[tuple[str, str], str] = {}
    _collect(settings, "", notes)
    lines, table = [], ""
    for line in settings.to_toml().splitlines():
        if line.startswith("["):
            table = line.strip("[]")
        key = line.split(" = ")[0]
        note = notes.get((table, key))
        lines.append(f"{line}  # {note}" if note else line)
    return "\n".join(lines) + "\n"


def _collect(model: "BaseModel", table: str, notes: dict[tuple[str, str], str]) -> None:
    from pydantic import BaseModel

    for name, info in type(model).model_fields.items():
        value = getattr(model, name)
        path = f"{table}.{name}" if table else name
        if isinstance(value, BaseModel):
            _collect(value, path, notes)
        elif isinstance(value, tuple) and value and isinstance(value[0], BaseModel):
            _collect(value[0], path, notes)
        elif info.description:
            notes[(table, name)] = info.description
