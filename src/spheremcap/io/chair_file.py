"""The file of what a person clicked of a chair, NAME.chair.toml."""

from collections.abc import Sequence
from pathlib import Path

import tomli_w
from pydantic import Field, ValidationError

from spheremcap.core.chair import ChairClick, check_clicks
from spheremcap.core.stage import StageConfig
from spheremcap.errors import SettingsError, UsageError
from spheremcap.io.toml_file import first_problem, read_toml

_LAST_FRAME = 10**9


class _ClickRow(StageConfig):
    """A row of a file of clicks on a chair; what it can be on and where is `check_clicks`'s to say."""

    on: str
    frame: int = Field(ge=0, le=_LAST_FRAME)
    x_px: float
    y_px: float

    def click(self) -> ChairClick:
        return ChairClick(self.on, self.frame, self.x_px, self.y_px)


class _PictureSize(StageConfig):
    """Of the pictures that were clicked on."""

    width_px: int = Field(gt=0, le=65535)
    height_px: int = Field(gt=0, le=65535)


def load_chair(path: Path) -> tuple[tuple[ChairClick, ...], tuple[int, int]]:
    """Read a file of clicks on a chair: width_px and height_px of the pictures, and [[clicks]] with on, frame, x_px and
    y_px; none where nothing is clicked. The clicks, and (width, height). Raises SettingsError."""
    tables = read_toml(path)
    rows = tables.pop("clicks", [])
    if set(tables) != set(_PictureSize.model_fields) or not isinstance(rows, list):
        raise SettingsError(
            f"{path}: expected width_px and height_px of the pictures, and [[clicks]] tables with on, frame, x_px and "
            "y_px; nothing else"
        )
    try:
        size = _PictureSize.model_validate(tables)
    except ValidationError as error:
        raise SettingsError(f"{path}: {first_problem(error)}") from error
    clicks = []
    for number, row in enumerate(rows, 1):
        if not isinstance(row, dict) or set(row) != set(_ClickRow.model_fields):
            raise SettingsError(f"{path}: click {number} must have on, frame, x_px and y_px; nothing else")
        try:
            clicks.append(_ClickRow.model_validate(row).click())
        except ValidationError as error:
            raise SettingsError(f"{path}: click {number}: {first_problem(error)}") from error
    try:
        check_clicks(clicks, size.width_px, size.height_px)
    except UsageError as error:
        raise SettingsError(f"{path}: {error}") from error
    return tuple(clicks), (size.width_px, size.height_px)


def chair_toml(clicks: Sequence[ChairClick], width_px: int, height_px: int) -> str:
    """The text of a file of clicks on pictures of this size, which `load_chair` reads back."""
    rows = [{"on": c.on, "frame": c.frame_index, "x_px": c.x_px, "y_px": c.y_px} for c in clicks]
    size = tomli_w.dumps({"width_px": width_px, "height_px": height_px})
    return size + "".join("\n[[clicks]]\n" + tomli_w.dumps(row) for row in rows)
