"""Settings: the stages' own configs, composed, and how they are written in TOML. The seeds file is read here too."""

import re
import tomllib
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, ValidationError, field_validator, model_validator

from spheremcap.chain import ChainConfig
from spheremcap.core.circle import Circle
from spheremcap.core.marker import MarkerSpec, Seed
from spheremcap.core.stage import StageConfig
from spheremcap.errors import SettingsError
from spheremcap.session import SessionConfig

_LENGTH = re.compile(r"\s*([0-9.]+)\s*(mm|cm|m|in)\s*")
_UNIT_M = {"mm": 0.001, "cm": 0.01, "m": 1.0, "in": 0.0254}


class CameraSettings(StageConfig):
    """One of: `preset`, `file` (ROS camera_info YAML), or all of fx_px, fy_px, cx_px, cy_px."""

    preset: str | None = Field(None, description="name of a camera preset; see `spheremcap config presets`")
    file: str | None = Field(None, description="ROS camera_info YAML, relative to the settings file")
    width_px: int | None = Field(None, gt=0, description="picture size the numbers are for")
    height_px: int | None = Field(None, gt=0, description="picture size the numbers are for")
    fx_px: float | None = Field(None, gt=0, description="focal length, pixels")
    fy_px: float | None = Field(None, gt=0, description="focal length, pixels")
    cx_px: float | None = Field(None, description="principal point, pixels, integer = pixel centre")
    cy_px: float | None = Field(None, description="principal point, pixels, integer = pixel centre")
    model: Literal["none", "plumb_bob", "fisheye"] = Field("none", description="distortion model")
    distortion: tuple[float, ...] = Field((), description="k1 k2 p1 p2 [k3 [k4 k5 k6]] or, fisheye, k1 k2 k3 k4")
    focal_sd: float = Field(0.0, ge=0, description="relative uncertainty of the focal length")
    exposure_s: float = Field(0.0, ge=0, description="exposure time in seconds for the motion blur model; 0: unknown")
    readout_s: float | None = Field(
        None,
        gt=-1,
        lt=1,
        description="rolling shutter: seconds from the first row to the last; 0: global shutter, negative: upside down",
    )

    @model_validator(mode="after")
    def _one_way(self) -> "CameraSettings":
        numbers = [self.fx_px, self.fy_px, self.cx_px, self.cy_px]
        ways = [self.preset is not None, self.file is not None, any(n is not None for n in numbers)]
        if sum(ways) > 1:
            raise ValueError("give one of preset, file, or fx_px/fy_px/cx_px/cy_px, not several")
        if ways[2] and any(n is None for n in [*numbers, self.width_px, self.height_px]):
            raise ValueError("explicit numbers need width_px, height_px, fx_px, fy_px, cx_px and cy_px")
        return self

    @property
    def given(self) -> bool:
        """Whether a camera is named: by preset, file or numbers."""
        return not (self.preset is None and self.file is None and self.fx_px is None)


class MarkerSettings(StageConfig):
    """One marker; its name becomes its topic."""

    name: str = Field(pattern=r"^[A-Za-z0-9_]+$", description="letters, digits, underscores")
    diameter_m: float = Field(0.04, gt=0, description='true diameter in metres (or `diameter = "4 cm"`)')

    @model_validator(mode="before")
    @classmethod
    def _length(cls, data: Any) -> Any:
        if isinstance(data, dict) and isinstance(data.get("diameter"), str):
            found = _LENGTH.fullmatch(data["diameter"])
            if not found:
                raise ValueError(f'diameter {data["diameter"]!r} is not a length such as "4 cm"')
            if "diameter_m" in data:
                raise ValueError("give diameter or diameter_m, not both")
            data = {k: v for k, v in data.items() if k != "diameter"}
            data["diameter_m"] = float(found[1]) * _UNIT_M[found[2]]
        return data

    def spec(self) -> MarkerSpec:
        return MarkerSpec(self.name, self.diameter_m)


class OutputSettings(StageConfig):
    """What goes into the recording besides the numbers."""

    video: Literal["auto", "passthrough", "h264", "jpeg", "none"] = Field(
        "auto", description="auto: as recorded when a viewer can play it, else encoded once as H.264"
    )
    debug_images: Literal["none", "crops", "full"] = Field("crops", description="debug pictures of each marker")
    debug_rate_hz: float = Field(4.0, gt=0, description="debug pictures a second and marker, at most")
    compression: Literal["zstd", "lz4", "none"] = Field("zstd", description="MCAP chunk compression")


class Settings(StageConfig):
    """Everything that decides the output, besides the input and the seeds."""

    camera: CameraSettings = CameraSettings()
    markers: tuple[MarkerSettings, ...] = ()
    chain: ChainConfig = ChainConfig()
    session: SessionConfig = SessionConfig()
    output: OutputSettings = OutputSettings()

    @field_validator("markers")
    @classmethod
    def _unique(cls, markers: tuple[MarkerSettings, ...]) -> tuple[MarkerSettings, ...]:
        names = [m.name for m in markers]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"marker {name!r} is there twice")
        return markers

    def to_toml(self) -> str:
        """Every key with its value, as TOML that `load_settings` reads back."""
        return "\n".join(_toml_lines(self.model_dump(exclude_none=True), ())).strip() + "\n"


def load_settings(path: Path) -> Settings:
    """Read a settings file. Raises SettingsError with the key and what was expected."""
    try:
        return Settings.model_validate(_read_toml(path))
    except ValidationError as error:
        raise SettingsError(f"{path}: {_first_problem(error)}") from error


def load_seeds(path: Path) -> list[Seed]:
    """Read a seeds file: [[seeds]] with marker, frame, x_px, y_px, r_px. Raises SettingsError."""
    rows = _read_toml(path)
    if set(rows) != {"seeds"} or not isinstance(rows["seeds"], list):
        raise SettingsError(f"{path}: expected [[seeds]] tables with marker, frame, x_px, y_px, r_px")
    seeds = []
    for number, row in enumerate(rows["seeds"], 1):
        if not isinstance(row, dict) or set(row) != {"marker", "frame", "x_px", "y_px", "r_px"}:
            raise SettingsError(f"{path}: seed {number} must have marker, frame, x_px, y_px and r_px, nothing else")
        try:
            circle = Circle(float(row["x_px"]), float(row["y_px"]), float(row["r_px"]))
            seeds.append(Seed(str(row["marker"]), int(row["frame"]), circle))
        except (TypeError, ValueError) as error:
            raise SettingsError(f"{path}: seed {number}: {error}") from error
    return seeds


def seeds_toml(seeds: list[Seed]) -> str:
    """A seeds file's text, which `load_seeds` reads back."""
    return "\n".join(
        f'[[seeds]]\nmarker = "{s.marker}"\nframe = {s.frame_index}\n'
        f"x_px = {s.circle.x_px!r}\ny_px = {s.circle.y_px!r}\nr_px = {s.circle.r_px!r}\n"
        for s in seeds
    )


_SEED = re.compile(r"([A-Za-z0-9_]+)@(\d+)=([-+0-9.eE]+),([-+0-9.eE]+),([-+0-9.eE]+)")


def parse_seed(text: str) -> Seed:
    """`left_wrist@0=812,430,24`: marker, frame, centre and radius in pixels. Raises SettingsError."""
    found = _SEED.fullmatch(text.strip())
    try:
        if found is None:
            raise ValueError
        return Seed(found[1], int(found[2]), Circle(float(found[3]), float(found[4]), float(found[5])))
    except ValueError:
        raise SettingsError(f"seed {text!r} is not MARKER@FRAME=X,Y,R, such as left_wrist@0=812,430,24") from None


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise SettingsError(f"{path}: no such file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise SettingsError(f"{path}: cannot be read: {error}") from error
    except tomllib.TOMLDecodeError as error:
        raise SettingsError(f"{path}: not TOML: {error}") from error


def _first_problem(error: ValidationError) -> str:
    first = error.errors()[0]
    key = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        return f"unknown key {key!r}; `spheremcap config show` lists every key"
    return f"{key}: {first['msg']} (found {first['input']!r})" if key else str(first["msg"])


def _toml_lines(table: dict[str, Any], path: tuple[str, ...]) -> list[str]:
    lines = []
    plain = {k: v for k, v in table.items() if not _is_table(v)}
    if plain and path:
        lines += ["", f"[{'.'.join(path)}]"]
    lines += [f"{key} = {_toml_value(value)}" for key, value in plain.items()]
    for key, value in table.items():
        if isinstance(value, dict):
            lines += _toml_lines(value, (*path, key))
        elif _is_table(value):
            for row in value:
                lines += ["", f"[[{'.'.join((*path, key))}]]"]
                lines += [f"{k} = {_toml_value(v)}" for k, v in row.items()]
    return lines


def _is_table(value: Any) -> bool:
    return isinstance(value, dict) or (isinstance(value, list | tuple) and bool(value) and isinstance(value[0], dict))


def _toml_value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_toml_value(v) for v in value) + "]"
    return f'"{value}"' if isinstance(value, str) else repr(value)
