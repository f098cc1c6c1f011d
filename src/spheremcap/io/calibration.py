"""Calibrations as others write them, and Cameras: CameraCalibration and CameraInfo messages, camera_info YAML.

One reading for all of them. Coefficients that are left out are zero, as in OpenCV; a distortion model without a name
is ROS's plumb_bob; one of another name is an error, never a guess. No focal length (K[0] = 0) says: not calibrated.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from spheremcap.core.camera import Camera, DistortionModel
from spheremcap.errors import SettingsError, short
from spheremcap.io.input_file import settings_bytes

FOCAL_SD = "focal_sd"
"""Key of the focal length's relative uncertainty, for which neither message has a field: in the calibration channel's
metadata, and in a YAML."""
_MODELS: dict[str, DistortionModel] = {
    "": "plumb_bob",
    "plumb_bob": "plumb_bob",
    "rational_polynomial": "plumb_bob",
    "equidistant": "fisheye",
    "fisheye": "fisheye",
    "kannala_brandt": "fisheye",
}
_LENGTHS = {"plumb_bob": (4, 5, 8), "fisheye": (4,)}
_LARGEST_YAML_BYTES = 1 << 18


def camera_of(
    fields: Mapping[str, Any], source: str, *, rectified: bool = False, focal_sd: float = 0.0
) -> Camera | None:
    """The Camera of a message's fields (lower-case names: width, height, distortion_model, d, k, p); None when they say
    that it is not calibrated.

    A rectified picture has the projection matrix P and no distortion. Raises ValueError for what is no calibration.
    """
    try:
        k, d, p = [[float(x) for x in fields.get(name, ())] for name in ("k", "d", "p")]
        width, height = int(fields.get("width", 0)), int(fields.get("height", 0))
        name = str(fields.get("distortion_model", ""))
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"a calibration whose numbers are none ({short(error)})") from error
    if not k or k[0] == 0 or not width or not height:
        return None
    if len(k) != 9:
        raise ValueError(f"the camera matrix has {len(k)} numbers, 9 are needed")
    if rectified and len(p) == 12 and p[0] > 0:
        return Camera(width, height, p[0], p[5], p[2], p[6], focal_sd=focal_sd, source=source)
    if name not in _MODELS:
        known = ", ".join(filter(None, _MODELS))
        raise ValueError(f"distortion model {short(name)} is not supported; those that are: {known}")
    model = _MODELS[name]
    given = len(d)
    while d and d[-1] == 0:
        d.pop()
    if d:
        length = next((n for n in _LENGTHS[model] if n >= len(d)), None)
        if length is None:
            raise ValueError(f"distortion model {name!r} with {given} coefficients is not supported")
        d += [0.0] * (length - len(d))
    else:
        model = "none"
    return Camera(width, height, k[0], k[4], k[2], k[5], model, tuple(d), focal_sd, source)


def fields_of(camera: Camera) -> dict[str, Any]:
    """The fields of a CameraCalibration, by that message's names; `camera_of` reads them back."""
    d = list(camera.distortion)
    if camera.model == "fisheye":
        model = "kannala_brandt"
    else:
        model = "rational_polynomial" if len(d) == 8 else "plumb_bob"
        d += [0.0] * (5 - len(d))
    fx, fy, cx, cy = camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px
    return {
        "width": camera.width_px,
        "height": camera.height_px,
        "distortion_model": model,
        "D": d,
        "K": [fx, 0, cx, 0, fy, cy, 0, 0, 1],
        "R": [1, 0, 0, 0, 1, 0, 0, 0, 1],
        "P": [fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1, 0],
    }


def channel_metadata(camera: Camera) -> dict[str, str]:
    """What a calibration's channel says of the camera beside its messages."""
    return {FOCAL_SD: repr(camera.focal_sd)} if camera.focal_sd else {}


def focal_sd_of(metadata: Mapping[str, str]) -> float:
    """The uncertainty that a channel states, 0 where it states none. Raises ValueError for what is no number."""
    return float(metadata.get(FOCAL_SD, 0.0))


def read_camera_info(path: Path) -> Camera:
    """The camera of a camera_info YAML (image_width, camera_matrix, distortion_model, distortion_coefficients), as
    camera_calibration writes it; `focal_sd` may stand beside them.

    Raises SettingsError naming the file and what is missing.
    """
    data = _yaml(path)
    try:
        fields = {
            "width": data["image_width"],
            "height": data["image_height"],
            "k": data["camera_matrix"]["data"],
            "d": data.get("distortion_coefficients", {}).get("data", ()),
            "distortion_model": data.get("distortion_model", ""),
        }
        focal_sd = float(data.get(FOCAL_SD, 0.0))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise SettingsError(
            f"{path}: not a camera_info YAML: image_width, image_height, camera_matrix.data and "
            f"distortion_coefficients.data are needed ({short(error)})"
        ) from error
    try:
        camera = camera_of(fields, path.name, focal_sd=focal_sd)
    except ValueError as error:
        raise SettingsError(f"{path}: {error}") from error
    if camera is None:
        raise SettingsError(f"{path}: the camera is not calibrated: its size or focal length is 0")
    return camera


def write_camera_info(path: Path, camera: Camera) -> None:
    """Write a camera_info YAML as camera_calibration does, with `focal_sd`; `read_camera_info` reads it back."""
    fields = fields_of(camera)
    if camera.model == "fisheye":
        fields["distortion_model"] = "equidistant"  # as ROS has it
    data = {
        "image_width": fields["width"],
        "image_height": fields["height"],
        "camera_name": camera.source,
        "camera_matrix": _matrix(3, 3, fields["K"]),
        "distortion_model": fields["distortion_model"],
        "distortion_coefficients": _matrix(1, len(fields["D"]), fields["D"]),
        "rectification_matrix": _matrix(3, 3, fields["R"]),
        "projection_matrix": _matrix(3, 4, fields["P"]),
    }
    if camera.focal_sd:
        data[FOCAL_SD] = camera.focal_sd
    path.write_text(yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=120), encoding="utf-8")


def _matrix(rows: int, columns: int, numbers: Sequence[float]) -> dict[str, Any]:
    return {"rows": rows, "cols": columns, "data": list(map(float, numbers))}


def _yaml(path: Path) -> Any:
    data = settings_bytes(path, "a camera_info YAML", _LARGEST_YAML_BYTES)
    try:
        return yaml.safe_load(data.decode("utf-8-sig"))
    except RecursionError:
        raise SettingsError(f"{path}: not a camera_info YAML: nested too deeply") from None
    except (ValueError, TypeError, LookupError, AttributeError, OverflowError, yaml.YAMLError) as error:
        raise SettingsError(f"{path}: not a camera_info YAML: {short(error)}") from error
