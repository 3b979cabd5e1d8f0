# SPDX-License-Identifier: BSD-3-Clause
"""Robots for the tests of the core, and forward kinematics that owes nothing to Pinocchio."""

from __future__ import annotations

from functools import cache
from xml.etree import ElementTree

import numpy as np
from conftest import recording
from scipy.spatial.transform import Rotation

from coman_reduced_model.bag.reader import Bag
from coman_reduced_model.core.config.files import load_config
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.robot.robot import Robot
from coman_reduced_model.resources import config_path

RECORDED = {"other": "other_robot/walk_003", "icub": "real/icub_walk"}
NAMES = ("coman", *RECORDED)


@cache
def urdf_of(name: str) -> str:
    """The URDF of a robot; the test is skipped without its recording."""
    if name == "coman":
        return config_path("coman.urdf").read_text()
    with Bag(recording(RECORDED[name])) as bag:
        message = bag.first("/robot_description")
    assert message is not None
    return message.data


@cache
def config_of(name: str) -> Config:
    return load_config(config_path("icub")) if name == "icub" else Config()


@cache
def robot_of(name: str) -> Robot:
    return Robot(urdf_of(name), config_of(name).robot)


def bent(robot: Robot, knee: float = 0.6, lean: float = 0.0) -> np.ndarray:
    """Joint positions (nj,) of a robot with COMAN's joint names that stands with both knees bent alike."""
    angles = {"HipSag": -knee / 2 - lean, "KneeSag": knee, "AnkSag": -knee / 2 + lean}
    return np.array([angles.get(name[1:], 0.0) for name in robot.joint_names])


def forward(urdf: str, positions: dict[str, float]) -> tuple[dict[str, np.ndarray], float, np.ndarray]:
    """Poses (4, 4) of all links with the root link at the origin, total mass [kg] and COM (3,) [m]."""
    root = ElementTree.fromstring(urdf)
    joints = {joint.find("child").get("link"): joint for joint in root.findall("joint")}

    def origin(element) -> np.ndarray:
        T = np.eye(4)
        if element is not None:
            T[:3, 3] = np.array(element.get("xyz", "0 0 0").split(), float)
            T[:3, :3] = Rotation.from_euler("xyz", np.array(element.get("rpy", "0 0 0").split(), float)).as_matrix()
        return T

    @cache
    def pose(link: str) -> np.ndarray:
        if link not in joints:
            return np.eye(4)
        joint = joints[link]
        T = pose(joint.find("parent").get("link")) @ origin(joint.find("origin"))
        if joint.get("type") in ("revolute", "continuous"):
            axis = np.array(joint.find("axis").get("xyz").split(), float)
            turn = np.eye(4)
            turn[:3, :3] = Rotation.from_rotvec(axis * positions.get(joint.get("name"), 0.0)).as_matrix()
            T = T @ turn
        return T

    mass, moment = 0.0, np.zeros(3)
    for link in root.findall("link"):
        inertial = link.find("inertial")
        if inertial is not None:
            m = float(inertial.find("mass").get("value"))
            centre = pose(link.get("name")) @ origin(inertial.find("origin"))
            mass += m
            moment += m * centre[:3, 3]
    return {link.get("name"): pose(link.get("name")) for link in root.findall("link")}, mass, moment / mass


def rooted_at(urdf: str, root: str) -> str:
    """The URDF with the joints between the root link and another link turned round; their frames are not turned."""
    tree = ElementTree.fromstring(urdf)
    by_child = {joint.find("child").get("link"): joint for joint in tree.iterfind("joint")}
    chain, link = [], root
    while link in by_child:
        chain.append(by_child[link])
        link = by_child[link].find("parent").get("link")
    for joint in chain:
        parent, child, origin = joint.find("parent"), joint.find("child"), joint.find("origin")
        shift = np.array(origin.get("xyz").split(), float)
        above = parent.get("link")
        # The frame of what was the parent moves into the joint.
        inertial = tree.find(f"link[@name='{above}']/inertial/origin")
        below = [other.find("origin") for other in tree.iterfind("joint")
                 if other is not joint and other.find("parent").get("link") == above]  # fmt: skip
        for moved in (inertial, *below):
            moved.set("xyz", " ".join(map(str, np.array(moved.get("xyz").split(), float) - shift)))
        parent.set("link", child.get("link"))
        child.set("link", above)
        origin.set("xyz", "0 0 0")
        axis = joint.find("axis")
        axis.set("xyz", " ".join(map(str, -np.array(axis.get("xyz").split(), float))))
    return ElementTree.tostring(tree, encoding="unicode")
