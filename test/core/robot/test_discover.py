# SPDX-License-Identifier: BSD-3-Clause
"""Legs and soles that are found in a URDF, on robots of other makers and under any names."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from robots import NAMES, config_of, rooted_at, urdf_of

from coman_reduced_model.core.base.types import Foot
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.robot.discover import _SIDES, _bare, find_legs
from coman_reduced_model.core.robot.robot import Robot
from coman_reduced_model.core.robot.sole import mesh_points, outline
from coman_reduced_model.errors import RobotError
from coman_reduced_model.sim.describe import urdf
from coman_reduced_model.sim.robot_table import COMAN, ROBOTS, with_upper_body

BOX = '<box size="0.2 0.1 0.02"/>'


def renamed(text: str) -> str:
    """A URDF whose links and joints are called by numbers."""
    found = sorted(set(re.findall(r'<(?:link|joint) name="(\w+)"', text)))
    numbers = {name: f"n{i}" for i, name in enumerate(found)}
    return re.sub(r'"(\w+)"', lambda match: f'"{numbers.get(match[1], match[1])}"', text)


@pytest.mark.parametrize("names", ["leg_{}_6_link", "robot_{}_foot", "{}Foot", "{}foot", "{}_sole", "foot_{}"])
def test_names_of_both_sides_are_alike_and_say_which(names):
    sides = {"{}Foot": ("L", "R"), "{}foot": ("l", "r")}.get(names, ("left", "right"))
    assert len({_bare(names.format(side)) for side in sides}) == 1
    assert [_SIDES.search(names.format(side))[0][:1].lower() for side in sides] == ["l", "r"]


@pytest.mark.parametrize("name", NAMES)
def test_the_legs_of_the_configuration_are_found(name):
    legs, wanted = find_legs(urdf_of(name), name), config_of(name).robot
    assert legs.left.joints == wanted.left.joints and legs.right.joints == wanted.right.joints
    assert (legs.left.sole_frame, legs.right.sole_frame) == (wanted.left.sole_frame, wanted.right.sole_frame)
    assert legs.base_frame == wanted.base_frame


@pytest.mark.parametrize("table", [*ROBOTS.values(), with_upper_body(COMAN)], ids=[*ROBOTS, "upper_body"])
def test_names_do_not_matter(table):
    text = urdf(table)
    legs, numbered = find_legs(text, "known"), find_legs(renamed(text), "numbered")
    assert len(legs.left.joints) == len(legs.right.joints) == 6 and not legs.notes
    assert len(numbered.left.joints) == 6 and not {*numbered.left.joints} & {*numbered.right.joints}
    robot = Robot(renamed(text), _configuration(numbered), "numbered")
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, pin.neutral(robot.model))
    left, right = (data.oMf[robot.sole_ids[foot]] for foot in (Foot.LEFT, Foot.RIGHT))
    assert left.actInv(right.translation)[1] < -0.05
    assert numbered.length == pytest.approx(legs.length, abs=0.1 * legs.length)


def _configuration(legs):
    changes = {"robot.base_frame": legs.base_frame}
    for side in ("left", "right"):
        chain = getattr(legs, side)
        changes[f"robot.{side}.sole_frame"] = chain.sole_frame
        changes[f"robot.{side}.joints"] = list(chain.joints)
        changes[f"robot.{side}.stiffness"] = changes[f"robot.{side}.damping"] = [1.0] * len(chain.joints)
    return Config().replaced(changes).robot


def test_what_is_given_is_taken():
    legs = find_legs(urdf_of("coman"), "coman", left="r_foot", right="l_foot")
    assert legs.left.joints[0] == "RHipSag" and legs.right.sole_frame == "l_foot"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"left": "l_sole"}, "one sole frame is given"),
        ({"left": "l_sole", "right": "nowhere"}, "no frame 'nowhere'"),
        ({"left": "l_sole", "right": "l_foot"}, "not on two legs"),
        ({"base": "l_foot"}, "'l_foot' is on a leg"),
        ({"base": "nowhere"}, "no frame 'nowhere'"),
    ],
)
def test_what_cannot_be_found_is_said_in_one_line(arguments, words):
    with pytest.raises(RobotError, match=words) as error:
        find_legs(urdf_of("coman"), "robot.urdf", **arguments)
    assert "\n" not in str(error.value) and str(error.value).startswith("robot.urdf: ")


@pytest.mark.parametrize(
    ("shape", "size"),
    [
        (BOX, (0.2, 0.1)),
        ('<cylinder radius="0.06" length="0.02"/>', (0.12, 0.12)),
        ('<sphere radius="0.05"/>', None),  # it touches the ground in a point
        ('<mesh filename="package://nowhere/foot.stl"/>', None),
    ],
)
def test_a_sole_is_as_large_as_the_shapes_that_touch_the_ground(shape, size):
    text = urdf_of("coman")
    assert re.search(r'<box size="[^"]+"\s*/>', text)
    changed = re.sub(r'(<collision>.*?)<box size="[^"]+"\s*/>', rf"\1{shape}", text, flags=re.S)
    robot = Robot(changed, Config().robot)
    wanted = size or (Config().robot.foot_length, Config().robot.foot_width)
    for back, front, right, left in robot.soles.values():
        assert (front - back, left - right) == pytest.approx(wanted, abs=1e-3)


def test_a_sole_is_as_large_as_its_mesh(tmp_path):
    corners = 0.5 * np.array([0.22, 0.09, 0.03]) * [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    faces = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6), (0, 2, 6),
             (0, 6, 4), (1, 5, 7), (1, 7, 3)]  # fmt: skip
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    (tmp_path / "foot.obj").write_text("\n".join(lines) + "\n")
    mesh = '<mesh filename="foot.obj"/>'
    text = re.sub(r'(<collision>.*?)<box size="[^"]+"\s*/>', rf"\1{mesh}", urdf_of("coman"), flags=re.S)
    robot = Robot(text, Config().robot)
    edges = outline(mesh_points(text, robot.model, robot.sole_ids[Foot.LEFT], tmp_path))
    assert edges[1] - edges[0] == pytest.approx(0.22) and edges[3] - edges[2] == pytest.approx(0.09)
    assert not len(mesh_points(text, robot.model, robot.sole_ids[Foot.LEFT], tmp_path / "nowhere"))


def test_one_leg_given_twice_is_refused():
    config = Config()
    left = config.robot.left
    twice = config.replaced({"robot.right.sole_frame": left.sole_frame, "robot.right.joints": list(left.joints)})
    with pytest.raises(RobotError, match="robot.right.sole_frame: .* is not on a leg of its own"):
        Robot(urdf_of("coman"), twice.robot)
    with pytest.raises(RobotError, match="robot.left.sole_frame: 'base_link' is not on a leg of its own"):
        Robot(urdf_of("coman"), config.replaced({"robot.left.sole_frame": "base_link"}).robot)


@pytest.mark.parametrize("root", ["base_link", "torso"])
def test_legs_are_the_same_with_any_base_frame_that_is_on_none_of_them(root):
    text = urdf(with_upper_body(COMAN))
    text = text if root == "base_link" else rooted_at(text, root)
    robots = [Robot(text, Config().replaced({"robot.base_frame": name}).robot) for name in ("base_link", "torso")]
    legs = [[robot.joint_names[i] for foot in (Foot.LEFT, Foot.RIGHT) for i in robot.legs[foot]] for robot in robots]
    assert legs[0] == legs[1] and len(legs[0]) == 12
    found = find_legs(text, "text", base="torso", left="l_sole", right="r_sole")
    assert [*found.left.joints, *found.right.joints] == legs[0] and found.base_frame == "torso"
    assert find_legs(text, "text", base="torso") == found


def test_a_base_frame_on_a_leg_is_refused():
    text = urdf(with_upper_body(COMAN))
    shank = next(each.find("child").get("link") for each in ElementTree.fromstring(text).iterfind("joint")
                 if each.get("name") == "LKneeSag")  # fmt: skip
    with pytest.raises(RobotError, match=f"robot.base_frame: '{shank}' is on the left leg, below 'LHip"):
        Robot(text, Config().replaced({"robot.base_frame": shank}).robot)
    with pytest.raises(RobotError, match=f"'{shank}' is on a leg"):
        find_legs(text, "text", base=shank)  # and the arms are no legs
