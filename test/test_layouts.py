# SPDX-License-Identifier: BSD-3-Clause
"""Layouts of RViz, Foxglove and PlotJuggler: topics and fields in them exist, with the type that is wanted."""

from __future__ import annotations

import json
import re
from xml.etree import ElementTree

import pytest
import yaml
from conftest import ROOT

from coman_reduced_model.bag.types import typestore
from coman_reduced_model.messages import INPUT_TYPES
from coman_reduced_model.topics import INPUT_TOPICS, OUTPUT_TYPES

TOPICS = {
    **{f"/{topic}": INPUT_TYPES[stream] for stream, topic in INPUT_TOPICS.items()},
    **{f"/{topic.lstrip('/')}": kind for topic, kind in OUTPUT_TYPES.items()},
    "/com/markers": "visualization_msgs/msg/MarkerArray",
    "/com/reference_path": "nav_msgs/msg/Path",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}
RVIZ = yaml.safe_load((ROOT / "rviz/coman.rviz").read_text())
FOXGLOVE = json.loads((ROOT / "rviz/foxglove.json").read_text())
PLOTJUGGLER = ElementTree.parse(ROOT / "rviz/plotjuggler.xml").getroot()
PANELS = FOXGLOVE["configById"]
SHOWN_BY = {  # display of RViz: type
    "RobotModel": "std_msgs/msg/String",
    "MarkerArray": "visualization_msgs/msg/MarkerArray",
    "PointStamped": "geometry_msgs/msg/PointStamped",
    "Path": "nav_msgs/msg/Path",
    "Odometry": "nav_msgs/msg/Odometry",
}


def type_of(path):
    """Type of a field by topic and names, such as /com/prediction.residual.x; fails where there is none."""
    topic = max((topic for topic in TOPICS if re.match(rf"{topic}[./]", path)), key=len)
    kind = TOPICS[topic]
    for name in re.split(r"[./]", path[len(topic) + 1 :]):
        bare, index = re.fullmatch(r"(\w+)(\[\d+\])?", name).groups()
        _, of = dict(typestore().get_msgdef(kind).fields)[bare]
        if index:
            (_, of), _ = of
        kind = of if isinstance(of, str) else of[0]
    return kind


@pytest.mark.parametrize("display", RVIZ["Visualization Manager"]["Displays"], ids=lambda display: display["Name"])
def test_displays_of_rviz_show_topics_of_their_type(display):
    kind = display["Class"].removeprefix("rviz_default_plugins/")
    if kind != "Grid":
        topic = display.get("Topic") or display["Description Topic"]
        assert TOPICS[f"/{topic['Value']}"] == SHOWN_BY[kind]
        latched = topic["Value"] in ("robot_description", "com/reference_path")
        assert (topic["Durability Policy"] == "Transient Local") == latched


def test_rviz_stands_in_odom():
    assert RVIZ["Visualization Manager"]["Global Options"]["Fixed Frame"] == "odom"


def test_panels_of_foxglove_are_placed_and_their_topics_and_fields_exist():
    placed, rest = set(), [FOXGLOVE["layout"]]
    while rest:
        node = rest.pop()
        if isinstance(node, str):
            placed.add(node)
        else:
            rest += [node["first"], node["second"]]
    assert placed == set(PANELS)
    assert set(PANELS["3D!coman"]["topics"]) <= set(TOPICS)
    assert PANELS["DiagnosticSummary!coman"]["topicToRender"] in TOPICS
    paths = [path["value"] for panel in PANELS.values() for path in panel.get("paths", ())]
    assert len(paths) > 10 and {type_of(path) for path in paths} <= {"float64", "uint8"}


def test_curves_of_plotjuggler_exist():
    names = [curve.get("name") for curve in PLOTJUGGLER.iter("curve")]
    assert len(names) > 10 and {type_of(name) for name in names} <= {"float64", "uint8"}
    assert {topic.get("name") for topic in PLOTJUGGLER.iter("topic")} == {"/com/prediction"}
