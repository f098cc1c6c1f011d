"""A layout for Foxglove and Lichtblick that shows a recording of ours, to import in their layout menu."""

import json
from collections.abc import Sequence
from typing import Any, Literal

from spheremcap.io.messages import MARKER_RGB
from spheremcap.io.topics import WORLD_FRAME, Topics

Panel = dict[str, Any]
PLAYBACK_SPEED = 0.25
"""Slow enough to follow 240 pictures a second."""


def layout(
    markers: Sequence[str], topics: Topics | None = None, pictures: Literal["video", "image"] = "video"
) -> dict[str, Any]:
    """The layout for `markers` as the viewers' JSON: annotated picture, 3D, positions, votes, status, log.

    `pictures` says whether the recording has H.264 or H.265 ("video") or JPEG ("image"). Synchronised
    annotations are off: with them on, video that is coded between pictures stays black in Lichtblick.
    """
    t = topics or Topics()
    panels: dict[str, Panel] = {
        "Image!picture": _image("Picture", t.video if pictures == "video" else t.image, t),
        "3D!scene": _scene(t, markers),
        "Plot!position": _plot("Position, camera frame [m]", [
            _line(f"{t.pose(m)}.pose.position.{axis}", f"{m} {axis}", i)
            for i, m in enumerate(markers) for axis in "xyz"
        ]),
        "Plot!votes": _plot("Sum of votes, 0 to 6 (accepted above 4, rejected below 3)", [
            _line(f"{t.votes(m)}.sum", m, i) for i, m in enumerate(markers)
        ]),
        "StateTransitions!status": _titled("Status", {
            "isSynced": True,
            "paths": [
                {"value": f"{t.state(m)}.status", "label": m, "timestampMethod": "receiveTime"}
                for m in markers
            ],
        }),
        "RosOut!log": _titled("Log", {"searchTerms": [], "minLogLevel": 1, "topicToRender": t.log}),
        "RawMessages!requests": _titled("Where a person is asked", {
            "topicPath": t.requests, "diffEnabled": False, "diffMethod": "custom", "diffTopicPath": "",
            "showFullMessageForDiff": False,
        }),
    }  # fmt: skip
    debug = []
    states = []
    for name in markers:
        panels[f"Image!debug_{name}"] = _image(f"{name}: what the stages saw", t.debug(name), None)
        panels[f"Table!state_{name}"] = _titled(f"{name}: state", {"topicPath": t.state(name)})
        debug.append({"title": name, "layout": f"Image!debug_{name}"})
        states.append({"title": name, "layout": f"Table!state_{name}"})
    panels["Tab!debug"] = _titled("Stages", {"activeTabIdx": 0, "tabs": debug})
    log = {"title": "Log", "layout": "RosOut!log"}
    requests = {"title": "Requests", "layout": "RawMessages!requests"}
    panels["Tab!lists"] = _titled("Lists", {"activeTabIdx": 0, "tabs": [log, requests, *states]})
    left = _split("column", "Image!picture", _split("row", "Tab!debug", "Tab!lists", 55), 58)
    plots = _split("column", "Plot!votes", "StateTransitions!status", 60)
    right = _split("column", "3D!scene", _split("column", "Plot!position", plots, 45), 38)
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": PLAYBACK_SPEED},
        "layout": _split("row", left, right, 58),
    }


def layout_json(
    markers: Sequence[str], topics: Topics | None = None, pictures: Literal["video", "image"] = "video"
) -> str:
    """`layout` as the text of a file that the viewers import."""
    return json.dumps(layout(markers, topics, pictures), indent=2) + "\n"


def _titled(title: str, panel: Panel) -> Panel:
    """Both viewers' keys for a panel's title."""
    return {"foxglovePanelTitle": title, "lichtblickPanelTitle": title, **panel}


def _split(direction: str, first: Any, second: Any, percentage: int) -> Panel:
    return {"direction": direction, "first": first, "second": second, "splitPercentage": percentage}


def _image(title: str, topic: str, camera: Topics | None) -> Panel:
    """An image panel; with `camera`, its annotations and calibration, and no 3D spheres over them."""
    mode: Panel = {"imageTopic": topic, "synchronize": False}
    shown: Panel = {}
    if camera is not None:
        mode["calibrationTopic"] = camera.calibration
        mode["annotations"] = {camera.annotations: {"visible": True}}
        shown[camera.scene] = {"visible": False}
    return _titled(title, {
        "synchronize": False, "imageMode": mode, "topics": shown, "layers": {}, "scene": {}, "transforms": {},
    })  # fmt: skip


def _scene(topics: Topics, markers: Sequence[str]) -> Panel:
    shown: Panel = {topics.scene: {"visible": True}, topics.calibration: {"visible": True, "distance": 0.3}}
    for name in markers:
        shown[topics.smoothed(name)] = {"visible": False}
    return _titled("Camera frame", {
        "followTf": WORLD_FRAME,
        "followMode": "follow-none",
        "cameraState": {
            "perspective": True, "distance": 3.0, "phi": 60, "thetaOffset": 60, "target": [0, 0, 0],
            "targetOffset": [1.5, 0, 0], "targetOrientation": [0, 0, 0, 1], "fovy": 45, "near": 0.01,
            "far": 100,
        },
        "topics": shown,
        "layers": {"grid": {
            "layerId": "foxglove.Grid", "instanceId": "grid", "visible": True, "size": 4, "divisions": 8,
            "frameId": WORLD_FRAME, "position": [1.5, 0, 0], "rotation": [0, 0, 0],
        }},
        "scene": {"transforms": {"axisScale": 0.2, "showLabel": True}}, "transforms": {}, "imageMode": {},
    })  # fmt: skip


def _plot(title: str, paths: list[Panel]) -> Panel:
    return _titled(title, {
        "paths": paths, "xAxisVal": "timestamp", "isSynced": True, "showLegend": True,
        "legendDisplay": "floating", "showXAxisLabels": True, "showYAxisLabels": True,
        "showPlotValuesInLegend": True,
    })  # fmt: skip


def _line(path: str, label: str, index: int) -> Panel:
    r, g, b = (round(255 * c) for c in MARKER_RGB[index % len(MARKER_RGB)])
    return {
        "value": path, "label": label, "enabled": True, "timestampMethod": "receiveTime", "showLine": True,
        "lineSize": 1.0, "color": f"#{r:02x}{g:02x}{b:02x}",
    }  # fmt: skip
