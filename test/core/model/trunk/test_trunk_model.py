# SPDX-License-Identifier: BSD-3-Clause
"""The turning trunk against statics, against inverse dynamics and on recorded walks that no one tuned it on."""

import numpy as np
import pinocchio as pin
import pytest

from coman_reduced_model.bag.session import Session
from coman_reduced_model.core.base.types import Flags, Sample
from coman_reduced_model.core.config.schema import OPTIONS, Config
from coman_reduced_model.core.model.trunk.contact import Linear, Sole, State, contacts, impulses, switch_support
from coman_reduced_model.core.model.trunk.kinematics import trunk_twist
from coman_reduced_model.core.predictor import Predictor
from coman_reduced_model.core.robot.robot import Robot
from coman_reduced_model.errors import ConfigError
from coman_reduced_model.resources import bag_path, config_path

WHOLE = ("gravity_stiffness", "trunk_rotation", "swing_momentum", "lateral_compliance")
BENT = [-0.4, 0.0, 0.0, 0.8, -0.4, 0.0] * 2


def config(*options: str) -> Config:
    chosen = {f"model.{option}": "with" if option in options else "without" for option in OPTIONS}
    return Config().replaced({**chosen, "prediction.horizons": [0.1, 0.2]})


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
    machine.soles = dict.fromkeys(machine.soles, np.array([-0.1, 0.2, -0.15, 0.15]))  # else it would topple sideways
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
CORNERS = np.array([[x, y] for y in SOLE[2:] for x in SOLE[:2]])
MIDDLE = np.array([0.03, 0.0])
ONE_SOLE = np.zeros((7, 6))  # constraints of a block by its velocity at the middle of its sole
for row, (x, y) in enumerate(CORNERS - MIDDLE):
    ONE_SOLE[row, 2], ONE_SOLE[row, 3], ONE_SOLE[row, 4] = 1.0, y, -x
ONE_SOLE[4, 0] = ONE_SOLE[5, 1] = ONE_SOLE[6, 5] = 1.0


def ground_on_a_block(force: np.ndarray, moment: np.ndarray, friction: float = 0.7) -> np.ndarray:
    """(7,) impulses of the ground on a block of 10 kg that stands on one sole, pushed for 1 ms at the sole's middle."""
    h, mass, inertia = 1e-3, 10.0, np.array([0.1, 0.2, 0.1])
    C = ONE_SOLE
    M = np.diag([mass] * 3 + inertia.tolist())
    P = np.zeros(7)
    free = np.linalg.solve(M, np.concatenate((force, moment))) * h
    for _ in range(50):  # of the steps of a walk, each begins where the last one ended
        impulses(C @ np.linalg.solve(M, C.T), C @ free, np.zeros(7), P, friction, 0.05, np.inf)
    return P / h


def test_the_ground_balances_what_presses_within_the_sole():
    P = ground_on_a_block(np.array([5.0, -4.0, -98.1]), np.array([1.0, -2.0, 0.5]))
    assert (P[:4] > 0.0).all() and P[:4].sum() == pytest.approx(98.1, rel=0.02)
    np.testing.assert_allclose(P[:4] @ (CORNERS - MIDDLE), [-2.0, -1.0], atol=0.1)
    np.testing.assert_allclose(P[4:], [-5.0, 4.0, -0.5], rtol=0.01)


def test_the_ground_presses_on_the_edge_that_is_turned_about_and_never_pulls():
    over_the_toes = ground_on_a_block(np.array([0.0, 0.0, -98.1]), np.array([0.0, 98.1 * 0.2, 0.0]))
    np.testing.assert_allclose(over_the_toes[[0, 2]], 0.0, atol=1e-9)
    assert (over_the_toes[[1, 3]] > 10.0).all()
    over_a_corner = ground_on_a_block(np.array([0.0, 0.0, -98.1]), np.array([98.1 * 0.1, 98.1 * 0.2, 0.0]))
    assert (over_a_corner[:4] > 1e-6).tolist() == [False, True, False, False]  # front right
    np.testing.assert_array_equal(ground_on_a_block(np.array([5.0, 0.0, 20.0]), np.zeros(3)), 0.0)


@pytest.mark.parametrize("friction", [0.3, 0.7])
def test_friction_holds_no_more_than_its_share_of_the_load(friction):
    P = ground_on_a_block(np.array([200.0, 100.0, -98.1]), np.array([0.0, 0.0, 50.0]), friction)
    most = friction * P[:4].sum()
    assert np.hypot(P[4], P[5]) == pytest.approx(most, rel=1e-6) and P[5] / P[4] == pytest.approx(0.5, rel=0.01)
    assert abs(P[6]) == pytest.approx(0.05 * most, rel=1e-6)


def test_a_foot_that_does_not_stand_bears_no_more_than_that_and_slides_by_it():
    """Two blocks of 10 kg on one sole each, pushed forward: a corner of the second one may press with 1 N."""
    C = np.vstack((np.hstack((ONE_SOLE, np.zeros((7, 6)))), np.hstack((np.zeros((7, 6)), ONE_SOLE))))
    M, P, h = np.diag([10.0, 10.0, 10.0, 0.1, 0.2, 0.1] * 2), np.zeros(14), 1e-3
    free = np.linalg.solve(M, [5.0, 0.0, -98.1, 0.0, 0.0, 0.0] * 2) * h
    for _ in range(50):
        impulses(C @ np.linalg.solve(M, C.T), C @ free, np.zeros(14), P, 0.7, 0.05, 1.0 * h)
    assert P[:4].sum() / h == pytest.approx(98.1, rel=0.02)
    np.testing.assert_allclose(P[7:11] / h, 1.0)
    assert P[4] / h == pytest.approx(-5.0, rel=0.01) and P[11] / h == pytest.approx(-0.7 * 4.0, rel=1e-6)


def test_a_state_told_by_the_other_sole_and_back_is_the_same():
    """Heights, tilts and rates of both soles; where they are on the ground does not matter."""
    machine, rng = robot(), np.random.default_rng(0)
    posture = machine.posture()
    y, w = np.concatenate((BENT, np.zeros(6))), rng.normal(0.0, 0.1, 18)
    y[14:17] = 1e-3 * rng.standard_normal(3)

    def linear(foot: int, y: np.ndarray) -> Linear:
        posture.update(y[:12] if foot == 1 else np.roll(y[:12], 6), np.zeros(12))
        twists = {f: np.empty((6, 6)) for f in (1, 2)}
        for f, twist in twists.items():
            trunk_twist(twist, posture.J, machine.leg_columns[f])
        support, other = (Sole(posture.R[f], posture.p[f], twists[f], SOLE, np.zeros(3)) for f in (foot, 3 - foot))
        nothing, C, height = np.zeros((12, 12)), np.empty((14, 18)), np.empty(14)
        contacts(support, other, y[12:], np.empty((6, 6)), C, height)
        return Linear(y, nothing, nothing, np.zeros(18), C, height, np.full(1, 0.05), np.full(1, np.inf))

    start = State(y, w, np.arange(14.0))
    left = linear(1, y)
    there = switch_support(start, left, SOLE)
    right = linear(2, there.y)
    np.testing.assert_allclose(right.height[:4], left.height[7:11], atol=1e-9)
    np.testing.assert_allclose(right.height[7:11], left.height[:4], atol=3e-6)  # tilts are small
    back = switch_support(there, right, SOLE)
    np.testing.assert_allclose(back.y, y, atol=1e-5)
    np.testing.assert_array_equal(back.P, start.P)


def walk(name: str, *effects: str) -> dict[str, np.ndarray]:
    settings = config(*effects)
    with Session(bag_path(name), settings) as session:
        results = list(session.predictions())[400:-400]

    def rms(values: list) -> np.ndarray:
        return np.sqrt(np.mean(np.square(np.array(values)), axis=0))

    return {
        "model": rms([p.residual for p in results]),
        "rigid": rms([p.measured_com - p.reference_com for p in results]),
        "tilt": rms([p.measured_tilt - p.predicted_tilt for p in results]),
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", ["test1", "test2"])
def test_untuned_on_a_walk_it_beats_the_point_mass(name):
    whole, paper = walk(name, *WHOLE), walk(name)
    for axis in (0, 2):
        assert whole["model"][axis] < 0.4 * paper["model"][axis]
    assert whole["model"][0] < 0.5e-3 and whole["model"][2] < 0.2e-3
    assert whole["model"][1] < whole["rigid"][1] and whole["model"][2] < 0.15 * whole["rigid"][2]
    assert np.degrees(whole["tilt"]).max() < 0.2
    assert np.isnan(paper["tilt"]).all()


@pytest.mark.slow
def test_swing_momentum_is_needed_for_the_fore_aft_motion():
    assert walk("test2", *WHOLE)["model"][0] < walk("test2", "gravity_stiffness", "trunk_rotation")["model"][0]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"model.trunk_rotation": "without", "model.swing_momentum": "with"}, "trunk_rotation"),
        ({"model.trunk_rotation": "with", "prediction.reference": "topic"}, "motor"),
        ({"model.friction": 3.0}, "0.05 to 2"),
    ],
)
def test_what_does_not_go_together_is_refused(changes, words):
    with pytest.raises(ConfigError, match=words):
        Config().replaced(changes)


def test_a_robot_that_must_topple_is_predicted_again_and_never_by_nan():
    """On one leg, its COM beside the sole, and yet the encoders say that it stands."""
    machine, theta = robot(), np.array(BENT)
    predictor = Predictor(machine, config(*WHOLE))
    results = [predictor.update(standing(machine, 10**9 + k * 20_000_000, theta, theta)) for k in range(600)]
    assert sum(bool(r.flags & Flags.REJECTED_STATE) for r in results) >= 1
    error = np.array([r.residual for r in results])
    assert np.isfinite(error).all() and np.linalg.norm(error, axis=1).max() < 0.5


@pytest.mark.slow
def test_a_robot_that_stands_keeps_its_deflection():
    """Its predictions ahead, of a walk that is not repeated, are as good as those of the deflection that stays."""
    with Session(bag_path("stand"), Config()) as session:
        for _ in session.predictions():
            pass
        errors = session.pipeline.judge.rmse()["0.2"]
    assert errors["planned"][0] > 1.5e-3
    assert errors["model"][0] < 1.2 * errors["deflected"][0]
