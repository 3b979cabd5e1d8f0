# SPDX-License-Identifier: BSD-3-Clause
"""Loads and motors: against URDFs that have the load, and against motors whose true motion is known."""

from __future__ import annotations

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from effect_tools import PAPER, config, predicted, same, spoilt, trunk_config, values
from scipy.integrate import solve_ivp
from synthetic import T0, description, posture, robot, velocity, walk

from coman_reduced_model.core.base.stream_names import MOTORS
from coman_reduced_model.core.base.types import Phase, PlannedSteps, Reference, Sample
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.effects.catalogue import build_effects
from coman_reduced_model.core.predictor import Predictor
from coman_reduced_model.core.robot.robot import Robot
from coman_reduced_model.errors import ConfigError

LOAD = """
    <link name="load"><inertial><origin xyz="0.02 0.01 0.05"/><mass value="1.5"/>
      <inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial></link>
    <joint name="load" type="fixed"><parent link="base_link"/><child link="load"/><origin xyz="-0.05 0.02 0.1"/></joint>
"""
TRUNK_COM = '<origin xyz="-0.005 0 0.077" rpy="0 0 0"'


@pytest.mark.parametrize("base", [PAPER, trunk_config()], ids=["point mass", "trunk"])
def test_a_payload_is_a_mass_in_the_urdf(base):
    heavy = Robot(description().replace("</robot>", f"{LOAD}</robot>"), Config().robot)
    assert heavy.mass == pytest.approx(robot().mass + 1.5)
    expected, _ = predicted(walk(1.0), base, heavy)
    results, pipeline = predicted(walk(1.0), config("payload", base=base, mass=1.5, x=-0.03, y=0.03, z=0.15))
    same(results, expected, 1e-12)
    assert pipeline.robot.mass == pytest.approx(heavy.mass)
    without, _ = predicted(walk(1.0), base)
    assert np.nanmax(np.abs(values(without, "measured_com") - values(expected, "measured_com"))) > 1e-3


@pytest.mark.parametrize("base", [PAPER, trunk_config()], ids=["point mass", "trunk"])
def test_a_com_offset_is_an_inertial_origin_in_the_urdf(base):
    assert f"<inertial>\n      {TRUNK_COM}" in description()
    moved = Robot(description().replace(TRUNK_COM, '<origin xyz="0.015 -0.01 0.107" rpy="0 0 0"', 1), Config().robot)
    expected, _ = predicted(walk(1.0), base, moved)
    results, _ = predicted(walk(1.0), config("com_offset", base=base, x=0.02, y=-0.01, z=0.03))
    same(results, expected, 1e-12)


def test_a_link_that_is_heavier_is_so_in_the_urdf():
    root = ElementTree.fromstring(description())
    child = next(j.find("child").get("link") for j in root.iterfind("joint") if j.get("name") == "RKneeSag")
    inertial = next(link for link in root.iterfind("link") if link.get("name") == child).find("inertial")
    inertial.find("mass").set("value", str(1.6 * float(inertial.find("mass").get("value"))))
    for key, value in inertial.find("inertia").attrib.items():
        inertial.find("inertia").set(key, str(1.6 * float(value)))
    heavy = Robot(ElementTree.tostring(root, encoding="unicode"), Config().robot)
    loaded = build_effects(config("body_mass", "RKneeSag", scale=1.6).effects, robot())[1]
    for expected, found in zip(heavy.model.inertias, loaded.model.inertias, strict=True):
        np.testing.assert_allclose(found.toDynamicParameters(), expected.toDynamicParameters(), atol=1e-9)
    trunk = robot().model.frames[robot().base_id].parentJoint
    heavy = build_effects(config("body_mass", scale=0.9).effects, robot())[1]
    assert heavy.mass == pytest.approx(robot().mass - 0.1 * robot().model.inertias[trunk].mass)
    with pytest.raises(ConfigError, match=r"effects.body_mass.where: no joint 'Arm'"):
        build_effects(config("body_mass", "Arm").effects, robot())


def test_the_robot_that_was_given_is_left_as_it_is():
    before = [inertia.toDynamicParameters().copy() for inertia in robot().model.inertias]
    Predictor(robot(), config("payload", mass=3.0))
    Predictor(robot(), config("com_offset", x=0.1))
    np.testing.assert_array_equal(before, [inertia.toDynamicParameters() for inertia in robot().model.inertias])


def test_no_trunk_weighs_less_than_nothing():
    with pytest.raises(ConfigError, match=r"effects.payload.mass.*-2.5 kg"):
        Predictor(robot(), config("payload", mass=-8.0))


def test_a_delayed_reference_counts_when_it_is_done():
    """Motor states that echo the command 40 ms before the motion, exactly as if they had been measured."""

    def change(stream, message):
        return replace(message, stamp_ns=message.stamp_ns - 40_000_000) if stream == MOTORS else message

    results, _ = predicted(spoilt(change), config("transport_delay", delay=0.04))
    expected, _ = predicted(walk(1.0), PAPER)
    same(results[10:-10], expected[10:-10], 0.0)


def lagging(T: float, seconds: float):
    """Where first-order motors are, by numerical integration of T y' = u - y; u as in `synthetic.walk`."""
    u0, v0 = posture(0.0003) + 0.01, velocity(0.0003)
    times = 0.0003 + np.arange(round(200 * seconds)) / 200
    found = solve_ivp(
        lambda t, y: (posture(t) + 0.01 - y) / T, (times[0], times[-1]), u0 - T * v0, "DOP853", times, max_step=1e-3
    )
    return {round(1e9 * t): y for t, y in zip(found.t, found.y.T, strict=True)}


def test_motors_lag_behind_what_they_echo():
    T, motion = 0.03, lagging(0.03, 1.0)

    def change(stream, message):
        if stream != MOTORS:
            return message
        t = (message.stamp_ns - T0) * 1e-9
        y = motion[round(1e9 * t)]
        return replace(message, position=y, velocity=(posture(t) + 0.01 - y) / T)

    lagged, _ = predicted(spoilt(change), PAPER)
    results, _ = predicted(walk(1.0), config("motor_lag", time_constant=T))
    ideal, _ = predicted(walk(1.0), PAPER)
    for name in ("reference_com", "predicted_com"):
        error = np.nanmax(np.abs(values(results, name) - values(lagged, name)))
        effect = np.nanmax(np.abs(values(ideal, name) - values(lagged, name)))
        assert error < 0.02 * effect, name


def test_planned_steps_lag_as_the_plan_does():
    (effect,), _ = build_effects(config("motor_lag", time_constant=0.03).effects, robot())
    zero, eye, still = np.zeros(3), np.eye(4), np.zeros(12)
    steps = PlannedSteps(T0, 0.02, np.zeros((5, 3)), np.zeros((5, 14)), np.zeros(5, dtype=int))
    plan = Reference(T0, zero, zero, zero, zero, eye, eye, Phase.DOUBLE, 0, 0.02, np.zeros((5, 3)), np.zeros((5, 3)))
    sample = Sample(T0, still, still, reference=replace(plan, steps=steps))
    effect.correct(sample)
    assert sample.reference.steps.stamp_ns == T0 + 30_000_000 and steps.stamp_ns == T0


def test_the_plan_lags_with_its_preview():
    """A plan that moves steadily is followed a time constant behind, now and ahead, at any sample time."""
    T, v = 0.05, np.array([0.2, -0.1, 0.05])
    machine, still = robot(), np.zeros(12)
    (effect,), _ = build_effects(config("motor_lag", time_constant=T).effects, machine)
    for t in (0.0, 0.005, 0.02, 0.1):
        ahead = v * (t + 0.02 * np.arange(1, 6)[:, None])
        zero, eye = np.zeros(3), np.eye(4)
        plan = Reference(0, v * t, v, zero, zero, eye, eye, Phase.DOUBLE, 0, 0.02, ahead, np.tile(v, (5, 1)))
        sample = Sample(T0 + round(1e9 * t), still, still, reference=plan)
        effect.correct(sample)
        np.testing.assert_allclose(sample.reference.com, v * (t - T), atol=1e-12)
        np.testing.assert_allclose(sample.reference.preview_com, ahead - v * T, atol=1e-12)
        np.testing.assert_allclose(sample.reference.preview_com_vel, np.tile(v, (5, 1)), atol=1e-10)
        np.testing.assert_array_equal(plan.com, v * t)  # the plan itself is shared
