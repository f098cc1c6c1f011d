"""The panel settings that viewers publish, by panel: each key's type, `?` after those that may be missing.

From the TypeScript types of Lichtblick 1.28 (PlotConfig, StateTransitionConfig, RendererConfig, ImageModeConfig, ...),
which Foxglove Studio had when it was open. A key that neither viewer knows is a mistake, so others are refused.
"""

from typing import Any

NUMBER, TEXT, SWITCH = (int, float), str, bool
COLOUR = r"#[0-9a-f]{6}([0-9a-f]{2})?"
TITLES = {"foxglovePanelTitle": TEXT, "lichtblickPanelTitle": TEXT}
PLOT_PATH = {
    "value": TEXT, "enabled": SWITCH, "timestampMethod": ("receiveTime", "headerStamp"), "color?": TEXT, "label?": TEXT,
    "showLine?": SWITCH, "lineSize?": NUMBER,
}  # fmt: skip
STATE_PATH = {"value": TEXT, "label?": TEXT, "color?": TEXT, "timestampMethod": ("receiveTime", "headerStamp")}
CAMERA_STATE = {
    "perspective": SWITCH, "distance": NUMBER, "phi": NUMBER, "thetaOffset": NUMBER, "target": [NUMBER],
    "targetOffset": [NUMBER], "targetOrientation": [NUMBER], "fovy": NUMBER, "near": NUMBER, "far": NUMBER,
}  # fmt: skip
RENDERER = TITLES | {"topics": dict, "layers": dict, "scene": dict, "transforms": dict, "imageMode": dict}
IMAGE_MODE = {"imageTopic": TEXT, "calibrationTopic?": TEXT, "annotations?": dict, "synchronize": SWITCH}
TRANSFORMS = {"axisScale": NUMBER, "showLabel": SWITCH, "labelSize": NUMBER}
PANELS: dict[str, dict[str, Any]] = {
    "Plot": TITLES | {
        "paths": [PLOT_PATH], "xAxisVal": ("timestamp", "index", "custom", "currentCustom"), "isSynced": SWITCH,
        "showLegend": SWITCH, "legendDisplay": ("floating", "top", "left", "none"), "showXAxisLabels": SWITCH,
        "showYAxisLabels": SWITCH, "showPlotValuesInLegend": SWITCH, "sidebarDimension": NUMBER, "minYValue?": NUMBER,
        "maxYValue?": NUMBER,
    },
    "StateTransitions": TITLES | {"isSynced": SWITCH, "paths": [STATE_PATH]},
    "RosOut": TITLES | {"searchTerms": [TEXT], "minLogLevel": NUMBER, "topicToRender": TEXT},
    "RawMessages": TITLES | {
        "topicPath": TEXT, "diffEnabled": SWITCH, "diffMethod": ("custom", "previous message"), "diffTopicPath": TEXT,
        "showFullMessageForDiff": SWITCH,
    },
    "Table": TITLES | {"topicPath": TEXT},
    "Tab": TITLES | {"activeTabIdx": NUMBER, "tabs": [{"title": TEXT, "layout": object}]},
    "Image": RENDERER | {"synchronize": SWITCH, "imageMode": IMAGE_MODE},
    "3D": RENDERER | {
        "followTf": TEXT, "followMode": ("follow-pose", "follow-position", "follow-none"), "cameraState": CAMERA_STATE,
        "scene": {"transforms": TRANSFORMS},
    },
}  # fmt: skip


def check(value: Any, wanted: Any, where: str) -> None:
    """Raises AssertionError where a value is not of the type."""
    if isinstance(wanted, dict):
        assert isinstance(value, dict), where
        known = {key.removesuffix("?"): kind for key, kind in wanted.items()}
        needed = {key for key in wanted if not key.endswith("?")}
        assert needed <= set(value) <= set(known), (where, set(value) ^ set(known))
        for key, inner in value.items():
            check(inner, known[key], f"{where}.{key}")
    elif isinstance(wanted, list):
        assert isinstance(value, list), where
        for number, inner in enumerate(value):
            check(inner, wanted[0], f"{where}[{number}]")
    elif isinstance(wanted, tuple) and isinstance(wanted[0], str):
        assert value in wanted, (where, value)
    else:
        assert isinstance(value, wanted), (where, value)
        assert wanted is not NUMBER or not isinstance(value, bool), where


def panels_placed(node: Any) -> list[str]:
    """The ids in a tree of panels."""
    if isinstance(node, str):
        return [node]
    check(
        node, {"direction": ("row", "column"), "first": object, "second": object, "splitPercentage": NUMBER}, "layout"
    )
    return [*panels_placed(node["first"]), *panels_placed(node["second"])]


def check_layout(layout: dict[str, Any]) -> None:
    """Raises AssertionError where a viewer would not take a layout as it is meant, or a panel is nowhere, or twice."""
    keys = {"configById": dict, "globalVariables": dict, "userNodes": dict, "playbackConfig": {"speed": NUMBER}}
    check(layout, keys | {"layout": object}, "")
    panels = layout["configById"]
    placed = panels_placed(layout["layout"])
    for name, panel in panels.items():
        check(panel, PANELS[name.partition("!")[0]], name)
        for tab in panel.get("tabs", ()):
            placed += panels_placed(tab["layout"])
    assert sorted(placed) == sorted(panels)
