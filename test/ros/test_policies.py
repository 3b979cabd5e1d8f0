# SPDX-License-Identifier: BSD-3-Clause
"""The security policies are those of the nodes: nothing that they need is missing, and nothing else is allowed."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from coman_reduced_model.policies import policies, to_xml

ROOT = Path(__file__).resolve().parents[2]
OPTIONAL = {"/clock", "/tf", "/parameter_events"}  # with use_sim_time, with tf2_msgs, by rclpy's time source


def allowed(node: str, kind: str, access: str) -> set[str]:
    profile = ElementTree.fromstring(to_xml()).find(f".//profile[@node='{node}']/{kind}[@{access}='ALLOW']")
    assert profile is not None
    names = {str(each.text) for each in profile}
    return {n.replace("~", f"/{node}") if n[0] == "~" else n if n[0] == "/" else f"/{n}" for n in names}


def test_the_file_is_the_generated_one():
    assert (ROOT / "security" / "policies.xml").read_text() == to_xml()
    command = [sys.executable, "-m", "coman_reduced_model.policies"]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout == to_xml()


def test_no_policy_holds_a_wildcard():
    assert "*" not in to_xml()


@pytest.mark.ros
@pytest.mark.parametrize("node", [each.node for each in policies()])
def test_a_running_node_uses_what_is_allowed_and_nothing_else(node, start, nodes_compiled, peer):
    from ros_testing import robot_urdf
    from std_msgs.msg import String

    from coman_reduced_model.ros.interface import qos
    from coman_reduced_model.topics import DESCRIPTION

    process = start.node(node, **({"virtual_robot__compensate": True} if node == "virtual_robot" else {}))
    if node != "virtual_robot":
        peer.publisher(String, DESCRIPTION, qos.latched()).publish(peer.types.String(data=robot_urdf()))

    def used() -> dict[str, set[str]]:
        assert process.running, process.output
        if (node, "/") not in peer.node.get_node_names_and_namespaces():
            return {"subscribe": set(), "publish": set(), "reply": set()}
        return {
            "subscribe": {n for n, _ in peer.node.get_subscriber_names_and_types_by_node(node, "/")},
            "publish": {n for n, _ in peer.node.get_publisher_names_and_types_by_node(node, "/")},
            "reply": {n for n, _ in peer.node.get_service_names_and_types_by_node(node, "/")},
        }

    wanted = {
        "subscribe": allowed(node, "topics", "subscribe"),
        "publish": allowed(node, "topics", "publish"),
        "reply": allowed(node, "services", "reply"),
    }
    peer.wait(lambda: all(wanted[k] - OPTIONAL <= used()[k] for k in wanted), f"{wanted}; used: {used()}")
    assert all(used()[k] <= wanted[k] for k in wanted), {k: used()[k] - wanted[k] for k in wanted}
