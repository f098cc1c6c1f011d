"""Read a ROS camera_info YAML, as camera_calibration writes it."""

from pathlib import Path
from typing import Any

import yaml

from spheremcap.core.camera import Camera, DistortionModel
from spheremcap.errors import SettingsError

_MODELS: dict[str, DistortionModel] = {
    "plumb_bob": "plumb_bob",
    "rational_polynomial": "plumb_bob",
    "equidistant": "fisheye",
    "fisheye": "fisheye",
    "kannala_brandt": "fisheye",
}


def read_camera_info(path: Path) -> Camera:
    """The camera of a camera_info YAML (image_width, camera_matrix, distortion_model, distortion_coefficients).

    Raises SettingsError naming the file and what is missing.
    """
    try:
        data: Any = yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise SettingsError(f"{path}: no such file") from None
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise SettingsError(f"{path}: not a camera_info YAML: {' '.join(str(error).split())}") from error
    try:
        k = [float(x) for x in data["camera_matrix"]["data"]]
        distortion = tuple(float(x) for x in data.get("distortion_coefficients", {}).get("data", ()))
        width, height = int(data["image_width"]), int(data["image_height"])
        name = str(data.get("distortion_model", "plumb_bob"))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise SettingsError(
            f"{path}: not a camera_info YAML: image_width, image_height, camera_matrix.data and "
            f"distortion_coefficients.data are needed ({error})"
        ) from error
    if name not in _MODELS:
        raise SettingsError(f"{path}: distortion_model {name!r} is not one of {', '.join(_MODELS)}")
    if len(k) != 9:
        raise SettingsError(f"{path}: camera_matrix.data has {len(k)} numbers, 9 are needed")
    model: DistortionModel = _MODELS[name] if any(distortion) else "none"
    try:
        return Camera(
            width,
            height,
            k[0],
            k[4],
            k[2],
            k[5],
            model,
            distortion if model != "none" else (),
            source=path.name,
        )
    except ValueError as error:
        raise SettingsError(f"{path}: {error}") from error
