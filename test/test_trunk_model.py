# SPDX-License-Identifier: BSD-3-Clause
"""The turning trunk against statics, against inverse dynamics and on recorded walks that no one tuned it on."""

import numpy as np
import pinocchio as pin
import pytest

from coman_reduced_model.bag.reader import Bag
from coman_reduced_model.core.config import Config
from coman_reduced_model.core.pipeline import Pipeline
from coman_reduced_model.core.predictor import Predictor
from coman_reduced_model.core.robot import Robot
from coman_reduced_model.core.types import Flags, Sample
from coman_reduced_model.errors import ConfigError
from coman_reduced_model.offline import find_robot, input_streams, predictions
from coman_reduced_model.resources import bag_path, config_path
from coman_reduced_model.topics import TopicNames

WHOLE = ("gravity_stiffness", "trunk_rotation", "swing_momentum", "lateral_compliance")
BENT = [-0.4, 0.0, 0.0, 0.8, -0.4, 0.0] * 2


def config(*effects: str) -> Config:
    return Config().replaced({"effects.active": effects, "prediction.horizons": [0.1, 0.2]})


def robot() -> Robot:
    return Robot(config_path("coman.urdf").read_text(encoding="utf-8"), Config().robot)


def standing(machine: Robot, stamp_ns: int, q: np.ndarray, motor_q: np.ndarray) -> Sample:
    """On the left leg alone."""
    weight = machine.mass * 9.81
    down, up = np.array([0, 0, weight, 0, 0, 0.0]), np.zeros(6)
    still = np.zeros(12)
    return Sample(stamp_ns, q, still, motor_q=motor_q, motor_qd=still, left_wrench=down, right_wrench=up)


def test_one_leg_sags_to_where_springs_and_weight_balance():
    """The closed form: K_q d = -tau_g(theta + d), solved by iteration with Pinocchio's gravity torques."""
    machine = robot()
    theta = np.array(BENT)
    leg, stiffness = machine.legs[1], np.array(Config().robot.left.stiffness)
    model, data = machine.model, machine.model.createData()
    sole = machine.sole_ids[1]

    def gravity_torque(d: np.ndarray) -> np.ndarray:
        q = pin.neutral(model)
        joints = theta.copy()
        joints[leg] += d
        machine.scatter(joints, q)
        pin.framesForwardKinematics(model, data, q)
        q[:7] = pin.SE3ToXYZQUAT(data.oMf[sole].inverse())  # the sole is the world
        tau = pin.computeGeneralizedGravity(model, data, q)
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        J = pin.getFrameJacobian(model, data, sole, pin.LOCAL_WORLD_ALIGNED)
        # The sole stands still: the base moves by -J_b^-1 J_leg.
        return tau[machine.leg_columns[1]] - J[:, machine.leg_columns[1]].T @ np.linalg.solve(J[:, :6].T, tau[:6])

    d = np.zeros(6)
    for _ in range(200):
        d = -gravity_torque(d) / stiffness
    q = theta.copy()
    q[leg] += d
    predictor = Predictor(machine, config(*WHOLE))
    start = theta.copy()
    start[leg] += 0.5 * d
    result = predictor.update(standing(machine, 10**9, start, theta))
    for k in range(1, 1200):
        result = predictor.update(standing(machine, 10**9 + k * 10_000_000, q, theta))
    assert not result.flags & Flags.REJECTED_STATE
    sag = np.linalg.norm(result.measured_com - result.reference_com)
    assert sag > 3e-3
    assert np.linalg.norm(result.residual) < 0.03 * sag
    assert np.abs(result.measured_tilt - result.predicted_tilt).max() < 0.03 * np.abs(result.measured_tilt).max()


def walk(name: str, *effects: str) -> dict[str, np.ndarray]:
    settings = config(*effects)
    with Bag(bag_path(name)) as bag:
        machine = find_robot(settings, bag, TopicNames())
        streams = input_streams(bag, settings, TopicNames())
        results = list(predictions(bag, Pipeline(machine, settings), streams))[400:-400]

    def rms(values: list) -> np.ndarray:
        return np.sqrt(np.mean(np.square(np.array(values)), axis=0))

    return {
        "model": rms([p.residual for p in results]),
        "rigid": rms([p.measured_com - p.reference_com for p in results]),
        "tilt": rms([p.measured_tilt - p.predicted_tilt for p in results]),
    }


@pytest.mark.parametrize("name", ["test1", "test2"])
def test_untuned_on_a_walk_it_beats_the_point_mass(name):
    whole, paper = walk(name, *WHOLE), walk(name)
    for axis in (0, 2):
        assert whole["model"][axis] < 0.55 * paper["model"][axis]
    assert whole["model"][2] < 0.2 * whole["rigid"][2]
    assert np.degrees(whole["tilt"]).max() < 1.0
    assert np.isnan(paper["tilt"]).all()


def test_swing_momentum_is_needed_for_the_fore_aft_motion():
    assert walk("test2", *WHOLE)["model"][0] < walk("test2", "gravity_stiffness", "trunk_rotation")["model"][0]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"effects.active": ["swing_momentum"]}, "trunk_rotation"),
        ({"effects.active": ["trunk_rotation"], "prediction.reference": "topic"}, "motor"),
        ({"effects.active": ["trunk_rotation"], "effects.trunk_rotation.full_share": [2.0]}, "0.01 to 1"),
    ],
)
def test_what_does_not_go_together_is_refused(changes, words):
    with pytest.raises(ConfigError, match=words):
        Config().replaced(changes)
