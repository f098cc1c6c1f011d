"""A layout for Foxglove and Lichtblick that shows a recording of ours, to import in their layout menu.

It is made from what the recording has (`contents`). Keys are those of both viewers' published panel settings. Image
sync is off, for with it video that is coded between pictures stays black in Lichtblick.
"""

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from spheremcap.errors import UsageError
from spheremcap.io import _pb
from spheremcap.io.contents import CameraContents, Contents, HandContents, SensorContents, contents
from spheremcap.io.messages import Rgb, marker_rgb
from spheremcap.io.output import whole_file

Panel = dict[str, Any]
Node = str | Panel
"""A panel's id, or two nodes side by side or one above the other."""

LABEL_M, AXES_M = 0.035, 0.15
AXES_RGB: dict[str, Rgb] = {"x": (0.88, 0.30, 0.30), "y": (0.35, 0.75, 0.35), "z": (0.30, 0.55, 1.0)}
"""The colours that axes have in both viewers' 3D panels."""
_GREY: Rgb = (0.55, 0.55, 0.55)
_ARM_PLOTS = {
    "speed_mps": ("Speed", "of the wrist [m/s]"),
    "elbow_deg": ("Elbow", "180 is a straight arm [deg]"),
    "gap_mm": ("Gap", "of the wrist, outward of the push's circle [mm]"),
}
"""What is plotted of both arms, and its title: in short, and more."""
_STATUS_ROW, _STATUS_HEAD = 7, 6
"""Height of a marker's row in the state panel, and of what is around the rows, in hundredths of the window."""


def layout_path(recording: str | os.PathLike[str]) -> Path:
    """Where a recording's layout is written beside it: session.layout.json for session.mcap."""
    return Path(recording).with_suffix(".layout.json")


def write_layout(
    recording: str | os.PathLike[str], out: str | os.PathLike[str], *, overwrite: bool = False
) -> tuple[str, ...]:
    """Write the layout for a recording; notes for the user come back. Raises SourceError, UsageError, OutputError."""
    return write_layout_of(contents(recording), recording, out, overwrite=overwrite)


def write_layout_of(
    found: Contents, recording: str | os.PathLike[str], out: str | os.PathLike[str], *, overwrite: bool = False
) -> tuple[str, ...]:
    """Write the layout for what a recording has, or will have. Raises UsageError, OutputError."""
    with whole_file(out, [Path(recording)], overwrite=overwrite) as part:
        part.path.write_text(json.dumps(layout(found), indent=2) + "\n", encoding="utf-8")
    return part.notes


def layout(found: Contents) -> Panel:
    """The layout as the viewers' JSON: pictures with what was found on them, space, positions, votes, status, lists; of
    an analysed recording also what the arms did, when hands were on the rim, and the strokes.

    Raises UsageError where there is nothing to show.
    """
    panels: dict[str, Panel] = {}

    def add(kind: str, name: str, panel: Panel) -> Node:
        panels[f"{kind}!{name}"] = panel
        return f"{kind}!{name}"

    def tabs(name: str, title: str, shown: Sequence[tuple[str, Node]]) -> list[Node]:
        """A panel of tabs; the only one's content, where there is but one."""
        if len(shown) < 2:
            return [node for _, node in shown]
        listed = [{"title": label, "layout": node} for label, node in shown]
        return [add("Tab", name, _titled(title, {"activeTabIdx": 0, "tabs": listed}))]

    pictures: list[Node] = []
    spaces: list[tuple[str, Node]] = []
    positions: list[tuple[str, Node]] = []
    votes: list[tuple[str, Node]] = []
    stages: list[Node] = []
    states: list[tuple[str, Node]] = []
    logs: list[tuple[str, Node]] = []
    asked: list[tuple[str, Node]] = []
    transitions: list[Panel] = []
    for camera in found.cameras:
        t, name = camera.topics, camera.name
        place = f"{name}/" if name else ""
        if camera.picture:
            pictures.append(add("Image", f"{place}picture", _picture(name or "Picture", camera)))
        if len(camera.xyz_cam_m):
            spaces.append((name, add("3D", f"{place}space", _space(name or "Space", camera))))
        for number, marker in enumerate(camera.markers):
            positions.append((place + marker, add("Plot", f"{place}position_{marker}", _position(camera, marker))))
            if t.debug(marker) in found.topics:
                stages.append(add("Image", f"{place}stages_{marker}", _image(place + marker, t.debug(marker))))
            path = {"topicPath": t.state(marker)}
            states.append((place + marker, add("Table", f"{place}state_{marker}", _titled(place + marker, path))))
            label = {"value": f"{t.state(marker)}.status", "label": place + marker, "timestampMethod": "receiveTime"}
            transitions.append(label | {"color": _hex(marker_rgb(number))})
        if any(t.votes(marker) in found.topics for marker in camera.markers):
            votes.append((name, add("Plot", f"{place}votes", _votes(camera))))
        if t.log in found.topics:
            logs.append((f"Log {name}".strip(), add("RosOut", f"{place}log", _log(t.log))))
        if t.requests in found.topics:
            asked.append((f"Requests {name}".strip(), add("RawMessages", f"{place}requests", _requests(t.requests))))
    sensors: list[tuple[str, Node]] = []
    for sensor in found.sensors:
        title = sensor.topic.removeprefix("/").removeprefix("sensors/")
        sensors.append((title, add("Plot", f"sensor_{title}", _sensor(title, sensor))))
    for sensor in found.residuals:
        title = sensor.topic.removeprefix("/")
        sensors.append((title, add("Plot", title.replace("/", "_"), _sensor(title, sensor))))

    arms: list[tuple[str, Node]] = []
    for field, (short, more) in _ARM_PLOTS.items():
        lines = _arm_lines(found.hands, field)
        if lines:
            arms.append((short, add("Plot", f"arms_{field}", _plot(f"{short} {more}", lines))))
    for hand in found.hands:
        if hand.strokes:
            title, path = f"Strokes {hand.name}", {"topicPath": hand.strokes}
            arms.append((title, add("Table", f"{hand.name}/strokes", _titled(title, path))))
    on_rim = [
        {"value": f"{hand.events}.kind", "label": f"{hand.name} hand", "timestampMethod": "receiveTime"}
        | {"color": _hex(marker_rgb(number))}
        for number, hand in enumerate(found.hands)
        if hand.events
    ]
    transitions = [*on_rim, *transitions]

    lists = [("Stages", _grid(stages))] if stages else []
    lists += [*logs, *asked, *([("States", _grid([node for _, node in states]))] if states else [])]
    status = add("StateTransitions", "status", _titled("Status", {"isSynced": True, "paths": transitions}))
    left = [
        *([_grid(pictures)] if pictures else []),
        *tabs("lists", "Log, requests, stages, states", lists),
    ]
    if arms:  # beside them there is less room
        positions, votes = [*positions, *((f"Votes {name}".strip(), node) for name, node in votes)], []
    right = [
        *tabs("spaces", "Space", spaces), *tabs("arms", "Arms and strokes", arms),
        *tabs("positions", "Positions", positions), *tabs("votes", "Votes", votes),
        *tabs("sensors", "Sensors", sensors),
    ]  # fmt: skip
    share = min(_STATUS_HEAD + _STATUS_ROW * len(transitions), 50)
    if transitions:
        right = [_split("column", _stack(right), status, 100 - share)] if right else [status]
    if not left and not right:
        raise UsageError("there is nothing in it that a layout could show: neither markers of ours nor sensors")
    columns = [
        *([_stack(left, 60)] if left else []),
        *([_stack(right)] if right else []),
    ]
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": _speed(found.rate_hz)},
        "layout": _split("row", columns[0], columns[1], 57) if len(columns) == 2 else columns[0],
    }


def _speed(rate_hz: float) -> float:
    """Slow enough to follow each picture, of those speeds that viewers offer."""
    return 0.25 if rate_hz > 150 else 0.5 if rate_hz > 80 else 1.0


# --- panels ---


def _titled(title: str, panel: Panel) -> Panel:
    """Both viewers' keys for a panel's title."""
    return {"foxglovePanelTitle": title, "lichtblickPanelTitle": title, **panel}


def _image(title: str, topic: str) -> Panel:
    return _titled(title, {
        "synchronize": False, "imageMode": {"imageTopic": topic, "synchronize": False}, "topics": {}, "layers": {},
        "scene": {}, "transforms": {},
    })  # fmt: skip


def _picture(title: str, camera: CameraContents) -> Panel:
    """The picture with its annotations; without calibration where there is none, and without spheres over markers."""
    panel = _image(title, camera.picture)
    panel["imageMode"]["annotations"] = {camera.topics.annotations: {"visible": True}}
    if camera.calibration:
        panel["imageMode"]["calibrationTopic"] = camera.calibration
    panel["topics"] = {camera.topics.scene: {"visible": False}}
    return panel


def _space(title: str, camera: CameraContents) -> Panel:
    """All markers with their paths, seen from beside the camera, as near as shows what they did."""
    t, xyz = camera.topics, camera.xyz_cam_m
    middle = np.median(xyz, axis=0)
    low, high = np.percentile(xyz, (2, 98), axis=0)
    away_m = float(np.linalg.norm(middle))
    distance_m = max(0.35 * away_m, 1.4 * float(np.linalg.norm(high - low)), 0.3)
    own_world = camera.world == t.optical_frame or camera.world.endswith(t.optical_frame)
    x, y, z = middle.tolist()
    aim = [x, y, z] if own_world else [z, -x, -y]
    shown: Panel = {t.scene: {"visible": True}}
    for marker in camera.markers:
        shown[t.pose(marker)] = shown[t.smoothed(marker)] = {"visible": False}
    if camera.calibration:
        shown[camera.calibration] = {"visible": True, "distance": 0.3, "width": 0.005}
    size_m = max(1, round(2 * away_m))
    frames: Panel = {f"frame:{t.debug_frame}": {"visible": False}}
    if camera.chair:
        frames[f"frame:{camera.chair}"] = {"visible": True}
    return _titled(title, {
        "followTf": camera.world,
        "followMode": "follow-none",
        "cameraState": {
            "perspective": True, "distance": round(distance_m, 3), "phi": 65, "thetaOffset": 55, "target": [0, 0, 0],
            "targetOffset": [round(v, 3) for v in aim], "targetOrientation": [0, 0, 0, 1], "fovy": 45,
            "near": 0.01, "far": 200,
        },
        "topics": shown,
        "layers": {"grid": {
            "layerId": "foxglove.Grid", "instanceId": "grid", "visible": True, "size": size_m, "divisions": 2 * size_m,
            "frameId": camera.world, "position": [size_m / 2, 0, 0], "rotation": [0, 0, 0], "color": "#24486e99",
        }},
        "scene": {"transforms": {"axisScale": AXES_M, "showLabel": True, "labelSize": LABEL_M}},
        "transforms": frames,
        "imageMode": {},
    })  # fmt: skip


def _position(camera: CameraContents, marker: str) -> Panel:
    """Metres: measured, and smoothed pale below it. Else pixels: verified, and all circles pale below them.

    Viewers draw the first of the lines over the others.
    """
    t = camera.topics
    if len(camera.xyz_cam_m):
        before, over = f"{t.smoothed(marker)}.pose.position.", f"{t.pose(marker)}.pose.position."
        names, title, ends = ("measured", "smoothed"), "in the camera's frame [m]", "xyz"
        paths = [f"{over}{axis}" for axis in ends], [f"{before}{axis}" for axis in ends]
    else:
        verified = _pb.MarkerState.Status.Value("VERIFIED")
        before, over = f"{t.state(marker)}.circle.", f"{t.state(marker)}{{status=={verified}}}.circle."
        names, title, ends = ("verified", "all"), "on the picture [px]", "xyr"
        paths = [f"{over}{axis}_px" for axis in ends], [f"{before}{axis}_px" for axis in ends]
    colors = list(AXES_RGB.values())
    lines = [
        _line(path, f"{axis} {name}", rgb if name == names[0] else _pale(rgb), size=1.5 if name == names[0] else 1.0)
        for name, those in zip(names, paths, strict=True)
        for path, axis, rgb in zip(those, ends, colors, strict=True)
    ]
    return _plot(f"{marker} {title}", lines)


def _arm_lines(hands: Sequence[HandContents], field: str) -> list[Panel]:
    """A field of the arms' samples, of those hands that have it."""
    return [
        _line(f"{hand.arm.topic}.{field}", hand.name, marker_rgb(number))
        for number, hand in enumerate(hands)
        if field in hand.arm.numbers
    ]


def _votes(camera: CameraContents) -> Panel:
    lines = [
        _line(f"{camera.topics.votes(marker)}.sum", marker, marker_rgb(number))
        for number, marker in enumerate(camera.markers)
    ]
    limits = [
        _line(value, label, _GREY) | {"showLine": True} for value, label in (("4", "accepted"), ("3", "rejected"))
    ]
    return _plot("Votes: accepted above 4 of 6, rejected below 3", [*lines, *limits]) | {
        "minYValue": 0, "maxYValue": 6.2
    }  # fmt: skip


def _sensor(title: str, sensor: SensorContents) -> Panel:
    """All numbers of a sensor, of which those of its first quantity are ticked: units are not mixed in one plot."""
    quantity = sensor.numbers[0].rpartition(".")[0] if sensor.numbers else ""
    lines = []
    for number, path in enumerate(sensor.numbers):
        rgb = AXES_RGB.get(path.rpartition(".")[2]) or marker_rgb(number)
        ticked = path.rpartition(".")[0] == quantity if quantity else number == 0
        label = " ".join(reversed(path.rpartition(".")[::2])).strip()  # the axis first: legends are narrow
        lines.append(_line(f"{sensor.topic}.{path}", label, rgb) | {"enabled": ticked, "showLine": True})
    return _plot(title, lines)


def _plot(title: str, paths: list[Panel]) -> Panel:
    return _titled(title, {
        "paths": paths, "xAxisVal": "timestamp", "isSynced": True, "showLegend": True, "legendDisplay": "left",
        "showXAxisLabels": True, "showYAxisLabels": True, "showPlotValuesInLegend": False, "sidebarDimension": 170,
    })  # fmt: skip


def _line(path: str, label: str, rgb: Rgb, size: float = 1.0) -> Panel:
    """Points without lines, so that none goes across frames on which nothing was measured."""
    return {
        "value": path, "label": label, "enabled": True, "timestampMethod": "receiveTime", "showLine": False,
        "lineSize": size, "color": _hex(rgb),
    }  # fmt: skip


def _log(topic: str) -> Panel:
    return _titled("Log", {"searchTerms": [], "minLogLevel": 1, "topicToRender": topic})


def _requests(topic: str) -> Panel:
    return _titled("Where a person is asked", {
        "topicPath": topic, "diffEnabled": False, "diffMethod": "custom", "diffTopicPath": "",
        "showFullMessageForDiff": False,
    })  # fmt: skip


def _hex(rgb: Rgb) -> str:
    return "#" + "".join(f"{round(255 * c):02x}" for c in rgb)


def _pale(rgb: Rgb) -> Rgb:
    r, g, b = (0.45 * c + 0.3 for c in rgb)
    return r, g, b


# --- places ---


def _split(direction: str, first: Node, second: Node, percentage: float) -> Panel:
    return {"direction": direction, "first": first, "second": second, "splitPercentage": percentage}


def _stack(nodes: Sequence[Node], first: float | None = None) -> Node:
    """One above the other, all as high; or the first with that percentage."""
    if len(nodes) == 1:
        return nodes[0]
    return _split("column", nodes[0], _stack(nodes[1:]), round(100 / len(nodes)) if first is None else first)


def _grid(nodes: Sequence[Node]) -> Node:
    """Two in a row, and the rows one above the other."""
    rows = [nodes[k : k + 2] for k in range(0, len(nodes), 2)]
    return _stack([row[0] if len(row) == 1 else _split("row", row[0], row[1], 50) for row in rows])
