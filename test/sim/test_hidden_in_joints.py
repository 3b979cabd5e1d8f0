# SPDX-License-Identifier: BSD-3-Clause
"""Hidden effects of springs and motors against closed forms that do not use their code."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from sim_runs import KNEES, D, K, Run

from coman_reduced_model.errors import ConfigError
from coman_reduced_model.sim.describe import urdf
from coman_reduced_model.sim.disturbances import make
from coman_reduced_model.sim.robot_table import COMAN
from coman_reduced_model.sim.sensors import SensorOptions
from coman_reduced_model.sim.spring_laws import SpringLaws

# --- springs ---


def test_a_scaled_spring_sags_by_its_torque_over_the_scaled_stiffness(standing, still):
    run = Run(standing, 0.1, "joint_stiffness:where=KneeSag,scale=0.8+joint_stiffness:where=left,scale=0.5")
    truth = run.truths[-1]
    scale = np.where(np.arange(12) < 6, 0.5, 1.0) * np.where(np.isin(np.arange(12), KNEES), 0.8, 1.0)
    assert truth.motor_q - truth.q == pytest.approx(truth.tau / (scale * K), abs=2e-4)
    assert abs(truth.motor_q - truth.q)[9] > 1.1 * abs(still.truths[-1].motor_q - still.truths[-1].q)[9]


def test_a_scaled_damper_transmits_its_scale_times_the_rate(walking):
    run = Run(walking, 1.5, "joint_damping:where=LKneeSag,scale=2.5")
    rate = run.damped()
    spring = K * (run.truth("motor_q") - run.truth("q"))
    scale = np.where(np.arange(12) == 3, 2.5, 1.0)
    assert run.truth("tau") - spring == pytest.approx(scale * D * rate, abs=1e-6)
    assert np.abs(D * rate)[:, 3].max() > 0.5


@pytest.mark.parametrize("cubic", [200.0, -60.0])
def test_a_bent_spring_law(walking, cubic):
    run = Run(walking, 1.5, f"spring_nonlinearity:where=KneeSag,cubic={cubic}")
    d, rate = run.truth("motor_q") - run.truth("q"), run.damped()
    law = K * d * (1.0 + np.where(np.isin(np.arange(12), KNEES), cubic, 0.0) * d**2) + D * rate
    bent = np.abs(d) < np.sqrt(0.8 / (3 * 60.0))
    assert run.truth("tau")[bent] == pytest.approx(law[bent], abs=1e-6)
    assert np.abs(d[bent]).max() > 0.03
    hidden = make("spring_nonlinearity", {"where": "LKneeSag", "cubic": cubic})
    hidden.start(COMAN, run.robot.model, np.random.default_rng())
    grid = np.linspace(-0.3, 0.3, 601)[:, None] * np.ones(12)
    springs = SpringLaws.of(hidden.spring_laws(), 12)
    torque = K * grid + np.array([springs.torque(0.0, row, 0.0 * row) for row in grid])
    assert np.all(np.diff(torque[:, 3]) > 0.19 * K[3] * 0.001)  # it never pushes the wrong way


def test_backlash_is_seen_as_its_half_width_beside_the_deflection(standing):
    truth = Run(standing, 0.1, "backlash:where=LKneeSag,width=0.02").truths[-1]
    deflection = truth.motor_q - truth.q
    assert truth.tau[3] == pytest.approx(K[3] * (deflection[3] - np.sign(deflection[3]) * 0.01), abs=0.02)
    assert truth.tau[9] == pytest.approx(K[9] * deflection[9], abs=0.02)


def test_friction_at_the_link_stands_between_spring_and_statics(walking):
    """Spring torque minus the inverse dynamics of the true motion is the friction, against the rate."""
    run = Run(walking, 2.6, "joint_friction:where=LKneeSag,coulomb=2.0")
    model = pin.buildModelFromXML(urdf(COMAN), pin.JointModelFreeFlyer())
    data = model.createData()
    t = run.truth("t")
    swing = (t > 1.25) & (t < 1.6)  # the shank and foot hang from the knee: no ground force to know
    knee, tail = model.getJointId("LKneeSag"), None
    acceleration = np.gradient(run.truth("qd"), t, axis=0)
    found = []
    base_rate = np.gradient(run.truth("base_position"), t, axis=0)
    base_acceleration = np.gradient(base_rate, t, axis=0)
    for k in np.flatnonzero(swing):
        truth = run.truths[k]
        q, v, a = pin.neutral(model), np.zeros(18), np.zeros(18)
        q[:3], q[3:7], q[7:] = truth.base_position, truth.base_orientation, truth.q
        R = pin.Quaternion(truth.base_orientation).matrix()
        v[6:], a[6:] = truth.qd, acceleration[k]
        a[:3] = R.T @ base_acceleration[k]
        tail = pin.rnea(model, data, q, v, a)[model.joints[knee].idx_v]
        found.append((truth.tau[3] - tail, truth.qd[3]))
    friction, rate = np.array(found).T
    moving = np.abs(rate) > 0.3
    assert moving.sum() > 20
    assert np.median(friction[moving] * np.sign(rate[moving])) == pytest.approx(2.0, abs=0.25)


# --- motors ---


def test_a_lagging_motor_follows_a_ramp_by_its_time_constant(walking):
    run = Run(walking, 2.6, "motor_lag:time_constant=0.015")
    reference, rate = walking(run.truth("t"))
    assert reference - run.truth("motor_q") == pytest.approx(0.015 * run.truth("motor_qd"), abs=1e-9)
    assert np.abs(reference - run.truth("motor_q")).max() > 0.01
    assert run.positions("motor_states") == pytest.approx(run.truth("motor_q"), abs=1e-12)


def test_a_transport_delay_moves_the_reference_in_time(walking):
    run = Run(walking, 1.8, "transport_delay:delay=0.0125")
    assert run.truth("motor_q") == pytest.approx(walking(run.truth("t") - 0.0125)[0], abs=1e-9)


def test_motor_states_can_echo_the_command(walking):
    run = Run(walking, 1.8, "transport_delay:delay=0.0125", motor_source="commanded")
    assert run.positions("motor_states") == pytest.approx(walking(run.truth("t"))[0], abs=1e-9)
    with pytest.raises(ConfigError, match="motor_source.*allowed"):
        SensorOptions(motor_source="guessed")


def test_a_yielding_loop_gives_way_by_compliance_times_torque(standing):
    run = Run(standing, 0.1, "motor_compliance:compliance=0.0005")
    truth = run.truths[-1]
    reference = standing(np.array([truth.t]))[0][0]
    assert reference - truth.motor_q == pytest.approx(0.0005 * truth.tau, abs=2e-5)
