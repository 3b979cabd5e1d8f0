# SPDX-License-Identifier: BSD-3-Clause
"""Robots that are more than two legs of six joints: moving arms and waist, another root link, seven joints a leg."""

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from robots import rooted_at

from coman_reduced_model.bag.session import Session
from coman_reduced_model.core.base.types import Foot, JointMessage, Sample, WrenchMessage
from coman_reduced_model.core.config.files import load_config
from coman_reduced_model.core.monitor.monitor import Monitor
from coman_reduced_model.core.predictor import Predictor
from coman_reduced_model.core.robot.robot import Robot
from coman_reduced_model.core.streams.joiner import Joiner
from coman_reduced_model.judge.cases import data_sheet
from coman_reduced_model.resources import bag_path
from coman_reduced_model.sim.upper_motion import UpperMotion
from coman_reduced_model.sim.worlds import World
from coman_reduced_model.sim.worlds.run import record_world

MOVING = UpperMotion(arms=0.4, together=True, waist_yaw=0.1, waist_pitch=0.03)
JOINT_FIELDS = ("q", "qd", "tau", "motor_q", "motor_qd")


@pytest.fixture(scope="module", params=["coman", "small"])
def walk(request, tmp_path_factory):
    """Configuration and samples of a robot whose arms swing together and whose waist turns and pitches."""
    world = World(robot=request.param, upper_body=True, upper=MOVING, duration_s=8.0, tolerances=False)
    return recorded(world, tmp_path_factory.mktemp("whole"))


def recorded(world, folder):
    """The same of a world."""
    (folder / "robot.yaml").write_text(data_sheet(world))
    config = load_config(folder / "robot.yaml")
    assert record_world(world, folder / "bag").fallen_s is None
    with Session(folder / "bag", config) as session:
        return session.robot, config, list(session.samples())


def errors(robot, config, samples) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """COM (n, 3) by the free run, its error and that of the rigid robot [m]."""
    predictor = Predictor(robot, config.replaced({"prediction.horizons": []}))
    predictions = [predictor.update(sample) for sample in samples]
    com = np.array([each.predicted_com for each in predictions])
    error = np.array([each.residual for each in predictions])
    rigid = np.array([each.measured_com - each.reference_com for each in predictions])
    return com, error, rigid


def rms_mm(values: np.ndarray) -> np.ndarray:
    return 1e3 * np.sqrt(np.nanmean(np.square(values), axis=0))


@pytest.mark.slow
def test_arms_and_waist_that_accelerate_push_the_trunk(walk):
    _, error, rigid = errors(*walk)
    assert (rms_mm(error) < [0.5, 0.3, 0.15]).all(), rms_mm(error)
    assert (rms_mm(error) < 0.7 * rms_mm(rigid)).all(), (rms_mm(error), rms_mm(rigid))


@pytest.mark.slow
def test_predicted_velocity_counts_the_arms(walk):
    robot, config, samples = walk
    predictor = Predictor(robot, config.replaced({"prediction.horizons": []}))
    off = [p.measured_com_vel - p.predicted_com_vel for p in map(predictor.update, samples)]
    rigid = [p.measured_com_vel - p.reference_com_vel for p in map(predictor.update, samples)]
    assert rms_mm(np.array(off))[0] < 0.9 * rms_mm(np.array(rigid))[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("root", "trunk"), [("torso", "base_link"), ("torso", "torso"), ("base_link", "torso")], ids="/".join
)
def test_prediction_does_not_depend_on_the_root_link_nor_on_the_base_frame(walk, root, trunk):
    robot, config, samples = walk
    config = config.replaced({"robot.base_frame": trunk})
    other = Robot(rooted_at(robot.urdf, root) if root != robot.root else robot.urdf, config.robot)
    assert other.root == root and set(other.joint_names) == set(robot.joint_names)
    order = [robot.joint_names.index(name) for name in other.joint_names]
    com, *_ = errors(other, config, [mapped(sample, lambda values: values[order]) for sample in samples])
    expected, error, _ = errors(robot, config, samples)
    known = np.isfinite(expected)
    assert known.sum() > 1000 and (known == np.isfinite(com)).all()
    assert (rms_mm(com - expected) < 0.1 * rms_mm(error)).all()


def mapped(sample: Sample, change) -> Sample:
    """The sample with other joints."""
    return replace(sample, **{name: change(getattr(sample, name)) for name in JOINT_FIELDS})


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.0, 0.4])
def test_a_seventh_joint_changes_nothing(share):
    """Seven joints a leg: a joint of the pelvis on the axis of the hip takes its share of the motion, and gives way.

    Two springs in a row give way as one does; without a share, the seventh is locked.
    """
    with Session(bag_path("test1"), load_config()) as session:
        robot, config = session.robot, session.config
        samples = [sample for sample, _ in zip(session.samples(), range(1200), strict=False)]
    expected, error, _ = errors(robot, config, samples)

    tree = ElementTree.fromstring(robot.urdf)
    changes: dict = {}
    for foot, side in ((Foot.LEFT, "left"), (Foot.RIGHT, "right")):
        first = robot.joint_names[robot.legs[foot][0]]
        joint = tree.find(f"joint[@name='{first}']")
        link = f"{side}_pelvis"
        tree.append(ElementTree.fromstring(f"<link name='{link}'/>"))
        tree.append(ElementTree.fromstring(
            f"<joint name='{side}_seventh' type='revolute'><parent link='base_link'/><child link='{link}'/>"
            f"<origin xyz='{joint.find('origin').get('xyz')}'/><axis xyz='{joint.find('axis').get('xyz')}'/>"
            "<limit lower='-1' upper='1' effort='100' velocity='10'/></joint>"
        ))  # fmt: skip
        joint.find("parent").set("link", link)
        joint.find("origin").set("xyz", "0 0 0")
        leg = getattr(config.robot, side)
        changes |= {
            f"robot.{side}.joints": [f"{side}_seventh", *leg.joints],
            f"robot.{side}.stiffness": split(leg.stiffness, share),
            f"robot.{side}.damping": split(leg.damping, share),
        }
    seven = config.replaced(changes)
    other = Robot(ElementTree.tostring(tree, encoding="unicode"), seven.robot)
    assert len(other.legs[Foot.LEFT]) == 7
    place = [other.joint_names.index(name) for name in robot.joint_names]
    hips = [[other.joint_names.index(name) for name in leg.joints[:2]] for leg in (seven.robot.left, seven.robot.right)]

    def with_sevenths(values: np.ndarray) -> np.ndarray:
        out = np.zeros(14)
        out[place] = values
        for seventh, hip in hips:
            out[seventh], out[hip] = share * out[hip], (1.0 - share) * out[hip]
        return out

    mine = [mapped(sample, with_sevenths) for sample in samples]
    com, *_ = errors(other, seven, mine)
    known = np.isfinite(expected)
    assert known.sum() > 1000 and (known == np.isfinite(com)).all()
    assert (rms_mm(com - expected) < 0.1 * rms_mm(error)).all()
    ahead = [two_tenths_ahead(*each) for each in ((robot, config, samples), (other, seven, mine))]
    assert rms_mm(ahead[1] - ahead[0]).max() < 0.1


def two_tenths_ahead(robot, config, samples) -> np.ndarray:
    """(n, 3) what is published of the COM in 0.2 s [m]."""
    predictor = Predictor(robot, config.replaced({"prediction.horizons": [0.2]}))
    found = [[each.com for each in predictor.update(replace(sample)).horizons] for sample in samples]
    return np.array([each[0] if each else np.full(3, np.nan) for each in found])


def split(values: tuple[float, ...], share: float) -> list[float]:
    """Stiffness or damping of seven joints, of which the first two are as soft in a row as the first of six."""
    first, *others = values
    return [first / max(share, 1e-3), first / (1.0 - share), *others]


def test_arms_in_no_motor_state_follow_their_links(walk):
    """Joint states list arms and waist, motor states the legs alone."""
    robot, config, samples = walk
    joiner = Joiner(robot, config)
    legs = np.concatenate([robot.legs[Foot.LEFT], robot.legs[Foot.RIGHT]])
    names = tuple(robot.joint_names[i] for i in legs)
    joined = []
    for sample in samples:
        stamp = sample.stamp_ns
        if sample.motor_q is None or sample.left_wrench is None or sample.right_wrench is None:
            continue
        joiner.add_motor(JointMessage(stamp, names, sample.motor_q[legs], sample.motor_qd[legs], None))
        for foot, wrench in ((Foot.LEFT, sample.left_wrench), (Foot.RIGHT, sample.right_wrench)):
            frame = robot.config.left.sole_frame if foot == Foot.LEFT else robot.config.right.sole_frame
            joiner.add_wrench(foot, WrenchMessage(stamp, frame, wrench[:3], wrench[3:]))
        joined += joiner.add_joint(JointMessage(stamp, robot.joint_names, sample.q, sample.qd, sample.tau))
    assert len(joined) > 0.95 * len(samples)
    _, error, _ = errors(robot, config, joined)
    assert (rms_mm(error) < [0.5, 0.3, 0.15]).all(), rms_mm(error)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["coman", "small"])
def test_arms_that_swing_together_raise_no_alarm(tmp_path, name):
    """As long as joint and motor states show them."""
    world = World(robot=name, upper_body=True, upper=MOVING, duration_s=20.0, tolerances=False)
    robot, config, samples = recorded(world, tmp_path)
    assert not alarms(robot, config, samples)
    legs, half = np.isin(np.arange(len(robot.joint_names)), [*robot.legs.values()]), len(samples) // 2
    hidden = samples[:half] + [mapped(sample, lambda values: values * legs) for sample in samples[half:]]
    assert "plan/x" in alarms(robot, config, hidden)


def alarms(robot, config, samples) -> set[str]:
    """Channels in which the monitor found a mismatch."""
    predictor = Predictor(robot, config.replaced({"prediction.horizons": []}))
    monitor = Monitor(robot, config, predictor.zeros)
    for sample in samples:
        prediction = predictor.update(replace(sample))
        monitor.update(predictor.sample, predictor.link, prediction)
    return set(monitor.first)
