# SPDX-License-Identifier: BSD-3-Clause
"""The reference generator: what the nodes and the virtual robot rely on in a planned walk."""

from __future__ import annotations

import math
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.spatial import ConvexHull

from coman_reduced_model.core.base.types import Foot, Phase
from coman_reduced_model.core.gait.gait import PlanPoint, WalkPlan, plan_walk
from coman_reduced_model.core.gait.parameters import GAITS, GaitParameters, gait
from coman_reduced_model.errors import ComanError, ConfigError

SOLE = np.array([[0.13, 0.05], [0.13, -0.05], [-0.07, 0.05], [-0.07, -0.05]])  # [m] corners in the sole frame

gaits = st.builds(
    GaitParameters,
    step_length_m=st.floats(-0.1, 0.1),
    step_width_m=st.floats(0.1, 0.3),
    step_height_m=st.floats(0.0, 0.1),
    single_support_s=st.floats(0.2, 3.0),
    double_support_s=st.floats(0.05, 2.0),
    com_height_m=st.floats(0.2, 1.2),
    steps=st.integers(0, 20),
    turn_rad=st.floats(-0.3, 0.3),
    lateral_m=st.floats(-0.05, 0.05),
    stand_before_s=st.floats(0.7, 5.0),
    stand_after_s=st.floats(0.7, 5.0),
    zmp_offset_x_m=st.floats(-0.03, 0.05),
    zmp_offset_y_m=st.floats(-0.02, 0.03),
    first_swing=st.sampled_from(["left", "right"]),
)


def planned(p: GaitParameters) -> WalkPlan:
    """The plan, or another draw where the standing time does not allow one."""
    try:
        return plan_walk(p)
    except ConfigError as error:
        assume("too short" not in str(error))
        raise


def grid(plan: WalkPlan, n: int = 3001) -> np.ndarray:
    """Times from before the start to after the end."""
    return np.linspace(-0.5, plan.duration_s + 0.5, n)


def steps_of(plan: WalkPlan) -> PlanPoint:
    """The plan at every landing."""
    return plan.sample_many(np.array([step.t_land for step in plan.footsteps]))


# --- COM -------------------------------------------------------------------------------------------------------------


@given(gaits)
def test_com_follows_the_lipm_and_is_bounded(p):
    plan = planned(p)
    point = plan.sample_many(grid(plan))
    height = p.com_height_m
    residual = point.com[:, :2] - height / p.gravity * point.com_acc[:, :2] - point.zmp[:, :2]
    assert np.abs(residual).max() < 1e-9
    assert np.all(point.com[:, 2] == height) and not point.com_vel[:, 2].any() and not point.zmp[:, 2].any()
    # The bounded solution is a moving average of the ZMP, so it stays within the range of the ZMP.
    assert np.all(point.com[:, :2] >= point.zmp[:, :2].min(axis=0) - 1e-9)
    assert np.all(point.com[:, :2] <= point.zmp[:, :2].max(axis=0) + 1e-9)


@given(gaits)
def test_velocity_and_acceleration_are_the_derivatives_of_the_com(p):
    plan = planned(p)
    t = np.random.default_rng(0).uniform(0.0, plan.duration_s, 200)
    h = 1e-4  # [s]; the acceleration has kinks where the slope of the ZMP jumps
    before, now, after = (plan.sample_many(t + dt) for dt in (-h, 0.0, h))
    assert np.allclose((after.com - before.com) / (2 * h), now.com_vel, atol=2e-5)
    assert np.allclose((after.com_vel - before.com_vel) / (2 * h), now.com_acc, atol=1e-2)


@given(gaits)
def test_walk_starts_and_ends_at_rest_midway_between_the_feet(p):
    plan = planned(p)
    for t, outside in ((0.0, -3.0), (plan.duration_s, plan.duration_s + 3.0)):
        point, far = plan.sample(t), plan.sample(outside)
        middle = (point.T_odom_left + point.T_odom_right)[:2, 3] / 2
        ahead = point.T_odom_left[:2, 0] * p.zmp_offset_x_m
        assert np.allclose(point.com[:2], middle + ahead, atol=1e-10)
        assert np.abs(point.com_vel).max() < 1e-10 and np.abs(point.com_acc).max() < 1e-9
        for name in ("com", "com_vel", "com_acc", "zmp", "T_odom_left", "T_odom_right"):
            assert np.allclose(getattr(point, name), getattr(far, name), atol=1e-9), name
        assert point.phase == far.phase == Phase.DOUBLE


def test_com_agrees_with_numerical_integration():
    plan = plan_walk(GAITS["test2"])
    start, end = 3.0, 4.0  # the pendulum is unstable: an integration only follows it for a while
    omega2 = plan.parameters.omega**2

    def pendulum(t, state):
        return np.concatenate([state[2:], omega2 * (state[:2] - plan.sample(t).zmp[:2])])

    first, last = plan.sample(start), plan.sample(end)
    state = np.concatenate([first.com[:2], first.com_vel[:2]])
    solution = solve_ivp(pendulum, (start, end), state, rtol=1e-10, atol=1e-12, max_step=0.01)
    assert np.allclose(solution.y[:, -1], [*last.com[:2], *last.com_vel[:2]], atol=1e-7)


def test_walk_in_place_reaches_the_periodic_orbit_of_the_pendulum():
    # A step whose ZMP jumps at once (short double support) sways as p (1 - 1 / cosh(omega T / 2)).
    p = replace(GAITS["in_place"], double_support_s=0.02, steps=30)
    plan = plan_walk(p)
    step = plan.footsteps[15]
    middle = plan.sample((step.t_lift + step.t_land) / 2)
    period = p.single_support_s + p.double_support_s
    expected = p.step_width_m / 2 * (1.0 - 1.0 / math.cosh(p.omega * period / 2))
    assert abs(middle.com[1]) == pytest.approx(expected, rel=2e-3)
    assert abs(middle.com_vel[1]) < 1e-9  # it turns round in the middle of the step


@pytest.mark.parametrize("stand", [0.5, 10.0, 1e6])
def test_long_standing_neither_overflows_nor_drifts(stand):
    with np.errstate(all="raise", under="ignore"):
        plan = plan_walk(gait("test1", stand_before_s=stand, stand_after_s=stand))
        point = plan.sample_many(np.linspace(0.0, plan.duration_s, 1000))
    assert np.all(np.isfinite(point.com)) and np.abs(point.com[:, 1]).max() < 0.0726
    reference, shift = plan_walk(GAITS["test1"]), stand - 1.0
    assert np.allclose(plan.sample(5.0 + shift).com, reference.sample(5.0).com, atol=1e-4)


def test_ten_thousand_steps_can_be_planned():
    plan = plan_walk(gait("in_place", steps=10_000))
    late, early = plan.sample(1.2 + 9000 * 0.7), plan.sample(1.2 + 100 * 0.7)
    assert np.allclose(late.com, early.com, atol=1e-9)


# --- feet and phases -------------------------------------------------------------------------------------------------


@given(gaits)
def test_support_feet_stay_and_swing_feet_move_smoothly(p):
    plan = planned(p)
    t = grid(plan)
    point = plan.sample_many(t)
    for T, twist, swinging_in in (
        (point.T_odom_left, point.left_twist, Phase.RIGHT),
        (point.T_odom_right, point.right_twist, Phase.LEFT),
    ):
        still = point.phase != swinging_in
        together = still[1:] & still[:-1]
        assert not twist[still].any()
        assert not np.diff(T, axis=0)[together & (np.diff(point.step) == 0)].any()
        assert np.all(T[still, 2, 3] == 0.0) and np.all(T[:, 2, 3] >= -1e-12)
        assert np.all(T[:, 2, 2] == 1.0)  # flat
        assert np.allclose(T[:, :2, :2] @ T[:, :2, :2].swapaxes(1, 2), np.eye(2))
    h = 1e-5
    before, after = plan.sample_many(t - h), plan.sample_many(t + h)
    speed = (after.T_odom_left - before.T_odom_left)[:, :3, 3] / (2 * h)
    assert np.allclose(speed, point.left_twist[:, :3], atol=1e-4)


@pytest.mark.parametrize("name", [name for name in GAITS if name != "stand"])
def test_swing_leaves_and_lands_without_speed_and_acceleration(name):
    plan = plan_walk(GAITS[name])
    h = 1e-4
    for step in plan.footsteps:
        for t in (step.t_lift, step.t_land):
            points = plan.sample_many(t + np.array([-h, 0.0, h]))
            twist = points.left_twist if step.foot == Foot.LEFT else points.right_twist
            T = points.T_odom_left if step.foot == Foot.LEFT else points.T_odom_right
            assert np.abs(twist).max() < 1e-5 and np.abs(np.diff(twist, axis=0)).max() / h < 0.06
            assert np.abs(np.diff(T, axis=0)).max() < 1e-8
        middle = plan.sample((step.t_lift + step.t_land) / 2)
        T = middle.T_odom_left if step.foot == Foot.LEFT else middle.T_odom_right
        assert T[2, 3] == pytest.approx(plan.parameters.step_height_m)


@given(gaits)
def test_phases_last_as_long_as_they_should(p):
    plan = planned(p)
    assert plan.duration_s == pytest.approx(
        p.stand_before_s
        + p.stand_after_s
        + p.steps * (p.single_support_s + p.double_support_s)
        + (p.double_support_s if p.steps else 0.0)
    )
    assert len(plan.footsteps) == p.steps
    last = p.stand_before_s
    for i, step in enumerate(plan.footsteps):
        assert step.t_lift - last == pytest.approx(p.double_support_s)
        assert step.t_land - step.t_lift == pytest.approx(p.single_support_s)
        assert step.foot == (Foot.LEFT if (i % 2 == 0) == (p.first_swing == "left") else Foot.RIGHT)
        middle = plan.sample((step.t_lift + step.t_land) / 2)
        assert (middle.phase, middle.step) == (Phase(step.foot.other), i)
        transfer = plan.sample(step.t_lift - p.double_support_s / 2)
        assert (transfer.phase, transfer.step) == (Phase.DOUBLE, i - 1)
        last = step.t_land
    assert plan.sample(plan.duration_s).step == p.steps - 1


@pytest.mark.parametrize("name", list(GAITS))
def test_zmp_stays_within_the_soles_on_the_ground(name):
    plan = plan_walk(GAITS[name])
    switches = [0.0, *(t for step in plan.footsteps for t in (step.t_lift, step.t_land)), plan.duration_s]
    for begin, end in zip(switches[:-1], switches[1:], strict=True):
        point = plan.sample_many(np.linspace(begin, end, 200, endpoint=False))
        on_ground = {
            Phase.DOUBLE: (point.T_odom_left[0], point.T_odom_right[0]),
            Phase.LEFT: (point.T_odom_left[0],),
            Phase.RIGHT: (point.T_odom_right[0],),
        }[Phase(point.phase[0])]
        assert np.all(point.phase == point.phase[0])
        hull = ConvexHull(np.vstack([SOLE @ T[:2, :2].T + T[:2, 3] for T in on_ground]))
        distance = point.zmp[:, :2] @ hull.equations[:, :2].T + hull.equations[:, 2]
        assert distance.max() < -0.03  # [m] inside by 3 cm
        if len(on_ground) == 1:
            assert np.allclose(point.zmp, on_ground[0][:3, 3], atol=1e-12)


@pytest.mark.parametrize(("name", "length", "single"), [("test1", 0.03, 0.5), ("test2", 0.06, 0.6)])
def test_gaits_of_the_paper(name, length, single):
    plan = plan_walk(GAITS[name])
    assert len(plan.footsteps) == 14
    landed = steps_of(plan)
    left, right = landed.T_odom_left[:, :3, 3], landed.T_odom_right[:, :3, 3]
    ahead = np.where(np.arange(14) % 2 == 0, left[:, 0] - right[:, 0], right[:, 0] - left[:, 0])
    assert np.allclose(ahead[:-1], length) and ahead[-1] == pytest.approx(0.0, abs=1e-12)
    assert np.allclose(left[:, 1] - right[:, 1], 0.1452)
    assert {round(step.t_land - step.t_lift, 9) for step in plan.footsteps} == {single}
    lifts, lands = zip(*((step.t_lift, step.t_land) for step in plan.footsteps), strict=True)
    assert np.allclose(np.array(lifts[1:]) - lands[:-1], 0.2)


def test_backwards_is_the_mirror_of_forwards():
    t = np.linspace(0.0, 12.0, 500)
    forwards, backwards = (plan_walk(GAITS[name]).sample_many(t) for name in ("test1", "backwards"))
    assert np.allclose(backwards.com * [-1, 1, 1], forwards.com)
    assert np.allclose(backwards.T_odom_left[:, :3, 3] * [-1, 1, 1], forwards.T_odom_left[:, :3, 3])


def test_walking_in_place_stays():
    point = plan_walk(GAITS["in_place"]).sample_many(np.linspace(0.0, 12.0, 500))
    assert np.abs(point.com[:, 0]).max() < 1e-12 and np.abs(point.T_odom_left[:, 0, 3]).max() < 1e-12


@pytest.mark.parametrize("turn", [-0.2, 0.1])
def test_turning_accumulates_yaw_beyond_half_a_turn_and_keeps_the_feet_apart(turn):
    plan = plan_walk(GaitParameters(step_length_m=0.02, turn_rad=turn, steps=60))
    landed = steps_of(plan)
    yaw = np.unwrap(np.arctan2(landed.T_odom_left[:, 1, 0], landed.T_odom_left[:, 0, 0]))
    assert yaw[-1] == pytest.approx(59 * turn)
    # Along an arc: each foot advances in the direction halfway between its headings.
    lefts = landed.T_odom_left[:-1:2]
    heading, chord = lefts[:, :2, 0], np.diff(lefts[:, :2, 3], axis=0)
    across = np.cross(np.pad(heading[1:] + heading[:-1], ((0, 0), (0, 1))), np.pad(chord, ((0, 0), (0, 1))))[:, 2]
    assert np.abs(across).max() < 1e-12
    apart = np.linalg.norm((landed.T_odom_left - landed.T_odom_right)[:, :2, 3], axis=1)
    assert apart.min() > 0.13
    rate = plan.sample_many(np.linspace(0.0, plan.duration_s, 5000)).left_twist[:, 5]
    assert np.all(rate * np.sign(turn) >= 0.0)  # no swing turns the long way round


@pytest.mark.parametrize("lateral", [-0.02, 0.02])
def test_sideways_never_brings_the_feet_closer_than_the_step_width(lateral):
    plan = plan_walk(gait("sideways", lateral_m=lateral))
    landed = steps_of(plan)
    apart = landed.T_odom_left[:, 1, 3] - landed.T_odom_right[:, 1, 3]
    assert apart.min() > 0.1452 - 1e-12 and apart[-1] == pytest.approx(0.1452)
    assert plan.sample(plan.duration_s).com[1] == pytest.approx(14 * lateral, abs=2 * abs(lateral))


# --- where the walk starts -------------------------------------------------------------------------------------------


def pose(x: float, y: float, yaw: float, z: float = 0.0) -> np.ndarray:
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, 0.0, x], [s, c, 0.0, y], [0.0, 0.0, 1.0, z], [0.0, 0.0, 0.0, 1.0]])


@given(st.floats(-5, 5), st.floats(-5, 5), st.floats(-3.2, 3.2), st.floats(-1, 1), st.sampled_from(list(GAITS)))
@settings(max_examples=30)
def test_walk_is_the_same_wherever_it_starts(x, y, yaw, z, name):
    T = pose(x, y, yaw, z)
    here, there = plan_walk(GAITS[name], np.eye(4)), plan_walk(GAITS[name], T)
    t = grid(here, 200)
    a, b = here.sample_many(t), there.sample_many(t)
    assert np.allclose(T @ a.T_odom_right, b.T_odom_right, atol=1e-9)
    assert np.allclose(a.com @ T[:3, :3].T + T[:3, 3], b.com, atol=1e-9)
    assert np.allclose(a.com_acc @ T[:3, :3].T, b.com_acc, atol=1e-8)


def test_one_given_foot_places_the_other_and_two_are_kept():
    start = plan_walk(GAITS["test1"], T_odom_right=pose(1.0, 2.0, 0.0)).sample(0.0)
    assert np.allclose(start.T_odom_left, pose(1.0, 2.1452, 0.0))
    left, right = pose(0.0, 0.1, 3.1), pose(0.02, -0.1, -3.1)  # almost parallel, across the wrap of yaw
    plan = plan_walk(GAITS["test1"], left, right)
    assert np.allclose(plan.sample(0.0).T_odom_left, left) and np.allclose(plan.sample(0.0).T_odom_right, right)
    assert np.abs(plan.sample_many(grid(plan)).left_twist[:, 5]).max() < 1.0  # [rad/s]


@pytest.mark.parametrize("T", [np.full((4, 4), np.nan), np.eye(3), np.zeros((4, 4)), np.diag([1.0, -1.0, -1.0, 1.0])])
def test_a_pose_that_is_none_of_a_flat_foot_is_refused(T):
    with pytest.raises(ComanError, match="T_odom_right"):
        plan_walk(GAITS["test1"], T_odom_right=T)


# --- evaluation ------------------------------------------------------------------------------------------------------


@given(gaits, st.floats(-1.0, 60.0))
def test_sample_is_one_of_sample_many(p, t):
    plan = planned(p)
    one, many = plan.sample(t), plan.sample_many(np.array([0.0, t, 3.0]))
    for f in fields(PlanPoint):
        assert np.array_equal(getattr(one, f.name), getattr(many, f.name)[1]), f.name
    assert isinstance(one.phase, Phase) and isinstance(one.step, int)


def test_reference_carries_the_plan_and_its_preview():
    plan = plan_walk(GAITS["test2"])
    t, dt, n = 4.321, 0.02, 25
    reference, now = plan.reference(t, 123, dt, n), plan.sample(t)
    assert (reference.stamp_ns, reference.phase, reference.step) == (123, now.phase, now.step)
    for name in ("com", "com_vel", "com_acc", "zmp", "T_odom_left", "T_odom_right"):
        assert np.array_equal(getattr(reference, name), getattr(now, name)), name
    ahead = plan.sample_many(t + dt * np.arange(1, n + 1))
    assert reference.preview_dt == dt
    assert np.allclose(reference.preview_com, ahead.com) and np.allclose(reference.preview_com_vel, ahead.com_vel)
    none = plan.reference(t, 123)
    assert none.preview_dt == 0.0 and none.preview_com.shape == (0, 3)
    end = plan.reference(plan.duration_s - 0.1, 0, dt, n)  # the preview reaches beyond the plan
    assert np.allclose(end.preview_com[-1], plan.sample(plan.duration_s).com)


def test_another_com_replaces_that_of_the_plan_and_nothing_else():
    plan = plan_walk(GAITS["test1"])
    t = np.arange(0.0, plan.duration_s + 1e-9, 0.005)
    offset = 0.01 * np.sin(np.pi * t / plan.duration_s)[:, None] ** 2 * np.array([1.0, -1.0, 0.5])
    other = plan.with_com(t, plan.sample_many(t).com + offset)
    fine = np.linspace(0.0, plan.duration_s, 4001)
    a, b = plan.sample_many(fine), other.sample_many(fine)
    expected = 0.01 * np.sin(np.pi * fine / plan.duration_s)[:, None] ** 2 * np.array([1.0, -1.0, 0.5])
    assert np.allclose(b.com, a.com + expected, atol=1e-6)
    assert np.allclose(np.gradient(b.com, fine, axis=0)[1:-1], b.com_vel[1:-1], atol=1e-3)
    assert np.allclose(np.gradient(b.com_vel, fine, axis=0)[2:-2], b.com_acc[2:-2], atol=0.05)
    assert np.array_equal(a.zmp, b.zmp) and np.array_equal(a.T_odom_left, b.T_odom_left)
    assert np.array_equal(plan.sample_many(fine).com, a.com)  # the first plan is as it was
    after = other.sample(plan.duration_s + 1.0)
    assert np.allclose(after.com, b.com[-1]) and not after.com_vel.any() and not after.com_acc.any()
    assert np.allclose(
        other.reference(3.0, 0, 0.01, 3).preview_com, other.sample_many(3.0 + 0.01 * np.arange(1, 4)).com
    )


# --- bad input -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [f.name for f in fields(GaitParameters)])
@pytest.mark.parametrize("value", [float("nan"), float("inf"), -1e9, 1e9, "three", None, True, [1.0]])
def test_a_bad_value_is_refused_with_key_value_and_what_is_allowed(name, value):
    with pytest.raises(ConfigError) as error:
        gait("test1", **{name: value})
    message = str(error.value)
    assert name in message and "allowed" in message and "\n" not in message
    assert str(value) in message


def test_unknown_gait_or_key_is_refused():
    with pytest.raises(ConfigError, match="moonwalk.*test1"):
        gait("moonwalk")
    with pytest.raises(ConfigError, match="step_lenght_m.*step_length_m"):
        gait("test1", step_lenght_m=0.1)


@pytest.mark.parametrize("key", ["stand_before_s", "stand_after_s"])
def test_standing_too_short_to_start_or_stop_is_refused(key):
    with pytest.raises(ConfigError, match=key):
        plan_walk(gait("test2", **{key: 0.1}))


def test_whole_numbers_and_numpy_scalars_are_numbers():
    assert gait("test1", stand_before_s=2, step_length_m=np.float32(0.05)).stand_before_s == 2.0


def test_references_at_once_are_those_one_by_one():
    plan = plan_walk(gait("test1"))
    t = np.array([0.3, 2.2, 2.205, 99.0])
    for time, point in zip(t, plan.references(t, range(4), 0.02, 25), strict=True):
        alone = plan.reference(float(time), point.stamp_ns, 0.02, 25)
        assert (alone.phase, alone.step) == (point.phase, point.step)
        for name in ("com", "com_vel", "zmp", "T_odom_left", "preview_com", "preview_com_vel"):
            assert np.array_equal(getattr(alone, name), getattr(point, name))
