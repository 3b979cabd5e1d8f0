# SPDX-License-Identifier: BSD-3-Clause
"""Joint effects: their laws in closed form, and where a robot on one leg comes to rest with them."""

from __future__ import annotations

import numpy as np
import pytest
from effect_tools import PAPER, config, on_one_leg, trunk_config
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq, root
from scipy.spatial.transform import Rotation
from synthetic import robot

from coman_reduced_model.core.base.types import Foot, Phase, SupportState
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.effects.catalogue import build_effects
from coman_reduced_model.core.effects.hooks import LegSprings
from coman_reduced_model.core.model.cartesian import Model
from coman_reduced_model.core.model.springs import Springs
from coman_reduced_model.core.predictor import Predictor
from coman_reduced_model.core.robot.robot import Robot

LEFT = Config().robot.left
KNEE = LEFT.joints.index("LKneeSag")
K, D = np.array(LEFT.stiffness), np.array(LEFT.damping)
# Twice as stiff it sags half as much, and linear statics are four times as exact; well damped it soon comes to rest.
STIFF = {f"robot.{side}.{key}": list(values) for side in ("left", "right")
         for key, values in (("stiffness", 2.0 * K), ("damping", 5.0 * D))}  # fmt: skip
BENT = np.array([-0.4, 0.0, 0.0, 0.8, -0.4, 0.0] * 2)
GRAVITY = 9.81


def leg(settings: Config, deflection, rate=0.0, motor_rate=0.0, foot=Foot.LEFT) -> LegSprings:
    def full(x):
        return np.broadcast_to(np.asarray(x, float), 6).copy()

    springs = Springs(settings.robot, build_effects(settings.effects, robot())[0], False)
    return springs.leg(foot, np.eye(6), np.zeros(3), 170.0, full(deflection), full(rate), full(motor_rate))


def torque(found: LegSprings) -> np.ndarray:
    """(6,) what pulls the links back."""
    return found.torque + found.K_q @ found.deflection + found.D_q @ found.rate


def cubic_spring(k, cubic, d):
    """Straight from where a softening spring's tangent is a fifth."""
    edge = np.sqrt(0.8 / (-3.0 * cubic)) if cubic < 0 else np.inf
    bent = np.clip(d, -edge, edge)
    return k * (bent + cubic * bent**3 + (1.0 + 3.0 * cubic * bent**2) * (d - bent))


def play(k, width, d):
    return k * np.sign(d) * max(abs(d) - width / 2.0, 0.0)


@given(d=st.floats(-0.2, 0.2), cubic=st.floats(-200.0, 200.0))
def test_a_spring_hardens_or_softens(d, cubic):
    found = leg(config("spring_nonlinearity", "LKneeSag", cubic=cubic), d)
    assert torque(found)[KNEE] == pytest.approx(cubic_spring(180.0, cubic, d), abs=1e-9)
    h = 1e-6
    slope = (cubic_spring(180.0, cubic, d + h) - cubic_spring(180.0, cubic, d - h)) / (2 * h)
    assert found.K_q[KNEE, KNEE] == pytest.approx(slope, rel=1e-3, abs=0.2)
    assert found.K_q[KNEE, KNEE] >= 0.199 * 180.0
    others = np.delete(np.arange(6), KNEE)
    np.testing.assert_allclose(torque(found)[others], K[others] * d)


@given(d=st.floats(-0.1, 0.1), width=st.floats(0.001, 0.05))
def test_play_transmits_nothing(d, width):
    found = leg(config("backlash", "LKneeSag", width=width), d)
    # The edges are rounded by a tenth of half the play, and a hundredth of the stiffness is left inside.
    assert torque(found)[KNEE] == pytest.approx(play(180.0, width, d), abs=180.0 * 0.05 * width)
    if abs(d) < 0.2 * width:
        assert found.K_q[KNEE, KNEE] < 0.02 * 180.0 and found.D_q[KNEE, KNEE] < 0.02 * 4.0
    if abs(d) > width:
        assert found.K_q[KNEE, KNEE] == pytest.approx(180.0, rel=1e-3)
    law = [torque(leg(config("backlash", "LKneeSag", width=width), x))[KNEE] for x in (d - 1e-6, d + 1e-6)]
    assert found.K_q[KNEE, KNEE] == pytest.approx((law[1] - law[0]) / 2e-6, rel=1e-2, abs=0.1)


def test_lost_motion_that_friction_holds_depends_on_the_past():
    """Loaded beyond its friction it gives way by half the width, stays, and comes back under the opposite load only."""
    settings = config("hysteresis", "LKneeSag", width=0.02, friction=0.9)
    effects = build_effects(settings.effects, robot())[0]
    springs = Springs(settings.robot, effects, False)

    def pulled(d: float) -> float:
        found = springs.leg(Foot.LEFT, np.eye(6), np.zeros(3), 170.0, np.full(6, d), np.zeros(6), np.zeros(6))
        others = np.delete(np.arange(6), KNEE)
        np.testing.assert_allclose(torque(found)[others], K[others] * d)
        return float(torque(found)[KNEE])

    assert pulled(0.004) == pytest.approx(180.0 * 0.004)  # below the friction it is a spring
    assert pulled(0.01) == pytest.approx(0.9)  # it slips at the friction
    assert pulled(0.03) == pytest.approx(180.0 * 0.02)  # all of it is gone
    assert pulled(0.012) == pytest.approx(180.0 * 0.002)  # and stays gone
    assert pulled(0.002) == pytest.approx(-0.9)
    assert pulled(-0.03) == pytest.approx(-180.0 * 0.02)
    assert pulled(-0.012) == pytest.approx(-180.0 * 0.002)
    effects[0].reset()
    assert pulled(-0.004) == pytest.approx(-180.0 * 0.004)


def test_a_spring_that_warms_up_changes_from_the_first_sample_on():
    settings = config("stiffness_drift", "LKneeSag", change=-0.4, time=5.0)
    effects = build_effects(settings.effects, robot())[0]
    springs, begin = Springs(settings.robot, effects, False), 7 * 10**9
    support = SupportState(Phase.DOUBLE, Foot.LEFT, 0.5)
    for gone in (0.0, 1.0, 5.0, 100.0):
        effects[0].begin(begin + round(1e9 * gone), support)
        effects[0].reset()  # a gap does not cool it
        found = springs.leg(Foot.LEFT, np.eye(6), np.zeros(3), 170.0, np.full(6, 0.01), np.zeros(6), np.zeros(6))
        factor = np.ones(6)
        factor[KNEE] = 1.0 - 0.4 * (1.0 - np.exp(-gone / 5.0))
        np.testing.assert_allclose(torque(found), factor * K * 0.01)


@given(d=st.floats(-0.1, 0.1), compliance=st.floats(0.0, 0.02))
def test_motors_that_yield_are_in_series_with_every_spring(d, compliance):
    found = leg(config("motor_compliance", compliance=compliance), d)
    np.testing.assert_allclose(torque(found), d / (1.0 / K + compliance), rtol=1e-12)
    np.testing.assert_allclose(np.diag(found.K_q), 1.0 / (1.0 / K + compliance), rtol=1e-12)


@given(motor=st.floats(-3.0, 3.0), rate=st.floats(-3.0, 3.0), coulomb=st.floats(0.0, 20.0), creep=st.floats(0.001, 1.0))
def test_friction_is_against_the_motion_of_the_link(motor, rate, coulomb, creep):
    found = leg(config("joint_friction", "LKneeSag", coulomb=coulomb, creep=creep), 0.0, rate, motor)
    speed = motor + rate
    friction = torque(found) - D * rate
    assert friction[KNEE] == pytest.approx(coulomb * np.tanh(speed / creep), abs=1e-9 * (1 + coulomb))
    assert np.abs(np.delete(friction, KNEE)).max() < 1e-12
    assert found.D_q[KNEE, KNEE] >= D[KNEE]  # it never drives


@pytest.mark.parametrize("where, left, right", [
    ("LKneeSag", [KNEE], []), ("RKneeSag", [], [KNEE]), ("left", range(6), []), ("", range(6), range(6))
])  # fmt: skip
def test_stiffness_and_damping_of_a_joint_a_leg_or_all(where, left, right):
    for foot, joints in ((Foot.LEFT, left), (Foot.RIGHT, right)):
        factor = np.ones(6)
        factor[list(joints)] = 0.6
        found = leg(config("joint_stiffness", where, scale=0.6), 0.01, foot=foot)
        np.testing.assert_allclose(np.diag(found.K_q), factor * K)
        np.testing.assert_allclose(np.diag(found.D_q), D)
        found = leg(config("joint_damping", where, scale=0.6), 0.01, foot=foot)
        np.testing.assert_allclose(np.diag(found.K_q), K)
        np.testing.assert_allclose(np.diag(found.D_q), factor * D)


def several() -> Config:
    """Weaker knee with play on a motor that yields; named in an order in which they do not act."""
    settings = config("motor_compliance", compliance=0.0003)
    settings = config("backlash", "LKneeSag", settings, width=0.01)
    return config("joint_stiffness", "LKneeSag", settings, scale=0.7)


@given(tau=st.floats(0.5, 20.0), sign=st.sampled_from([-1.0, 1.0]))
def test_effects_in_series_share_the_torque(tau, sign):
    """Deflections add up: tau / (0.7 k) + half the play + compliance tau."""
    d = sign * (tau / (0.7 * 180.0) + 0.005 + 0.0003 * tau)
    assert torque(leg(several(), d))[KNEE] == pytest.approx(sign * tau, rel=0.01, abs=0.05)


def at_rest(law, down=(0.0, 0.0, -1.0), force=(0.0, 0.0, 0.0), theta=BENT) -> np.ndarray:
    """Link positions (12,) of a robot at rest on its left sole, from the gradient of its energy alone.

    law(joint, d): torque that pulls a link back from a deflection d; down: where gravity pulls, in the sole; force: on
    the COM of the trunk.
    """
    machine, posture = robot(), robot().posture()
    trunk = machine.model.inertias[machine.model.frames[machine.base_id].parentJoint].lever

    def potential(d):
        q = theta.copy()
        q[:6] += d
        posture.update(q, np.zeros(12))
        point = posture.R[Foot.LEFT].T @ (trunk - posture.p[Foot.LEFT])
        return -machine.mass * GRAVITY * np.dot(down, posture.com_in_sole(Foot.LEFT)[0]) - np.dot(force, point)

    def gradient(d):
        h = 1e-5
        slope = [(potential(d + h * e) - potential(d - h * e)) / (2 * h) for e in np.eye(6)]
        return np.array([law(i, d[i]) for i in range(6)]) + slope

    found = root(gradient, -np.array([0.0, 0.0, 0.0, 0.1, 0.05, 0.0]) * 0.1, tol=1e-9)
    assert np.abs(gradient(found.x)).max() < 1e-5, found.message
    q = theta.copy()
    q[:6] += found.x
    return q


def linear(i, d):
    return 2.0 * K[i] * d


def knee(law):
    return lambda i, d: law(d) if i == KNEE else linear(i, d)


def series(d):
    def rest(tau):
        return tau / (0.7 * 360.0) + np.clip(tau / 1e-6, -1.0, 1.0) * 0.005 + 0.0003 * tau - d

    return brentq(rest, -100.0, 100.0, xtol=1e-12)


PITCH, ROLL = 0.03, -0.02
DOWN = (np.sin(PITCH), -np.cos(PITCH) * np.sin(ROLL), -np.cos(PITCH) * np.cos(ROLL))
CASES = {
    "nothing": ({}, linear, {}),
    "joint_stiffness": ({"scale": 0.7}, knee(lambda d: 0.7 * 360.0 * d), {}),
    "spring_nonlinearity": ({"cubic": 150.0}, knee(lambda d: cubic_spring(360.0, 150.0, d)), {}),
    "softening": ({"cubic": -150.0}, knee(lambda d: cubic_spring(360.0, -150.0, d)), {}),
    "backlash": ({"width": 0.02}, knee(lambda d: play(360.0, 0.02, d)), {}),
    "motor_compliance": ({"compliance": 0.0005}, lambda i, d: d / (0.5 / K[i] + 0.0005), {}),
    "ground_slope": ({"roll": ROLL, "pitch": PITCH}, linear, {"down": DOWN}),
    "external_force": ({"x": 4.0, "y": -3.0}, linear, {"force": (4.0, -3.0, 0.0)}),
    "several": ({}, lambda i, d: series(d) if i == KNEE else d / (0.5 / K[i] + 0.0003), {}),
}


def on_broad_soles() -> Robot:
    """The robot that does not topple sideways on one leg."""
    machine = robot().copy()
    machine.soles = dict.fromkeys(machine.soles, np.array([-0.1, 0.2, -0.15, 0.15]))
    return machine


def settled(settings: Config, seconds: float = 15.0, start: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """COM (3,) and tilt (2,) of a free run of a robot whose motors stand still, after it has come to rest."""
    predictor = Predictor(on_broad_soles(), settings)
    q = BENT if start is None else start
    for k in range(round(20 * seconds)):
        result = predictor.update(on_one_leg(10**9 + 50_000_000 * k, q, BENT))
    assert np.abs(result.predicted_com_vel).max() < 1e-3  # impulses are found to a thousandth: soft robots rock
    return result.predicted_com, result.predicted_tilt


@pytest.mark.parametrize("case", CASES)
def test_a_robot_on_one_leg_rests_where_its_energy_is_least(case):
    """The free run of the turning trunk against statics that know nothing of it."""
    values, law, outside = CASES[case]
    name = {"softening": "spring_nonlinearity"}.get(case, case)
    base = trunk_config().replaced({"prediction.horizons": [], **STIFF})
    if case == "several":
        joined = several()
        settings = base.replaced({k: v for k, v in joined.flat().items() if k.startswith("effects.")}).replaced(
            {"effects.active": (*joined.flat()["effects.active"], *base.flat()["effects.active"])}
        )
    elif case == "nothing":
        settings = base
    else:
        where = "LKneeSag" if name in ("joint_stiffness", "spring_nonlinearity", "backlash") else ""
        settings = config(name, where, base, **values)
    q = at_rest(law, **outside)
    posture = robot().posture()
    posture.update(q, np.zeros(12))
    expected = posture.com_in_sole(Foot.LEFT)[0]
    com, _ = settled(settings)
    posture.update(BENT, np.zeros(12))
    sag = np.linalg.norm(expected - posture.com_in_sole(Foot.LEFT)[0])
    assert sag > 0.002
    np.testing.assert_allclose(com, expected, atol=0.035 * sag)
    if case != "nothing":
        plain, _ = settled(base)
        assert np.linalg.norm(com - expected) < 0.17 * np.linalg.norm(plain - expected)


@pytest.mark.parametrize("case", ["ground_slope", "external_force"])
@pytest.mark.parametrize("stiffness", ["full", "condensed"])
def test_the_point_mass_gives_way_to_forces_by_its_stiffness(case, stiffness):
    values, _, outside = CASES[case]
    base = PAPER.replaced(
        {"model.lateral_compliance": "with", "model.stiffness": stiffness, "prediction.horizons": [], **STIFF}
    )
    weight = robot().mass * GRAVITY
    force = weight * (np.array(outside.get("down", (0, 0, -1.0))) + [0, 0, 1]) + outside.get("force", np.zeros(3))
    posture = robot().posture()
    posture.update(BENT, np.zeros(12))
    stiff = Model(robot(), base).leg_stiffness(posture, Foot.LEFT, weight)[0]
    moved = settled(config(case, base=base, **values))[0] - settled(base)[0]
    np.testing.assert_allclose(moved, np.linalg.solve(stiff, force), atol=1e-6)


@pytest.mark.parametrize("stiffness", ["full", "condensed"])
def test_the_point_mass_feels_springs_that_are_not_linear(stiffness):
    """At rest the joints' torques balance the COM's weight as before, and the play of the knee adds to its sag."""
    base = PAPER.replaced({"model.stiffness": stiffness, "prediction.horizons": []})
    posture = robot().posture()
    posture.update(BENT, np.zeros(12))
    J = posture.leg_jacobian(Foot.LEFT)
    d = -robot().mass * GRAVITY * J[2] / K
    q = BENT.copy()
    q[:6] += d
    play_taken = np.sign(d[KNEE]) * 0.006
    q[KNEE] += play_taken
    moved = settled(config("backlash", "LKneeSag", base, width=0.012), start=q)[0] - settled(base, start=q)[0]
    rows = 6 if stiffness == "full" else 3
    compliance = J[:rows] @ np.diag(1.0 / K) @ J[:rows].T
    expected = (compliance[:3, :3] if rows == 3 else np.linalg.inv(np.linalg.inv(compliance)[:3, :3])) @ (
        np.linalg.solve(compliance, J[:rows, KNEE] * play_taken)[:3]
    )
    np.testing.assert_allclose(moved[2], expected[2], rtol=0.05)


# A foot that rolls moves the COM sideways and down: without y the point mass feels little of it.
POINT_MASS = PAPER.replaced({"model.stiffness": "condensed", "model.lateral_compliance": "with"})


@pytest.mark.parametrize("base", [trunk_config(), POINT_MASS], ids=["trunk", "point mass"])
def test_ground_that_gives_way_is_seen_by_the_wrench_and_felt_by_the_model(base):
    """Joints and ground at rest where their energy is least: nine springs, of which the encoders see six."""
    soft = np.array([5e-6, 5e-4, 5e-4])
    machine, posture = robot(), robot().posture()

    def com(x) -> np.ndarray:
        q = BENT.copy()
        q[:6] += x[:6]
        posture.update(q, np.zeros(12))
        turned = Rotation.from_rotvec([x[7], x[8], 0.0]).as_matrix()
        return turned @ posture.com_in_sole(Foot.LEFT)[0] + [0.0, 0.0, x[6]]

    stiff = np.concatenate((2.0 * K, 1.0 / soft))

    def gradient(x):
        h = 1e-5
        slope = [(com(x + h * e)[2] - com(x - h * e)[2]) / (2 * h) for e in np.eye(9)]
        return stiff * x + machine.mass * GRAVITY * np.array(slope)

    rest = root(gradient, np.zeros(9), tol=1e-9)
    assert np.abs(gradient(rest.x)).max() < 1e-4, rest.message
    q = BENT.copy()
    q[:6] += rest.x[:6]
    wrench = np.concatenate((np.zeros(2), -rest.x[6:] / soft, np.zeros(1)))
    assert wrench[2] == pytest.approx(machine.mass * GRAVITY, rel=1e-3)
    settings = base.replaced({"prediction.horizons": [], **STIFF})
    yielding = config("ground_compliance", "", settings, vertical=5e-6, rotational=5e-4)
    found = {}
    for name, each in (("hard", settings), ("soft", yielding)):
        predictor = Predictor(on_broad_soles(), each)
        for k in range(300):
            sample = on_one_leg(10**9 + 50_000_000 * k, q.copy(), BENT)
            sample.left_wrench = wrench.copy()
            result = predictor.update(sample)
        found[name] = result
    true, gave_way = com(rest.x), np.linalg.norm(com(rest.x) - found["hard"].measured_com)
    assert gave_way > 0.001
    assert np.linalg.norm(found["soft"].measured_com - true) < 0.05 * gave_way
    if base.turning:
        assert np.linalg.norm(found["soft"].predicted_com - true) < 0.1 * gave_way
        assert np.linalg.norm(found["hard"].predicted_com - true) > 0.5 * gave_way
    else:  # the paper's point mass takes the Jacobian to stay: to a quarter
        sagged = found["soft"].predicted_com - found["hard"].predicted_com
        assert sagged[2] == pytest.approx((true - found["hard"].measured_com)[2], rel=0.25)
