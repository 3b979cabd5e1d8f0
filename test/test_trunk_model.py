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
from coman_reduced_model.core.trunk import lifts, stand, trunk_twist
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


SOLE = np.array([-0.07, 0.13, -0.05, 0.05])


def wrench_on_foot(wanted: np.ndarray, friction: float = 0.7) -> tuple[np.ndarray, int]:
    """What a foot lets through of the wrench (6,) that flat ground would exert if it could pull and hold."""
    machine = robot()
    posture = machine.posture()
    posture.update(np.array(BENT), np.zeros(12))
    columns = machine.leg_columns[1]
    R, p = posture.R[1], posture.p[1]
    J = np.kron(np.eye(2), R.T) @ posture.sole_jacobian(1)[:, columns]  # of the sole against the trunk, in sole axes
    H = lifts(trunk_twist(posture.sole_jacobian(1), columns, p), R, p, SOLE)
    K = np.diag(Config().robot.left.stiffness)
    P, left = stand(K, J.T @ wanted, H, friction, 0.05)
    return np.linalg.solve(J.T, P @ (J.T @ wanted)), left


def test_a_foot_presses_within_its_sole_and_its_friction():
    flat, left = wrench_on_foot(np.array([5.0, -4.0, 80.0, 1.0, -2.0, 0.5]))
    np.testing.assert_allclose(flat, [5.0, -4.0, 80.0, 1.0, -2.0, 0.5], atol=1e-3)
    assert left == 0
    toe, left = wrench_on_foot(np.array([5.0, 0.0, 80.0, 1.0, -80.0 * 0.2, 0.0]))  # CoP 0.2 m ahead, beyond the toes
    assert left == 1 and toe[2] > 0.0 and -toe[4] / toe[2] == pytest.approx(0.13, abs=1e-4)
    corner, left = wrench_on_foot(np.array([0.0, 0.0, 80.0, -80.0 * 0.2, 80.0 * 0.3, 0.0]))
    assert left == 0b1010 and corner[2] > 0.0
    np.testing.assert_allclose([-corner[4] / corner[2], corner[3] / corner[2]], [-0.07, -0.05], atol=1e-4)
    assert wrench_on_foot(np.array([5.0, 0.0, -1.0, 0.0, 0.0, 0.0]))[1] == 16
    pushed, _ = wrench_on_foot(np.array([60.0, 0.0, 50.0, 0.0, 0.0, 0.0]))
    assert np.hypot(pushed[0], pushed[1]) <= 0.75 * pushed[2]


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
        assert whole["model"][axis] < 0.4 * paper["model"][axis]
    assert whole["model"][0] < 1.3e-3 and whole["model"][0] < 0.5 * whole["rigid"][0]
    assert whole["model"][1] < whole["rigid"][1] and whole["model"][2] < 0.15 * whole["rigid"][2]
    assert np.degrees(whole["tilt"]).max() < 0.4
    assert np.isnan(paper["tilt"]).all()


def test_swing_momentum_is_needed_for_the_fore_aft_motion():
    assert walk("test2", *WHOLE)["model"][0] < walk("test2", "gravity_stiffness", "trunk_rotation")["model"][0]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"effects.active": ["swing_momentum"]}, "trunk_rotation"),
        ({"effects.active": ["trunk_rotation"], "prediction.reference": "topic"}, "motor"),
        ({"effects.active": ["trunk_rotation"], "effects.trunk_rotation.friction": [3.0]}, "0.05 to 2"),
    ],
)
def test_what_does_not_go_together_is_refused(changes, words):
    with pytest.raises(ConfigError, match=words):
        Config().replaced(changes)
