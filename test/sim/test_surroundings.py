# SPDX-License-Identifier: BSD-3-Clause
"""Floors, contacts, controllers and upper bodies of the virtual robot."""

from __future__ import annotations

import numpy as np
import pytest

from coman_reduced_model.core.gait.gait import plan_walk
from coman_reduced_model.errors import ConfigError
from coman_reduced_model.sim.contact import Contact, Floor
from coman_reduced_model.sim.controller import Controller
from coman_reduced_model.sim.describe import mujoco_spec
from coman_reduced_model.sim.disturbances import Later, parse
from coman_reduced_model.sim.motion import plan_motion
from coman_reduced_model.sim.record import robot_gait
from coman_reduced_model.sim.robot_table import COMAN, UpperBody, with_upper_body
from coman_reduced_model.sim.sensors import SensorOptions
from coman_reduced_model.sim.upper_motion import UpperMotion
from coman_reduced_model.sim.virtual_robot import VirtualRobot
from coman_reduced_model.sim.worlds import world_of

WEIGHT = 17.3 * 9.81
WHOLE = with_upper_body(COMAN)


class Run:
    """A motion gone through with exact sensors."""

    def __init__(self, motion, seconds: float, table=COMAN, sensors=None, settle: float = 1.0, **options) -> None:
        self.robot = VirtualRobot(table, sensors or SensorOptions.exact(), **options)
        self.robot.reset(motion, settle_s=settle)
        self.readings, self.truths = [], []
        while self.robot.t < seconds - 1e-9 and not self.robot.fallen:
            self.readings.append(self.robot.step())
            self.truths.append(self.robot.truth)

    def truth(self, name: str) -> np.ndarray:
        return np.array([getattr(truth, name) for truth in self.truths])


def creep(run: Run) -> float:
    """Farthest that the right sole moves along the floor while it bears most of the weight [m]."""
    bears = run.truth("right_wrench")[:, 2] > 0.8 * WEIGHT
    sole = run.truth("T_right")[bears][:, :2, 3]
    return float(np.linalg.norm(sole - sole[0], axis=1).max())


# --- contact and floor ---


def test_soles_creep_on_a_creeping_contact_more_than_on_a_firm_one(walking):
    runs = [Run(walking, 1.75, contact=world_of(kind).contact) for kind in ("firm", "creeping")]
    firm, creeping = map(creep, runs)  # the left foot swings from 1.2 to 1.7 s
    assert creeping > 3.0 * firm > 0.0


def test_soles_hold_on_a_holding_contact_where_a_firm_one_drifts(standing):
    """A constant pull: regularised friction lets the soles drift at a constant speed."""

    def drift(kind: str) -> float:
        run = Run(standing, 2.0, contact=world_of(kind).contact, disturbances=[parse("external_force:y=15")])
        soles = run.truth("T_left")[:, :2, 3]
        return float(np.linalg.norm(soles[-1] - soles[0]))

    firm = drift("firm")
    assert firm > 1e-5 and drift("holding") < 0.2 * firm


def test_soft_soles_sink_in(standing):
    runs = [Run(standing, 0.05, contact=world_of(kind).contact) for kind in ("firm", "soft_soles")]
    firm, soft = (run.truths[-1].T_left[2, 3] for run in runs)
    assert -0.0003 < firm < 0.0 and -0.006 < soft < firm - 0.0003


def test_a_contact_has_a_friction_of_its_own_or_that_of_the_robot():
    for contact, friction in ((Contact(), COMAN.friction), (Contact(friction=0.35), 0.35)):
        model = mujoco_spec(COMAN, contact).compile()
        touching = model.geom_friction[model.geom_contype > 0]
        assert len(touching) == 3 and touching[:, 0] == pytest.approx(friction)


def test_tiles_have_the_heights_of_their_seed(standing):
    floor = Floor(tile_height=0.002, tile_size=0.4, seed=5)
    model = mujoco_spec(COMAN, floor=floor).compile()
    tiles = [i for i in range(model.ngeom) if model.geom(i).name.startswith("tile_")]
    tops = sorted(float(model.geom_pos[i][2] + model.geom_size[i][2]) for i in tiles)
    assert tops == pytest.approx(sorted(floor.heights().ravel()))
    assert max(np.abs(tops)) <= 0.001 and np.ptp(tops) > 0.0015
    assert Floor(tile_height=0.002, tile_size=0.4, seed=6).heights().tolist() != floor.heights().tolist()


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Contact(cone="round"), "allowed: elliptic, pyramidal"),
        (lambda: Contact(impratio=0.0), "allowed: positive"),
        (lambda: Contact(solref=(-1.0, 1.0)), "allowed: positive"),
        (lambda: Contact(friction=-0.1), "not negative"),
        (lambda: Contact(modulus=1.0), "1e4 to 1e9"),
        (lambda: Contact(noslip_iterations=-1), "0 to 100"),
        (lambda: Floor(tile_height=0.1), "0 to 0.02"),
        (lambda: Floor(tile_size=0.0), "0.05 to 1"),
        (lambda: Controller(kind="magic"), "allowed"),
        (lambda: UpperMotion(arms=3.0), "0 to 1 rad"),
        (lambda: UpperBody(waist=0), "waist = 0: allowed: 1 to 3 joints"),
        (lambda: UpperBody(arm=7), "arm = 7: allowed: 3 to 6 joints"),
    ],
)
def test_what_is_not_possible_is_refused(make, words):
    with pytest.raises(ConfigError, match=words):
        make()


# --- controllers ---


def test_without_a_controller_motors_follow_their_plan(walking):
    run = Run(walking, 2.0)
    plan = walking(run.truth("t"))[0]
    assert run.truth("motor_q") == pytest.approx(plan, abs=1e-9)


@pytest.mark.parametrize("kind", ["imu_control", "feet_control"])
def test_a_stabiliser_moves_the_motors_off_their_plan_by_milliradians(walking, kind):
    sensors = SensorOptions.exact(imu=False)  # a stabiliser has the IMU that is not published
    run = Run(walking, 3.0, sensors=sensors, controller=world_of(kind).controller)
    off = np.abs(run.truth("motor_q") - walking(run.truth("t"))[0]).max(axis=0)
    names = COMAN.joint_names
    moved = {name for name, size in zip(names, off, strict=True) if size > 1e-6}
    assert moved == {name for name in names if name[1:] in ("HipSag", "HipLat", "AnkSag", "AnkLat")}
    assert 1e-3 < off.max() < 0.05 and not run.robot.fallen
    assert all(reading.imu is None for reading in run.readings)


def test_a_stabiliser_stands_up_against_a_push(standing):
    def lean(controller: Controller | None) -> float:
        push = Later(parse("external_force:x=12"), 1.5)
        run = Run(standing, 3.5, controller=controller, disturbances=[push])
        before, after = (truth.base_orientation[1] for truth in (run.truths[280], run.truths[-1]))
        return abs(2.0 * (after - before))

    assert lean(world_of("imu_control").controller) < 0.8 * lean(None)


# --- waist, arms and a head ---


@pytest.fixture(scope="module")
def whole():
    upper = UpperMotion(arms=0.3, waist_yaw=0.1, waist_pitch=0.02)
    return plan_motion(WHOLE, plan_walk(robot_gait(WHOLE, "test1")), upper=upper)[0]


def test_a_whole_robot_walks_with_swinging_arms(whole):
    run = Run(whole, 4.0, table=WHOLE)
    assert not run.robot.fallen
    assert len(run.readings[-1].joint_states.position) == len(WHOLE.joint_names) == 24
    q = dict(zip(WHOLE.joint_names, run.truth("q").T, strict=True))
    late = run.truth("t") > 2.5
    left, right = q["LShSag"][late], q["RShSag"][late]
    assert np.ptp(left) == pytest.approx(0.6, rel=0.3) and np.corrcoef(left, right)[0, 1] < -0.9
    assert np.ptp(q["WaistYaw"][late]) == pytest.approx(0.2, rel=0.3)
    assert q["LElbow"][late] == pytest.approx(-0.5, abs=0.05)
    assert run.truth("q")[:200, 12:] == pytest.approx(np.tile(run.truth("q")[0, 12:], (200, 1)), abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("joints", [(1, 3, 1), (2, 5, 2), (3, 6, 3)])
def test_upper_bodies_with_fewer_or_more_joints_weigh_the_same(joints):
    table = with_upper_body(COMAN, UpperBody(*joints))
    waist, arm, neck = joints
    assert len(table.joint_names) == 12 + waist + 2 * arm + neck
    assert table.mass == pytest.approx(WHOLE.mass) and all(joint.link.mass > 0.0 for joint in table.upper)
    assert table.gait["com_height_m"] == pytest.approx(WHOLE.gait["com_height_m"], abs=0.005)
    plan = plan_walk(robot_gait(table, "test1"))
    run = Run(plan_motion(table, plan, upper=UpperMotion(arms=0.3))[0], 4.0, table=table)
    assert not run.robot.fallen


def test_arms_can_swing_together():
    upper = UpperMotion(arms=0.3, together=True)
    angles = upper.at(WHOLE, np.linspace(0.0, 6.0, 50), np.ones(50))
    names = [joint.name for joint in WHOLE.upper]
    assert angles[:, names.index("LShSag")].tolist() == angles[:, names.index("RShSag")].tolist()
    assert np.abs(upper.at(WHOLE, np.linspace(0.0, 6.0, 50), np.zeros(50))[:, names.index("LShSag")]).max() == 0.0
