"""Settings: the stages' own configs, composed, and how they are written in TOML. The seeds file is read here too."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import tomli_w
from pydantic import Field, ValidationError, field_validator, model_validator

from spheremcap.chain import ChainConfig
from spheremcap.core.circle import Circle
from spheremcap.core.marker import Answer, Hidden, Keep, MarkerSpec, Seed
from spheremcap.core.stage import StageConfig, length_m
from spheremcap.detection.colour import HUES
from spheremcap.detection.hues import GREYS, HUES_MEANT
from spheremcap.errors import SettingsError, short
from spheremcap.io.toml_file import first_problem, read_toml
from spheremcap.session import SessionConfig

_ALL_KEYS = "; `spheremcap config show` lists every key"


class CameraSettings(StageConfig):
    """One of: `preset`, `file` (ROS camera_info YAML), or all of fx_px, fy_px, cx_px, cy_px."""

    preset: str | None = Field(None, description="name of a camera preset; see `spheremcap config presets`")
    file: str | None = Field(None, description="ROS camera_info YAML, relative to the settings file")
    width_px: int | None = Field(None, gt=0, le=65535, description="picture size the numbers are for")
    height_px: int | None = Field(None, gt=0, le=65535, description="picture size the numbers are for")
    fx_px: float | None = Field(None, gt=0, description="focal length, pixels")
    fy_px: float | None = Field(None, gt=0, description="focal length, pixels")
    cx_px: float | None = Field(None, description="principal point, pixels, integer = pixel centre")
    cy_px: float | None = Field(None, description="principal point, pixels, integer = pixel centre")
    model: Literal["none", "plumb_bob", "fisheye"] = Field("none", description="distortion model")
    distortion: tuple[float, ...] = Field((), description="k1 k2 p1 p2 [k3 [k4 k5 k6]] or, fisheye, k1 k2 k3 k4")
    focal_sd: float = Field(
        0.0, ge=0, le=1, description="relative uncertainty of the focal length; 0: what the camera's source says of it"
    )
    exposure_s: float = Field(
        0.0, ge=0, le=1, description="exposure time in seconds for the motion blur model; 0: unknown"
    )
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

    name: str = Field(pattern=r"^[A-Za-z0-9_]+$", max_length=100, description="letters, digits, underscores")
    diameter_m: float = Field(0.04, gt=0, description='true diameter in metres (or `diameter = "4 cm"`)')
    colour: str | tuple[float, float] | None = Field(
        None,
        description=f"what `track --auto` looks for: {', '.join((*HUES_MEANT, *GREYS))}; or a first and a last hue, "
        "0..180 in steps of 2 degrees, as in [170, 10]",
    )

    @model_validator(mode="before")
    @classmethod
    def _length(cls, data: Any) -> Any:
        if isinstance(data, dict) and "diameter" in data:
            if "diameter_m" in data:
                raise ValueError("give diameter or diameter_m, not both")
            data = {k: v for k, v in data.items() if k != "diameter"} | {"diameter_m": length_m(data["diameter"])}
        return data

    @field_validator("diameter_m")
    @classmethod
    def _size_of_a_marker(cls, diameter_m: float) -> float:
        if not 0.001 <= diameter_m <= 1:
            unit = f"; if millimetres were meant, it is {diameter_m / 1000:g}" if diameter_m > 1 else ""
            raise ValueError(f"{diameter_m:g} m is no marker's size (1 mm to 1 m){unit}")
        return diameter_m

    @field_validator("colour")
    @classmethod
    def _a_colour(cls, colour: str | tuple[float, float] | None) -> str | tuple[float, float] | None:
        names = (*HUES_MEANT, *GREYS)
        if isinstance(colour, str) and colour not in names:
            raise ValueError(f"{short(colour)} is no colour that is known: {', '.join(names)}, or a range of hues")
        if isinstance(colour, tuple) and not all(0 <= hue <= HUES for hue in colour):
            raise ValueError(
                f"hues {list(colour)} are not all between 0 and {HUES}: steps of 2 degrees, so green is 60"
            )
        return colour

    def spec(self) -> MarkerSpec:
        return MarkerSpec(self.name, self.diameter_m)


class AutoSettings(StageConfig):
    """How `track --auto` looks for markers that nobody seeded."""

    seconds: float = Field(3.0, gt=0, le=60, description="seconds from the start in which markers are looked for")


class OutputSettings(StageConfig):
    """What goes into the recording besides the numbers."""

    video: Literal["auto", "passthrough", "h264", "jpeg", "none"] = Field(
        "auto", description="auto: as recorded when a viewer can play it, else encoded once as H.264"
    )
    debug_images: Literal["none", "crops", "full"] = Field("crops", description="debug pictures of each marker")
    debug_rate_hz: float = Field(
        1.0, gt=0, le=1000,
        description="debug pictures a second and marker from where it is doubted on; a twentieth while it is not",
    )  # fmt: skip
    compression: Literal["zstd", "lz4", "none"] = Field("zstd", description="MCAP chunk compression")


class Settings(StageConfig):
    """Everything that decides the output, besides the input and the seeds."""

    camera: CameraSettings = CameraSettings()
    markers: tuple[MarkerSettings, ...] = ()
    chain: ChainConfig = ChainConfig()
    session: SessionConfig = SessionConfig()
    auto: AutoSettings = AutoSettings()
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
        """Every key that has a value, as TOML that `load_settings` reads back."""
        tables = self.model_dump(exclude_none=True, exclude={"markers"})
        return tomli_w.dumps(tables) + "".join("\n" + marker_toml(marker) for marker in self.markers)


def marker_toml(marker: MarkerSettings) -> str:
    """A marker's table."""
    return "[[markers]]\n" + tomli_w.dumps(marker.model_dump(exclude_none=True))


def load_settings(path: Path) -> Settings:
    """Read a settings file. Raises SettingsError with the key and what was expected."""
    try:
        return Settings.model_validate(read_toml(path))
    except ValidationError as error:
        raise SettingsError(f"{path}: {first_problem(error, _ALL_KEYS)}") from error


def with_camera(settings: Settings, text: str) -> Settings:
    """The settings with another camera: a preset's name, or the path of a camera_info YAML. Raises SettingsError."""
    given: dict[str, Any] = {"exposure_s": settings.camera.exposure_s, "readout_s": settings.camera.readout_s}
    if text.endswith((".yaml", ".yml")):
        given["file"] = str(Path(text).absolute())
    else:
        given["preset"] = text
    return settings.model_copy(update={"camera": CameraSettings(**given)})


def with_diameter(settings: Settings, seeds: Sequence[Answer], text: str) -> Settings:
    """Settings that list the markers of the seeds with a diameter such as "4 cm". Raises SettingsError for one that is
    none, or where the settings list markers already.
    """
    if settings.markers:
        raise SettingsError(f"--diameter {short(text)}: the settings list their markers, each with its own")
    names = dict.fromkeys(seed.marker.rpartition("/")[2] for seed in seeds)
    try:
        markers = tuple(MarkerSettings(name=name, diameter_m=length_m(text)) for name in names)
    except ValidationError as error:
        raise SettingsError(f"--diameter {short(text)}: {first_problem(error)}") from error
    except ValueError as error:
        raise SettingsError(f"--diameter: {error}") from error
    return settings.model_copy(update={"markers": markers})


_RFC_3339 = r"^\d{4}-\d\d-\d\d[Tt ]\d\d:\d\d:\d\d(\.\d{1,9})?([Zz]|[-+]\d\d:\d\d)$"
_LAST_FRAME = 10**9


class _Row(StageConfig):
    """What every row of a seeds file has, or may have."""

    marker: str = Field(min_length=1, max_length=300)
    frame: int = Field(ge=0, le=_LAST_FRAME)
    author: str = Field("", max_length=300)
    time: str = Field("", max_length=40, pattern=f"^$|{_RFC_3339}")


class _SeedRow(_Row):
    """A seed as it is given: in a file, or in a text once its parts are numbers."""

    kind: Literal["circle"] = "circle"
    x_px: float = Field(ge=-1e5, le=1e5)
    y_px: float = Field(ge=-1e5, le=1e5)
    r_px: float = Field(gt=0, le=1e5)

    def answer(self) -> Seed:
        return Seed(self.marker, self.frame, Circle(self.x_px, self.y_px, self.r_px), self.author, self.time)


class _SpanRow(_Row):
    """What is said of several frames."""

    kind: Literal["hidden", "keep"]
    to_frame: int = Field(ge=0, le=_LAST_FRAME)

    @model_validator(mode="after")
    def _in_order(self) -> "_SpanRow":
        if self.to_frame < self.frame:
            raise ValueError(f"to_frame {self.to_frame} is before frame {self.frame}")
        return self

    def answer(self) -> Hidden | Keep:
        said = Hidden if self.kind == "hidden" else Keep
        return said(self.marker, self.frame, self.to_frame, self.author, self.time)


_KINDS = ("circle", "hidden", "keep")
_OPTIONAL = {"kind", "author", "time"}


def load_seeds(path: Path) -> list[Answer]:
    """Read a seeds file: [[seeds]] with marker, frame, x_px, y_px, r_px; or, of kind "hidden" or "keep", with marker,
    frame and to_frame. Each may have author and time. Raises SettingsError."""
    return answers_in(read_toml(path), str(path))


def answers_in(rows: dict[str, Any], path: str) -> list[Answer]:
    """What a seeds file says, read already; `path` is how errors call it. Raises SettingsError."""
    if set(rows) != {"seeds"} or not isinstance(rows["seeds"], list):
        raise SettingsError(f"{path}: expected [[seeds]] tables with marker, frame, x_px, y_px, r_px")
    answers: list[Answer] = []
    numbers: dict[tuple[str, int], int] = {}
    for number, row in enumerate(rows["seeds"], 1):
        said = row.get("kind", "circle") if isinstance(row, dict) else "circle"
        if said not in _KINDS:
            raise SettingsError(f"{path}: seed {number}: kind is {said!r}; expected one of {', '.join(_KINDS)}")
        spans = said != "circle"
        kind: type[_SeedRow | _SpanRow] = _SpanRow if spans else _SeedRow
        if not isinstance(row, dict) or set(row) - _OPTIONAL != set(kind.model_fields) - _OPTIONAL:
            needs = "marker, frame and to_frame" if spans else "marker, frame, x_px, y_px and r_px"
            raise SettingsError(
                f"{path}: seed {number} must have {needs}, and may have kind, author and time; nothing else"
            )
        try:
            answer = kind.model_validate(row).answer()
        except ValidationError as error:
            raise SettingsError(f"{path}: seed {number}: {first_problem(error)}") from error
        if isinstance(answer, Seed):
            same = numbers.setdefault((answer.marker, answer.frame_index), number)
            if same != number:
                raise SettingsError(
                    f"{path}: seeds {same} and {number} are both of {answer.marker} on frame {answer.frame_index}: "
                    "keep the right one"
                )
        answers.append(answer)
    return answers


def seeds_toml(answers: Sequence[Answer]) -> str:
    """A seeds file's text, which `load_seeds` reads back."""
    return "\n".join("[[seeds]]\n" + tomli_w.dumps(_row(answer)) for answer in answers)


def _row(answer: Answer) -> dict[str, str | int | float]:
    row: dict[str, str | int | float] = {"marker": answer.marker, "frame": answer.frame_index}
    if isinstance(answer, Seed):
        row |= {"x_px": answer.circle.x_px, "y_px": answer.circle.y_px, "r_px": answer.circle.r_px}
    else:
        row |= {"to_frame": answer.to_frame_index, "kind": "hidden" if isinstance(answer, Hidden) else "keep"}
    return row | {key: text for key, text in (("author", answer.author), ("time", answer.time)) if text}


_SEED = re.compile(r"(?P<marker>[^@]*)@(?P<frame>[^=]*)=(?P<x>[^,]*),(?P<y>[^,]*),(?P<r>[^,]*)")
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d{1,3})?", re.ASCII)


def parse_seed(text: str) -> Seed:
    """`left_wrist@0=812,430,24`: marker, frame, centre and radius in pixels. Raises SettingsError."""
    try:
        return _seed_of(text.strip())
    except ValueError as error:
        raise SettingsError(
            f"seed {short(text)}: {error}; expected MARKER@FRAME=X,Y,R, such as left_wrist@0=812,430,24"
        ) from None


def _seed_of(text: str) -> Seed:
    """Raises ValueError that names the part of the seed that is wrong."""
    found = _SEED.fullmatch(text)
    if found is None:
        commas = text.partition("=")[2].count(",")
        numbers = f"{commas + 1} number{'s' * (commas > 0)} after =, not 3"
        raise ValueError("no @ in it" if "@" not in text else "no = in it" if "=" not in text else numbers)
    if not re.fullmatch(r"[A-Za-z0-9_]+", found["marker"], re.ASCII):
        raise ValueError(f"the marker {short(found['marker'])} is not letters, digits and underscores")
    if not re.fullmatch(r"[0-9]{1,10}", found["frame"]):
        raise ValueError(f"the frame {short(found['frame'])} is not a whole number from 0 on")
    for name in "xyr":
        if not _NUMBER.fullmatch(found[name].strip()):
            raise ValueError(f"{name} {short(found[name])} is not a number")
    try:
        return _SeedRow(
            marker=found["marker"], frame=int(found["frame"]),
            x_px=float(found["x"]), y_px=float(found["y"]), r_px=float(found["r"]),
        ).answer()  # fmt: skip
    except ValidationError as error:
        raise ValueError(first_problem(error)) from None
