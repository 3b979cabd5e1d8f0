# SPDX-License-Identifier: BSD-3-Clause
"""Moment of what pushes the robot: on walks with a known push off the COM, and angular momentum by its definition."""

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from predictor_tools import later_predictions

from coman_reduced_model.core.base.types import Array, Foot, Prediction, Sample
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.observer.moment import angular_momentum
from coman_reduced_model.core.robot.robot import Robot
from coman_reduced_model.resources import bag_path, config_path
from coman_reduced_model.sim.disturbances import parse
from coman_reduced_model.sim.record import record


def walk(bag, change: Callable[[Sample], None] = lambda sample: None) -> list:
    """Predictions of a changed walk after its first two seconds, with the lever (3,) of the trunk's COM [m]."""
    found = []
    for prediction, robot in later_predictions(bag, change):
        root, trunk = prediction.base_in_sole, robot.model.inertias[1]  # of the root link
        found.append((prediction, root[3] + root[:3] @ trunk.lever - prediction.measured_com))
    return found


def mean(found: list[tuple[Prediction, Array]]) -> Array:
    return np.mean([p.estimate.moment for p, _ in found], axis=0)


@pytest.fixture(scope="module")
def plain() -> list:
    return walk(bag_path("test1"))


@pytest.mark.parametrize("foot", [Foot.LEFT, Foot.RIGHT])
def test_angular_momentum_is_that_of_all_links_about_their_com(foot):
    """By its definition, from where the links are in the sole frame a moment before and after."""
    robot = Robot(config_path("coman.urdf").read_text(), Config().robot)
    rng, link, dt = np.random.default_rng(int(foot)), robot.posture(), 1e-5
    q, qd = rng.normal(size=(2, len(robot.joint_names)))
    link.update(q, qd)
    link.com_in_sole(foot)
    A = pin.computeCentroidalMap(robot.model, link.data, link.configuration)
    found = angular_momentum(A, robot.idx_v, qd, link.base_in_sole[5], link.R[foot])

    def bodies(q: Array) -> list[tuple[Array, Array]]:
        link.update(q, qd)
        sole = pin.SE3(link.R[foot].copy(), link.p[foot].copy())
        poses = [sole.actInv(pose) for pose in link.data.oMi]
        return [
            (pose.act(inertia.lever), pose.rotation) for pose, inertia in zip(poses, robot.model.inertias, strict=True)
        ]

    before, now, after = (bodies(q + t * qd) for t in (-dt, 0.0, dt))
    masses = np.array([inertia.mass for inertia in robot.model.inertias])
    com = masses @ np.array([place for place, _ in now]) / masses.sum()
    expected = np.zeros(3)
    for (p0, R0), (p, R), (p1, R1), inertia in zip(before, now, after, robot.model.inertias, strict=True):
        turning = pin.log3(R1 @ R0.T) / (2.0 * dt)
        expected += inertia.mass * np.cross(p - com, (p1 - p0) / (2.0 * dt)) + R @ inertia.inertia @ R.T @ turning
    assert found == pytest.approx(expected, abs=1e-6)


def test_nothing_turns_a_robot_that_walks_alone(plain):
    for p, _ in plain[::50]:
        assert np.linalg.eigvalsh(p.estimate.moment_covariance[3:]).min() > 0.0
    sigma = np.sqrt(np.diag(plain[-1][0].estimate.moment_covariance[3:]))
    assert (np.abs(mean(plain)) < sigma).all() and (sigma < 2.0).all()


def test_a_moment_that_the_feet_bear_is_found(plain):
    moment = np.array([1.0, -2.0, 0.5])  # [Nm]

    def turn(sample: Sample) -> None:
        for wrench in (sample.left_wrench, sample.right_wrench):
            if wrench is not None:
                wrench[3:] -= 0.5 * moment

    assert mean(walk(bag_path("test1"), turn)) - mean(plain) == pytest.approx(moment, abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("gait", ["stand", "test1"])
def test_a_push_at_the_trunk_turns_the_virtual_robot(tmp_path, gait):
    """Its moment is that of the lever from the COM of all links to that of the trunk."""
    force, bags = np.array([3.0, -2.0, 0.0]), []
    for hidden in ([], [parse("external_force:x=3,y=-2")]):  # of twice as much it would fall
        bags.append(record(gait, tmp_path / f"bag{len(hidden)}", disturbances=hidden, duration_s=7.0).bag)
    without, pushed = (walk(bag) for bag in bags)
    expected = np.mean([np.cross(lever, force) for _, lever in pushed], axis=0)
    assert expected[:2] == pytest.approx([0.37, 0.55], abs=0.05)  # 0.185 m above the COM of all links
    assert mean(pushed) - mean(without) == pytest.approx(expected, abs=0.1)
