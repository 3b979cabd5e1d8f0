# SPDX-License-Identifier: BSD-3-Clause
"""Each hidden effect against a closed form that does not use its code."""

from __future__ import annotations

from dataclasses import fields

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from rosbags.highlevel import AnyReader
from scipy.interpolate import CubicSpline
from sim_runs import WEIGHT, D, G, K, Run

from coman_reduced_model.cli.main import run as coman
from coman_reduced_model.sim.contact import Floor
from coman_reduced_model.sim.describe import mujoco_spec, urdf
from coman_reduced_model.sim.disturbances import DISTURBANCES, make, parse
from coman_reduced_model.sim.disturbances.floor import _Landings
from coman_reduced_model.sim.robot_table import COMAN, ROBOTS
from coman_reduced_model.sim.spring_laws import SpringLaws
from coman_reduced_model.sim.virtual_robot import VirtualRobot


@pytest.fixture(scope="module")
def walked(walking) -> Run:
    """The first two steps; the left foot lifts at 1.2 s and lands at 1.7 s."""
    return Run(walking, 2.6)


# --- masses ---


def test_a_payload_weighs_and_moves_the_pressure(standing, still):
    run = Run(standing, 0.1, "payload:mass=1.5,x=0.05,y=0.02", settle=5.0)
    last = run.truths[-1]
    assert last.left_wrench[2] + last.right_wrench[2] == pytest.approx(18.8 * G, rel=1e-3)
    assert run.cop == pytest.approx(last.com[:2], abs=5e-4)
    trunk, plain = last.base_position, still.truths[-1].base_position
    moved = (last.com - trunk - (still.truths[-1].com - plain))[1]
    told = still.truths[-1].com[1] - plain[1]
    assert moved == pytest.approx(1.5 / 18.8 * (0.02 - told), abs=5e-4)


def test_a_shifted_trunk_shifts_the_pressure_by_its_share_of_the_weight(standing, still):
    run = Run(standing, 0.1, "com_offset:x=0.01", settle=5.0)
    assert run.cop == pytest.approx(run.truths[-1].com[:2], abs=3e-4)
    model = pin.buildModelFromXML(urdf(COMAN), pin.JointModelFreeFlyer())
    data = model.createData()
    q, last = pin.neutral(model), run.truths[-1]
    q[:3], q[3:7], q[7:] = last.base_position, last.base_orientation, last.q
    told = pin.centerOfMass(model, data, q)
    assert last.com[0] - told[0] == pytest.approx(0.01 * 5.5 / 17.3, rel=0.02)


def test_a_scattered_robot_is_the_same_one_each_time_and_a_few_percent_off():
    built = [VirtualRobot(COMAN, disturbances=[parse(f"scatter:seed={seed}")]) for seed in (1, 1, *range(2, 12))]
    assert np.array_equal(built[0].stiffness, built[1].stiffness)
    assert np.array_equal(built[0].model.body_ipos, built[1].model.body_ipos)
    for attribute, nominal, low, high in (("stiffness", K, 0.03, 0.05), ("damping", D, 0.03, 0.05)):
        ratio = np.array([getattr(robot, attribute) / nominal for robot in built[1:]])
        assert low < ratio.std() < high and np.abs(ratio - 1.0).max() <= 0.0801
    clean = VirtualRobot(COMAN).model
    ratio = np.array([robot.model.body_mass[1:] / clean.body_mass[1:] for robot in built[1:]])
    assert 0.02 < ratio.std() < 0.04
    shift = np.array([robot.model.body_ipos[1:] - clean.body_ipos[1:] for robot in built[1:]])
    assert 0.0015 < shift.std() < 0.0025


@pytest.mark.parametrize("table", ROBOTS.values(), ids=list(ROBOTS))
def test_every_effect_can_be_built_into_every_scattered_robot(table):
    for name, kind in DISTURBANCES.items():
        values = {"where": "left"} if "where" in {f.name for f in fields(kind)} else {}
        values |= {"sloshing_load": {"mass": 0.5}, "swinging_arms": {"mass": 0.2}}.get(name, {})
        for seed in range(3):
            VirtualRobot(table, disturbances=[parse(f"scatter:seed={seed}"), make(name, values)])


# --- floor ---


def test_a_soft_floor_sinks_by_compliance_times_force(standing, still):
    run = Run(standing, 0.1, "ground_compliance:vertical=6e-6")
    for side in ("left", "right"):
        sunk = still.truth(f"T_{side}")[-1, 2, 3] - run.truth(f"T_{side}")[-1, 2, 3]
        assert sunk == pytest.approx(
            6e-6 * run.truth(f"{side}_wrench")[-1, 2], abs=7e-5
        )  # the contact itself sinks by 0.05 mm
    assert run.truths[-1].left_wrench[2] + run.truths[-1].right_wrench[2] == pytest.approx(WEIGHT, rel=1e-3)


def test_a_soft_floor_lets_feet_turn_by_compliance_times_moment(standing):
    run = Run(standing, 0.1, "ground_compliance:rotational=4e-4+com_offset:x=0.02")
    last = run.truths[-1]
    turned = pin.rpy.matrixToRpy(last.T_left[:3, :3])
    assert turned[1] == pytest.approx(-4e-4 * last.left_wrench[4], rel=0.05)
    assert abs(turned[1]) > 4e-4


@pytest.mark.parametrize(("place", "roll", "pitch"), [("pitch", 0.0, 0.02), ("roll", 0.02, 0.0)])
def test_a_slope_moves_the_pressure_by_height_times_its_angle(standing, place, roll, pitch):
    run = Run(standing, 0.1, f"ground_slope:{place}=0.02", settle=5.0)
    last = run.truths[-1]
    down = np.tan([pitch, -roll])
    assert run.cop == pytest.approx(last.com[:2] + last.com[2] * down, abs=5e-4)
    told = pin.rpy.matrixToRpy(pin.Quaternion(run.readings[-1].imu.orientation).matrix())
    floor = pin.rpy.matrixToRpy(pin.Quaternion(last.base_orientation).matrix())
    assert (told - floor)[:2] == pytest.approx([roll, pitch], abs=1e-3)
    # The accelerometer agrees with the orientation that the IMU tells: gravity's reaction is up.
    reading = run.readings[-1].imu
    up = pin.Quaternion(reading.orientation).matrix() @ reading.linear_acceleration
    assert up == pytest.approx([0.0, 0.0, G], abs=0.02)


def test_a_pull_moves_the_pressure_by_height_times_force_over_weight(standing):
    run = Run(standing, 0.1, "external_force:x=5,y=-3", settle=5.0)
    last, height = run.truths[-1], 0.0
    trunk = run.robot.data.xipos[run.robot.model.body("base_link").id]
    height = trunk[2]
    assert run.cop == pytest.approx(last.com[:2] + height * np.array([5.0, -3.0]) / WEIGHT, abs=5e-4)
    world = last.T_left[:3, :3] @ last.left_wrench[:3] + last.T_right[:3, :3] @ last.right_wrench[:3]
    assert world == pytest.approx([-5.0, 3.0, WEIGHT], abs=0.1)


def test_a_slipping_foot_goes_back_by_the_distance_and_only_then(walking, walked):
    run = Run(walking, 2.6, "foot_slip:where=left,distance=0.006")
    t, x = run.truth("t"), run.truth("T_left")[:, 0, 3]
    landed = np.searchsorted(t, 1.66), np.searchsorted(t, 1.98)
    plain = walked.truth("T_left")[:, 0, 3]
    slid = (x[landed[1]] - x[landed[0]]) - (plain[landed[1]] - plain[landed[0]])
    assert slid == pytest.approx(-0.006, abs=0.0006)
    assert x[t < 1.0] == pytest.approx(plain[t < 1.0], abs=2e-4)
    right = np.ptp(run.truth("T_right")[:, 0, 3][t < 1.85])
    assert right < 0.001


def test_a_hard_landing_brings_its_impulse_through_the_foot(walking):
    """Momentum: the floor's extra vertical impulse is that of the COM, and near what was asked for."""
    run, plain = (Run(walking, 1.75, hide, rate_hz=1000.0) for hide in ("touchdown_impact:impulse=0.7", ""))
    t = run.truth("t")
    extra = sum(run.truth(f"{s}_wrench")[:, 2] - plain.truth(f"{s}_wrench")[:, 2] for s in ("left", "right"))
    impulse = np.cumsum(extra) * 0.001
    gained = 17.3 * (run.truth("com_vel") - plain.truth("com_vel"))[:, 2]
    assert impulse == pytest.approx(gained, abs=0.08)
    assert 0.35 < gained.max() < 0.75  # 0.7, less what the springs take back during the blow
    before = t < 1.6
    assert np.array_equal(run.truth("q")[before], plain.truth("q")[before])
    assert run.truth("left_wrench")[t > 1.6, 2].max() > 80.0 > plain.truth("left_wrench")[t > 1.6, 2].max()


# --- sensors: the physics does not change, what is told does ---


@pytest.mark.slow
@pytest.mark.parametrize(
    "hide",
    [
        "encoder_bias:where=LKneeSag,bias=0.02",
        "encoder_delay:delay=0.0125",
        "wrench_delay:delay=0.0125",
        "wrench_scale:where=left,scale=1.1",
        "wrench_bias:where=right,fz=12,tx=0.7",
        "eccentric_encoder:where=LKneeSag,amplitude=0.02,per_turn=8,phase=0.3",
        "sensor_rotation:where=left,axis=z,angle=0.2",
    ],
)
def test_what_sensors_err_by(walking, walked, hide):
    run = Run(walking, 2.6, hide)
    assert np.array_equal(run.truth("q"), walked.truth("q"))
    t, q, left = run.truth("t"), run.truth("q"), run.truth("left_wrench")
    joint = q.copy()
    wrench = {"left": left, "right": run.truth("right_wrench")}
    if hide.startswith("encoder_bias"):
        joint[:, 3] += 0.02
    elif hide.startswith("eccentric"):
        joint[:, 3] += 0.02 * np.sin(8 * q[:, 3] + 0.3)
    elif hide.startswith("encoder_delay"):
        joint = CubicSpline(t, q)(t - 0.0125)
    elif hide.startswith("wrench_delay"):
        wrench = {
            side: np.array([np.interp(t - 0.0125, t, column) for column in value.T]).T for side, value in wrench.items()
        }
    elif hide.startswith("wrench_scale"):
        wrench["left"] = 1.1 * left
    elif hide.startswith("wrench_bias"):
        wrench["right"] = wrench["right"] + [0, 0, 12.0, 0.7, 0, 0]
    else:
        c, s = np.cos(0.2), np.sin(0.2)
        turn = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        wrench["left"] = np.hstack([left[:, :3] @ turn.T, left[:, 3:] @ turn.T])
    late = t > 0.1
    assert run.positions()[late] == pytest.approx(joint[late], abs=1e-4)
    for side, value in wrench.items():
        assert run.wrench(side)[late] == pytest.approx(value[late], abs=1e-9)
    stamps = [[r.joint_states.stamp_ns for r in x.readings] for x in (run, walked)]
    assert stamps[0] == stamps[1]


def test_a_sensor_turned_about_x_turns_at_the_sensor(standing):
    run = Run(standing, 0.05, "sensor_rotation:where=right,axis=x,angle=0.1", wrench_frame="sensor")
    last, true = run.readings[-1].right_wrench, Run(standing, 0.05, wrench_frame="sensor").readings[-1].right_wrench
    turn = pin.rpy.rpyToMatrix(0.1, 0.0, 0.0).T
    assert last.force == pytest.approx(turn @ true.force, abs=1e-9)
    assert last.torque == pytest.approx(turn @ true.torque, abs=1e-9)


# --- outside the catalogue ---


def test_what_sloshes_weighs_nothing_more_and_swings_at_its_frequency(standing, still):
    run = Run(standing, 0.1, "sloshing_load:mass=1.5,frequency=1.5", settle=5.0)
    assert run.truths[-1].left_wrench[2] + run.truths[-1].right_wrench[2] == pytest.approx(WEIGHT, rel=2e-3)
    assert run.truths[-1].com == pytest.approx(still.truths[-1].com, abs=0.001)
    model, data = run.robot.model, run.robot.data
    load = model.body("sloshing_load")
    joint = int(load.jntadr[0])
    assert np.sqrt(model.jnt_stiffness[joint] / load.mass[0]) == pytest.approx(2 * np.pi * 1.5)
    assert np.abs(data.qpos[model.jnt_qposadr[joint]]) < 0.01


def test_arms_swing_as_told_and_the_robot_feels_it(walking, walked):
    run = Run(walking, 2.6, "swinging_arms:mass=0.8,amplitude=0.5,frequency=0.7,phase=0")
    angle = run.robot.data.qpos[run.robot.model.joint("left_arm").qposadr[0]]
    assert angle == pytest.approx(0.5 * np.sin(2 * np.pi * 0.7 * 2.6), abs=0.08)
    assert np.abs(run.truth("com") - walked.truth("com"))[:, 0].max() > 0.002


def test_a_push_is_in_the_floors_force(standing):
    """Slow enough, the feet hold against it as against a constant pull."""
    run = Run(standing, 3.0, "periodic_push:amplitude=5,frequency=0.2,direction=0,phase=0", settle=4.0)
    force = sum(
        np.einsum("nij,nj->ni", run.truth(f"T_{s}")[:, :3, :3], run.truth(f"{s}_wrench")[:, :3])
        for s in ("left", "right")
    )[:, 0]
    assert force == pytest.approx(-5 * np.sin(2 * np.pi * 0.2 * run.truth("t")), abs=0.8)


# --- together, later, and what is refused ---


@pytest.mark.slow
@pytest.mark.parametrize("hide", ["encoder_bias:where=LKneeSag,bias=0.02", "backlash:where=LKneeSag,width=0.02",
                                  "external_force:x=5", "transport_delay:delay=0.02"])  # fmt: skip
def test_an_effect_can_begin_in_mid_walk(walking, walked, hide):
    run = Run(walking, 2.6, f"{hide},after=1.5")
    t = run.truth("t")
    changed = np.abs(run.positions() - walked.positions()).max(axis=1)
    assert changed[t < 1.5].max() == 0.0
    assert changed[(t > 1.55) & (t < 2.0)].max() > 1e-3


@pytest.mark.parametrize("form", ["", ",form=ramp"])
def test_what_drifts_from_mid_walk_on_begins_with_nothing(form):
    model, bent, still, springs = mujoco_spec(COMAN).compile(), np.full(12, 0.02), np.zeros(12), []
    for begins in ("", ",after=10"):
        effect = parse(f"stiffness_drift:where=LKneeSag,change=-0.3,time=4{form}{begins}")
        effect.start(COMAN, model, np.random.default_rng(0))
        springs.append(SpringLaws.of(effect.spring_laws(), 12))
    always, later = springs
    for t in (0.0, 1.0, 6.0):
        assert later.torque(10.0 + t, bent, still) == pytest.approx(always.torque(t, bent, still))
    assert not later.torque(9.9, bent, still).any()


def test_a_zero_that_drifts_from_mid_walk_on_begins_with_nothing(walking, walked):
    run = Run(walking, 2.6, "thermal_drift:where=LKneeSag,rate=0.02,after=1.5")
    t, moved = run.truth("t"), np.abs(run.positions() - walked.positions()).max(axis=1)
    assert moved[t >= 1.5] == pytest.approx(0.02 * (t[t >= 1.5] - 1.5), abs=1e-4)


@pytest.mark.parametrize(("floor", "top"), [(Floor(kerb=0.03), 0.03), (Floor(platform=0.03), 0.03), (Floor(), 0.0),
                                            (Floor(tile_height=0.004), 0.0)])  # fmt: skip
def test_a_foot_lands_on_the_floor_below_it(floor, top):
    model = mujoco_spec(COMAN, floor=floor).compile()
    data, landings = mujoco.MjData(model), _Landings(model, "left")
    sole = model.site("l_sole").id
    for t, height in enumerate((0.0, 0.03, 0.0005, 0.0005)):
        data.site_xpos[sole] = [0.5, 0.1, top + height]
        ((_, since),) = landings(float(t), data)
    assert since == 1.0


def test_two_effects_of_the_floor_share_one_plate(walking):
    run = Run(walking, 2.2, "ground_compliance:vertical=3e-6+foot_slip:where=left,distance=0.005")
    assert not run.robot.fallen
    total = run.truth("left_wrench")[:, 2] + run.truth("right_wrench")[:, 2]
    assert total[run.truth("t") < 0.8] == pytest.approx(WEIGHT, rel=0.01)


@pytest.mark.parametrize("name", DISTURBANCES)
def test_every_effect_is_nothing_at_its_nominal(name, standing, still):
    parameters = {f.name for f in fields(DISTURBANCES[name])}
    nominal = {"scatter": "spring=0,mass=0,com=0", "payload": "mass=0", "imperfections": "amount=0"}
    zero = f"{name}:{nominal[name]}" if name in nominal else name
    if "where" in parameters:
        zero += ":where=left"
    run = Run(standing, 0.05, zero)
    plate = name in ("ground_compliance", "foot_slip")  # another body on the floor: the same within microns
    assert run.truths[-1].q == pytest.approx(still.truths[9].q, abs=3e-4 if plate else 1e-9)
    assert run.wrench("left")[-1] == pytest.approx(still.wrench("left")[9], abs=3.0 if plate else 1e-6)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("backlsh:width=0.01", "did you mean 'backlash'"),
        ("backlash:size=0.01", "size: unknown parameter .allowed: where, width"),
        ("backlash:width=wide", "width: 'wide' is not a number"),
        ("backlash:width=-1", "out of range"),
        ("backlash:width", "NAME:KEY=VALUE"),
        ("backlash:width=0.1,width=0.2", "each key once"),
        ("backlash:where=Knee,width=0.01", "where = 'Knee': allowed: left, right, HipSag"),
        ("wrench_scale:where=LKneeSag,scale=2", "where = 'LKneeSag': allowed: left, right"),
        ("sloshing_load:mass=9", "kg of its"),
        ("payload:mass=1,after=3", "payload: after: it is built into the robot"),
        ("motor_compliance:compliance=0.001,after=3", "after: it is built into the robot"),
        ("backlash:width=0.1,after=soon", "after = 'soon': allowed: seconds"),
        ("payload", "payload: nothing is hidden without a parameter .allowed: mass, x, y, z."),
        ("encoder_bias:where=LKneeSag,after=2", "nothing is hidden without a parameter"),
        ("sensor_rotation:axis=w", "allowed: 'x', 'y', 'z'"),
    ],
)
def test_what_cannot_be_hidden_is_refused_in_one_line(tmp_path, capsys, text, words):
    import re

    code = coman(["record", "--gait", "stand", "--duration", "1", "--out", str(tmp_path / "bag"), "--hide", text])
    said = capsys.readouterr().err.strip()
    assert code == 2 and "\n" not in said and re.search(words, said), said
    assert not any(tmp_path.iterdir())


def test_a_recorded_hidden_effect_leaves_no_trace_in_words(tmp_path):
    bag = tmp_path / "bag"
    arguments = ["--hide", "wrench_scale:where=left,scale=1.2", "--scatter", "3", "--motor-states", "commanded"]
    assert coman(["record", "--gait", "stand", "--duration", "1", "--out", str(bag), *arguments]) == 0
    for path in bag.iterdir():
        assert not any(word in path.read_bytes() for word in (b"wrench_scale", b"scatter", b"commanded"))
    with AnyReader([bag]) as reader:
        description = [c for c in reader.connections if c.topic == "/robot_description"]
        connection, _, raw = next(reader.messages(description))
        assert reader.deserialize(raw, connection.msgtype).data == urdf(COMAN)
