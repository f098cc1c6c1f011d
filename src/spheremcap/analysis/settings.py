"""What a person says of the chair for the analysis: wheels, where the camera is, which marker is which joint."""

from pathlib import Path
from typing import Literal

from pydantic import Field, ValidationError, field_validator

from spheremcap.core.stage import StageConfig
from spheremcap.errors import SettingsError
from spheremcap.io.toml_file import first_problem, read_toml

Xyz = tuple[float, float, float]

JOINTS = ("wrist", "elbow", "shoulder", "hip")
SIDES = ("left", "right")


class WheelSettings(StageConfig):
    """The rear wheels, by tape measure; what is not given is not used, and what would need it is not there."""

    radius_m: float | None = Field(None, gt=0.05, lt=1, description="of the wheel with its tyre, metres")
    rim_radius_m: float | None = Field(None, gt=0.05, lt=1, description="of the push rim (its tube's middle), metres")
    camber_deg: float = Field(0.0, ge=0, lt=45, description="how far the tops lean inward, degrees")
    track_m: float | None = Field(None, gt=0.1, lt=2, description="from hub to hub, metres")
    track_sd_m: float = Field(0.005, gt=0, lt=1, description="how sure that is, metres")
    left: str | None = Field(
        None, description="the left wheel's sensor, its topic without /sensors/; by its name if not"
    )
    right: str | None = Field(None, description="the right wheel's sensor")
    reverse: bool = Field(False, description="the sensor's angle falls when the chair goes forward")


class PointSettings(StageConfig):
    """A tracked marker that is fixed to the chair at a known place."""

    marker: str = Field(description="its name in the recording")
    xyz_chair_m: Xyz = Field(description="where it is in the chair's frame, metres")
    sd_m: float = Field(0.003, gt=0, lt=1, description="how sure that is, metres")


class ChairSettings(StageConfig):
    """Where the camera is on the chair. Whatever is given is put together; strokes alone give the axle."""

    camera_xyz_chair_m: Xyz | None = Field(
        None, description="the lens in the chair's frame by tape measure: forward of the axle, to the left, above it"
    )
    camera_xyz_sd_m: float = Field(0.005, gt=0, lt=1, description="how sure that is, metres")
    camera_down_deg: float | None = Field(None, gt=-90, lt=90, description="how far down it looks, by inclinometer")
    camera_down_sd_deg: float = Field(0.5, gt=0, lt=45, description="how sure that is, degrees")
    looks: Literal["back", "forward"] | None = Field(None, description="None: told by where left and right are seen")
    clicks: str | None = Field(None, description="session.chair.toml of `annotate`, relative to the settings file")
    front_xyz_chair_m: Xyz | None = Field(None, description="where the point clicked as `front` is")
    points: tuple[PointSettings, ...] = Field((), description="markers fixed to the chair")


class AnalysisSettings(StageConfig):
    """All of it; an empty file will do."""

    wheel: WheelSettings = WheelSettings()
    chair: ChairSettings = ChairSettings()
    markers: dict[str, str] = Field(
        {}, description='which marker is which joint where names do not say: left_wrist = "green"'
    )

    @field_validator("markers")
    @classmethod
    def _joints(cls, markers: dict[str, str]) -> dict[str, str]:
        known = [f"{side}_{joint}" for side in SIDES for joint in JOINTS]
        for joint in markers:
            if joint not in known:
                raise ValueError(f"{joint!r} is no joint; expected one of {', '.join(known)}")
        for marker in markers.values():
            joints = [joint for joint, other in markers.items() if other == marker]
            if len(joints) > 1:
                raise ValueError(f"{marker!r} cannot be {' and '.join(joints)}")
        return markers

    def marker_of(self, side: str, joint: str, names: tuple[str, ...]) -> str | None:
        """The marker that is a joint: the one given, else the only one whose name has side and joint in it and which is
        no other joint."""
        given = self.markers.get(f"{side}_{joint}")
        if given is not None:
            return given if given in names else None
        free = [name for name in names if name not in self.markers.values()]
        found = [name for name in free if joint in name.lower() and side in name.lower()]
        return found[0] if len(found) == 1 else None


def load_analysis_settings(path: Path) -> AnalysisSettings:
    """Read an analysis.toml. Raises SettingsError."""
    try:
        return AnalysisSettings.model_validate(read_toml(path))
    except ValidationError as error:
        raise SettingsError(f"{path}: {first_problem(error)}") from error
