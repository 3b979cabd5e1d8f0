# SPDX-License-Identifier: BSD-3-Clause
"""Ground that is not level: who knows it, closed forms of a robot that stands on it, and short walks."""

from __future__ import annotations

from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from coman_reduced_model import Config, Predictor, Session
from coman_reduced_model.core.base.pose import LEVEL
from coman_reduced_model.core.base.types import Flags, Foot, ImuMessage, Phase, Reference, Sample, SupportState
from coman_reduced_model.core.effects.hooks import Now
from coman_reduced_model.core.measured.odometry import FootOdometry
from coman_reduced_model.core.measured.slope import Slope
from coman_reduced_model.core.measured.standing import StandingSoles
from coman_reduced_model.core.robot.robot import Posture, Robot
from coman_reduced_model.resources import config_path
from coman_reduced_model.sim.contact import Floor
from coman_reduced_model.sim.worlds import record_world
from coman_reduced_model.sim.worlds.draw import draw_world, plain_kinds, world_of
from coman_reduced_model.sim.worlds.world import World

MS = 1_000_000
STILL = np.zeros(12)
BENT = np.array([-0.4, 0.0, 0.0, 0.8, -0.4, 0.0] * 2)
PITCH = np.radians(10.0)
DOWN = Rotation.from_euler("y", PITCH).inv().apply([0.0, 0.0, -1.0])  # in the floor's axes, downhill ahead


@cache
def robot() -> Robot:
    return Robot(config_path("coman.urdf").read_text(encoding="utf-8"), Config().robot)


def posture(q: np.ndarray = BENT) -> Posture:
    found = robot().posture()
    found.update(q, STILL)
    return found


def imu(stamp: int, pitch: float) -> ImuMessage:
    """Of a level trunk on a floor with that pitch: the trunk leans with the floor."""
    return ImuMessage(stamp, "imu_link", Rotation.from_euler("y", pitch).as_quat(), np.zeros(3), np.zeros(3))


def looked(slope: Slope, seconds: float = 3.0, **fields) -> Slope:
    for k in range(round(seconds / 0.02)):
        stamp = 10**9 + 20 * MS * k
        values = {key: make(stamp) if callable(make) else make for key, make in fields.items()}
        slope.update(Sample(stamp, BENT, STILL, **values), posture(), Foot.LEFT, np.eye(4))
    return slope


def test_the_imu_knows_a_slope():
    slope = looked(Slope(robot()), imu=lambda stamp: imu(stamp, PITCH))
    np.testing.assert_allclose(slope.down, DOWN, atol=1e-6)
    ground = slope.known()
    assert ground.source == "imu" and not ground.doubtful
    assert (ground.roll, ground.pitch) == pytest.approx((0.0, PITCH), abs=1e-6)


def test_an_imu_that_is_a_degree_off_makes_no_slope():
    slope = looked(Slope(robot()), imu=lambda stamp: imu(stamp, np.radians(1.0)))
    assert slope.down is LEVEL and slope.known().pitch == 0.0


def test_a_short_gap_of_the_imu_forgets_no_slope():
    """The plan is level: `odom` of a plan that knows nothing of the slope."""
    zero, level = np.zeros(3), np.eye(4)
    plan = Reference(10**9, zero, zero, zero, zero, level, level, Phase.DOUBLE, 0)

    def seen(seconds: float, gap: float) -> Slope:
        slope = Slope(robot())
        begin, end = 10**9 + round(1e9 * (seconds - gap)), 10**9 + round(1e9 * seconds)
        return looked(slope, seconds, imu=lambda at: None if begin <= at < end else imu(at, PITCH), reference=plan)

    for gap in (0.1, 1.0):
        np.testing.assert_allclose(seen(4.0, gap).down, DOWN, atol=1e-6)
    assert seen(6.0, 3.0).known().source == "plan" and seen(6.0, 3.0).down is LEVEL


def test_without_an_imu_the_plan_knows_it():
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("y", PITCH).as_matrix()
    zero = np.zeros(3)
    plan = Reference(10**9, zero, zero, zero, zero, T, T, Phase.DOUBLE, 0)
    slope = looked(Slope(robot()), reference=plan)
    np.testing.assert_allclose(slope.down, DOWN, atol=1e-6)
    assert slope.known().source == "plan"


@pytest.mark.parametrize(("along", "doubtful"), [(0.02, False), (np.tan(PITCH), True)])
def test_forces_along_the_soles_are_believed_rather_than_a_plan_that_is_level(along, doubtful):
    zero, half = np.zeros(3), np.array([along * 85.0, 0.0, 85.0, 0.0, 0.0, 0.0])
    plan = Reference(10**9, zero, zero, zero, zero, np.eye(4), np.eye(4), Phase.DOUBLE, 0)
    slope = looked(Slope(robot()), left_wrench=half, right_wrench=half, reference=plan)
    assert slope.known().source == "plan" and slope.known().doubtful is doubtful and slope.doubted is doubtful


@pytest.mark.parametrize(("along", "doubtful"), [(0.02, False), (np.tan(PITCH), True)])
def test_where_nobody_knows_forces_along_the_soles_raise_a_doubt(along, doubtful):
    half = np.array([along * 85.0, 0.0, 85.0, 0.0, 0.0, 0.0])
    slope = looked(Slope(robot()), left_wrench=half, right_wrench=half)
    assert slope.known().source == "none" and slope.known().doubtful is doubtful
    assert slope.down is LEVEL


def standing_on(pitch: float, source: str) -> tuple[Predictor, list]:
    """Predictions of a robot whose links stand still where its springs hold it on that slope, both feet level with it.

    Closed form: the legs bear the weight in halves, so each joint is off its motor by J' f / k.
    """
    predictor = Predictor(robot(), Config().replaced({"model.slope": source, "prediction.horizons": []}))
    link, legs, weight = posture(), robot().legs, robot().mass * 9.81
    down = Rotation.from_euler("y", pitch).inv().apply([0.0, 0.0, -1.0])
    com, _ = link.com_in_sole(Foot.LEFT)
    middle = com[0] - com[2] * down[0] / down[2]  # where the line of weight meets the floor, ahead of the soles
    wrench = -0.5 * weight * np.concatenate((down, [0.0, -middle * down[2], 0.0]))
    motor = BENT.copy()
    stiffness = {Foot.LEFT: Config().robot.left.stiffness, Foot.RIGHT: Config().robot.right.stiffness}
    import pinocchio as pin

    q, data = pin.neutral(robot().model), robot().model.createData()
    robot().scatter(BENT, q)
    model = robot().model.copy()
    model.gravity.linear = 9.81 * link.R[Foot.LEFT] @ down
    needed = pin.rnea(model, data, q, np.zeros(model.nv), np.zeros(model.nv))
    for foot, leg in legs.items():
        J = pin.computeFrameJacobian(model, data, q, robot().sole_ids[foot], pin.ReferenceFrame.LOCAL)
        tau = (needed - J.T @ wrench)[robot().leg_columns[foot]]
        motor[leg] += tau / np.array(stiffness[foot])
    out = []
    for k in range(400):
        stamp = 10**9 + 5 * MS * k
        out.append(predictor.update(Sample(
            stamp, BENT.copy(), STILL.copy(), motor_q=motor.copy(), motor_qd=STILL.copy(), left_wrench=wrench.copy(),
            right_wrench=wrench.copy(), imu=imu(stamp, pitch),
        )))  # fmt: skip
    return predictor, out


def test_a_robot_that_stands_on_a_slope_stays_there():
    """Springs, weight and ground are in balance: the free run does not move. As on level ground, it sinks away."""
    _, known = standing_on(np.radians(6.0), "measured")
    assert np.abs(known[-1].residual).max() < 2e-4
    _, level = standing_on(np.radians(6.0), "level")
    assert np.abs(level[-1].residual).max() > 2e-3 or level[-1].flags.diverged


def test_weight_on_a_slope_is_no_external_force():
    weight = robot().mass * 9.81
    _, known = standing_on(PITCH, "measured")
    assert np.abs(known[-1].estimate.force).max() < 2e-3 * weight
    _, level = standing_on(PITCH, "level")
    assert abs(level[-1].estimate.force[0]) == pytest.approx(weight * np.sin(PITCH), rel=0.05)


def test_gravity_pulls_aslant_in_the_axes_of_the_sole():
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("z", 90.0, degrees=True).as_matrix()
    now = Now(*[None] * len(fields(Now)))
    now.T_odom_sole, now.down = T, DOWN
    np.testing.assert_allclose(now.aslant, [0.0, -DOWN[0], 1.0 + DOWN[2]], atol=1e-12)
    now.down = LEVEL
    assert now.aslant is None


def test_a_landing_shows_a_step_and_odom_goes_up_with_the_foot():
    q = BENT.copy()
    q[[0, 3, 4]] = -0.6, 1.2, -0.6  # the left leg is shorter: its sole stands higher
    link = posture(q)
    height = link.sole_pose(Foot.RIGHT, Foot.LEFT)[2, 3]
    assert height > 0.03
    soles = StandingSoles()
    soles.land(link, Foot.RIGHT)
    assert soles.planes()[Foot.RIGHT][0] == pytest.approx(height)
    assert soles.planes()[Foot.LEFT][0] == pytest.approx(-height)
    odometry, (R, p) = FootOdometry(), (link.R, link.p)
    both = (R[Foot.LEFT], p[Foot.LEFT], R[Foot.RIGHT], p[Foot.RIGHT])
    assert odometry.update(Foot.RIGHT, *both)[2, 3] == 0.0
    assert odometry.update(Foot.LEFT, *both)[2, 3] == pytest.approx(height)
    assert odometry.update(Foot.RIGHT, *both)[2, 3] == pytest.approx(0.0, abs=1e-12)


def test_a_foot_that_lands_on_its_heel_shows_the_ground_under_the_heel_and_a_level_landing_ends_the_step():
    q = BENT.copy()
    q[[0, 3, 4]] = -0.6, 1.2, -0.65  # toes up
    link = posture(q)
    R, p = link.sole_pose(Foot.RIGHT, Foot.LEFT)[:3, :3], link.sole_pose(Foot.RIGHT, Foot.LEFT)[:3, 3]
    back, _, right, _ = link.robot.soles[Foot.LEFT]
    heel = (R @ [back, right, 0.0] + p)[2]
    assert 0.03 < heel < p[2] - 0.003
    soles = StandingSoles()
    soles.land(link, Foot.RIGHT)
    assert soles.planes()[Foot.RIGHT][0] == pytest.approx(heel) == -soles.planes()[Foot.LEFT][0]
    soles.land(posture(), Foot.LEFT)
    assert not any(plane.any() for plane in soles.planes().values())


def test_a_foot_that_brushes_the_ground_aslant_shows_no_step():
    q = BENT.copy()
    q[[0, 3, 4]] = -0.6, 1.2, -0.6
    q[5] += 0.3  # ankle roll
    soles, stepping = StandingSoles(), SupportState(Phase.LEFT, Foot.LEFT, 1.0, 0.3, 170.0, 0.3)
    soles.land(posture(q), Foot.RIGHT)
    assert soles.aslant and soles.aslant_landings == 0, "it begins like that"
    soles.update(posture(), stepping, 0.005)
    soles.land(posture(q), Foot.RIGHT)
    assert not any(plane.any() for plane in soles.planes().values())
    assert soles.aslant and soles.aslant_landings == 1
    soles.reset()
    soles.land(posture(q), Foot.RIGHT)  # the same landing
    assert soles.aslant_landings == 1
    soles.update(posture(), stepping, 0.005)
    soles.land(posture(), Foot.RIGHT)
    assert not soles.aslant and soles.aslant_landings == 1


def test_predictions_after_an_aslant_landing_say_that_the_ground_is_not_known():
    """Until the next landing with parallel soles."""
    predictor, weight = Predictor(robot(), Config().replaced({"prediction.horizons": []})), robot().mass * 9.81
    aslant = BENT.copy()
    aslant[11] += 0.3  # ankle roll
    # Both feet, left, both with the right one aslant, left again, both.
    course = [(BENT, 0.5), (BENT, 1.0), (aslant, 0.5), (BENT, 1.0), (BENT, 0.5)]
    flags = []
    for k, (q, share) in enumerate(each for each in course for _ in range(40)):
        left, right = (np.array([0.0, 0.0, part * weight, 0.0, 0.0, 0.0]) for part in (share, 1.0 - share))
        sample = Sample(10**9 + 5 * MS * k, q.copy(), STILL.copy(), motor_q=q.copy(), motor_qd=STILL.copy())
        flags.append(predictor.update(replace(sample, left_wrench=left, right_wrench=right)).flags)
    unknown = [bool(each & Flags.UNKNOWN_GROUND) for each in flags]
    assert unknown == [False] * 80 + [True] * 80 + [False] * 40
    assert predictor.dynamics.aslant_landings == 1


def rms(bag, warned: bool = False, **changes) -> np.ndarray:
    with Session(bag, Config().replaced({"prediction.horizons": [], **changes})) as session:
        predictions = list(session.predictions())
        assert warned or not session.warnings
    assert not any(p.flags & (Flags.UNKNOWN_GROUND | Flags.REJECTED_STATE) for p in predictions)
    return np.sqrt(np.nanmean([p.residual**2 for p in predictions if not p.flags.diverged], axis=0))


@pytest.mark.slow
@pytest.mark.parametrize("floor", [Floor(pitch=-0.1), Floor(kerb=0.05)])
def test_a_short_walk(tmp_path, floor):
    """On a slope that the IMU knows, and on a kerb that the left foot stands on."""
    world = World(floor=floor, duration_s=5.0, tolerances=False)
    assert record_world(world, tmp_path / "walk", seed=1).fallen_s is None
    error = rms(tmp_path / "walk")
    assert (error < [5e-4, 6e-4, 2.5e-4]).all()
    if floor.pitch:
        assert rms(tmp_path / "walk", **{"model.slope": "level"})[0] > 5.0 * error[0]


@pytest.mark.slow
def test_a_robot_steps_up_and_down(tmp_path):
    """By 2 cm, on strides that are longer than its soles; its feet come down where the plan has them."""
    strides = {"step_length_m": 0.12, "step_height_m": 0.06}
    floor = Floor(platform=0.02)
    world = World(floor=floor, gait="test2", gait_changes=strides, duration_s=8.0, tolerances=False)
    result = record_world(world, tmp_path / "walk", seed=1)
    assert result.fallen_s is None
    with np.load(result.truth) as truth:
        for foot, name in ((Foot.LEFT, "left"), (Foot.RIGHT, "right")):
            loaded = truth[f"{name}_wrench"][:, 2] > 150.0
            x, z = truth[f"T_{name}"][loaded][:, [0, 2], 3].T
            assert z.min() < 1e-3 and z.max() > 0.019
            np.testing.assert_allclose(z, [floor.height(foot, each) for each in x], atol=2e-3)
    # A foot that is down on the step before the others is taken for one in the air whose sensor has a zero.
    assert (rms(tmp_path / "walk", warned=True) < [1.2e-3, 4e-4, 3e-4]).all()


def test_kinds_that_are_named_alone_are_never_drawn():
    assert world_of("slope").floor.pitch and world_of("steps").floor.kerb
    drawn = {draw_world(seed).kinds["floor"] for seed in range(60)}
    assert drawn == {"level", "uneven"}
    assert draw_world(3, {**plain_kinds(), "floor": "steps"}).floor.kerb == 0.05
