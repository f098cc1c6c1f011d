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
    """The settings' TOML with each key's description: keys without a value, and a marker's table where there is none,
    are comments.
    """
    from spheremcap.config import MarkerSettings

    lines = _lines(settings, "")
    markers = settings.markers or (MarkerSettings(name="left_wrist"),)
    for marker in markers:
        table = ["[[markers]]", *_keys(marker)]
        lines += ["", *(table if settings.markers else [f"# {line}" for line in table])]
    return "\n".join(lines).strip() + "\n"


def _lines(model: "BaseModel", table: str) -> list[str]:
    """A table and those inside it."""
    from pydantic import BaseModel

    keys = _keys(model)
    lines = ["", f"[{table}]", *keys] if keys else []
    for name in type(model).model_fields:
        inner = getattr(model, name)
        if isinstance(inner, BaseModel):
            lines += _lines(inner, f"{table}.{name}" if table else name)
    return lines


def _keys(model: "BaseModel") -> list[str]:
    """Each plain key with its value and description."""
    import tomli_w

    lines = []
    for name, field in type(model).model_fields.items():
        value = getattr(model, name)
        if not field.description:  # a table of its own
            continue
        if value is None:
            key = f"# {name} ="
        elif isinstance(value, tuple):
            key = f"{name} = [{', '.join(repr(number) for number in value)}]"
        else:
            key = tomli_w.dumps({name: value}).strip()
        lines.append(f"{key}  # {field.description}")
    return lines
