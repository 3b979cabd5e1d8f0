# SPDX-License-Identifier: BSD-3-Clause
"""What is hidden, as the diagnosis has it: what it says is compared with all that the robot has."""

from __future__ import annotations

import numpy as np
import pytest

from coman_reduced_model.judge.hidden import as_fitted, compared, in_all
from coman_reduced_model.sim.disturbances import Imperfections
from coman_reduced_model.sim.worlds import draw_world, world_yaml

WORLD = draw_world(3, {"imperfections": "imperfect", "body": "whole_body"})
OWN = Imperfections(seed=WORLD.seed, amount=WORLD.imperfections).drawn(WORLD.table)
JOINTS = [joint.name for joint in WORLD.table.joints()]


def with_own(name: str, where: str, **parameters: float) -> dict[str, float]:
    """Its parameters in an answer of this world, with what the robot has anyway."""
    effect = {"name": name, "where": where, "parameters": parameters}
    (found,) = in_all({"effects": [effect], "world": world_yaml(WORLD)})
    assert effect["parameters"] == parameters, "the answer stays as it is"
    return found["parameters"]


def test_play_and_zeros_of_a_joint_add_up():
    knee = JOINTS.index("RKneeSag")
    assert OWN["play"].min() > 0.0
    assert with_own("backlash", "RKneeSag", width=0.01)["width"] == pytest.approx(0.01 + OWN["play"][knee])
    assert with_own("encoder_bias", "RKneeSag", bias=-0.02)["bias"] == pytest.approx(-0.02 + OWN["encoder_zero"][knee])
    left = [joint.name[0] == "L" for joint in WORLD.table.leg_joints()]
    side = 0.01 + OWN["play"][: len(left)][left].mean()
    assert with_own("backlash", "left", width=0.01)["width"] == pytest.approx(side)
    legs = 0.01 + OWN["play"][: len(left)].mean()
    assert with_own("backlash", "", width=0.01)["width"] == pytest.approx(legs)


def test_delays_add_up_and_a_lag_counts_as_a_delay():
    late = 0.01 + OWN["delay"] + OWN["lag"][: len(WORLD.table.leg_joints())].mean()
    assert with_own("transport_delay", "", delay=0.01)["delay"] == pytest.approx(late)
    assert with_own("motor_lag", "", time_constant=0.01)["time_constant"] == pytest.approx(late)
    assert with_own("encoder_delay", "", delay=0.01)["delay"] == pytest.approx(0.01 + OWN["link_late"])
    for where, own in (("right", OWN["wrench_late"][1]), ("", OWN["wrench_late"].mean())):
        assert with_own("wrench_delay", where, delay=0.01)["delay"] == pytest.approx(0.01 + own)


def test_slopes_add_up_and_so_do_turns_and_gains_of_foot_sensors():
    slope = with_own("ground_slope", "", pitch=0.03)
    assert slope == {"pitch": pytest.approx(0.03 + OWN["slope"][1])}
    turned = with_own("sensor_rotation", "right", axis="y", angle=-0.1)
    assert turned == {"axis": "y", "angle": pytest.approx(-0.1 + OWN["wrench_turn"][1, 1])}
    for where, own in (("left", OWN["wrench_gain"][0, 2]), ("", OWN["wrench_gain"][:, 2].mean())):
        assert with_own("wrench_scale", where, scale=1.2)["scale"] == pytest.approx(1.2 * own)


def test_what_the_robot_has_nothing_of_stays_as_it_is():
    assert with_own("payload", "", mass=1.0, x=0.02) == {"mass": 1.0, "x": 0.02}
    effect = {"name": "backlash", "where": "", "parameters": {"width": 0.01}}
    assert in_all({"effects": [effect]}) == [effect]  # of an earlier version, without its world


def test_a_turned_sensor_has_the_axes_of_the_diagnosis():
    turn = {"name": "sensor_rotation", "where": "left", "parameters": {"axis": "y", "angle": -0.1}}
    assert compared(turn) == {"pitch": -0.1}
    load = {"name": "payload", "where": "", "parameters": {"mass": 2.0, "x": 0.05}}
    assert as_fitted(load) == {"mass": 2.0, "x": pytest.approx(0.1)}
    drift = {"name": "stiffness_drift", "where": "", "parameters": {"change": -0.1, "time": 8.0}}
    assert compared(drift) == {"change": -0.1} and np.isfinite(as_fitted(drift)["change"])
