# SPDX-License-Identifier: BSD-3-Clause
"""Least privilege for the nodes under SROS 2: an enclave each, with its own topics and services alone.

`python -m coman_reduced_model.policies > security/policies.xml` after the table of topics has changed.
"""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree import ElementTree

from .core.base.stream_names import REFERENCE
from .topics import DESCRIPTION, INPUT_TOPICS, OF_PREDICTOR, PLANNED_DEFLECTION

_PARAMETERS = (
    "describe_parameters", "get_parameter_types", "get_parameters", "list_parameters", "set_parameters",
    "set_parameters_atomically", "get_type_description",
)  # fmt: skip
_ALL_PUBLISH = ("/rosout", "/parameter_events", "/diagnostics")
_ALL_SUBSCRIBE = ("/clock", "/parameter_events")


@dataclass(frozen=True)
class Policy:
    """What one node may do; names as the node gives them, `~` being the node itself."""

    node: str
    subscribe: tuple[str, ...]
    publish: tuple[str, ...]
    reply: tuple[str, ...]


def policies() -> tuple[Policy, ...]:
    """Of the three nodes, from the table of topics."""
    sensors = tuple(topic for topic in INPUT_TOPICS.values() if topic != INPUT_TOPICS[REFERENCE])
    plan = INPUT_TOPICS[REFERENCE]
    common = tuple(f"~/{name}" for name in _PARAMETERS)
    return (
        Policy(
            "predictor",
            (*sensors, plan, DESCRIPTION),
            OF_PREDICTOR,
            ("~/reset", *common),
        ),
        Policy("trajectory", (), (plan, f"{plan}_path"), ("~/start", "~/stop", "~/reset", *common)),
        Policy("virtual_robot", (plan, PLANNED_DEFLECTION), (*sensors, DESCRIPTION), common),
    )


def to_xml(namespace: str = "/") -> str:
    """The policy file that `ros2 security create_permission` takes."""
    root = ElementTree.Element("policy", version="0.2.0")
    root.append(ElementTree.Comment(" SPDX-License-Identifier: BSD-3-Clause; made by coman_reduced_model.policies "))
    enclaves = ElementTree.SubElement(root, "enclaves")
    for policy in policies():
        enclave = ElementTree.SubElement(enclaves, "enclave", path=f"/coman/{policy.node}")
        profiles = ElementTree.SubElement(enclave, "profiles")
        profile = ElementTree.SubElement(profiles, "profile", ns=namespace, node=policy.node)
        for kind, name, members in (
            ("topics", "subscribe", (*policy.subscribe, *_ALL_SUBSCRIBE)),
            ("topics", "publish", (*policy.publish, *_ALL_PUBLISH)),
            ("services", "reply", policy.reply),
        ):
            group = ElementTree.SubElement(profile, kind, {name: "ALLOW"})
            for member in members:
                ElementTree.SubElement(group, kind.removesuffix("s")).text = member
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


if __name__ == "__main__":
    print(to_xml(), end="")
