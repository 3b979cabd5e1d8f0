# SPDX-License-Identifier: BSD-3-Clause
"""The stride before as the motors' future: how long it is, and what predictions through it are worth."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from coman_reduced_model.bag.session import Session
from coman_reduced_model.core.base.stream_names import REFERENCE
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.evaluation.baselines import BASELINES
from coman_reduced_model.core.model.trunk.memory import STEP, Memory, find_lag, keep, mismatch
from coman_reduced_model.core.model.trunk.stride import follow, replanned
from coman_reduced_model.resources import bag_path
from coman_reduced_model.sim.record import record
from coman_reduced_model.sim.worlds import record_world
from coman_reduced_model.sim.worlds.draw import draw_world, plain_kinds


def memory(stamp, **columns):
    n, foot = len(stamp), np.ones(len(stamp), dtype=np.int64)
    empty = {name: np.zeros((n, 1)) for name in Memory._fields}
    wide = dict.fromkeys(("inverse", "by_impulse", "contact", "T_odom_sole"), np.zeros((n, 1, 1)))
    wide["planned_sole"] = np.tile(np.eye(3), (n, 1, 1))
    return Memory(**(empty | wide | {"stamp": stamp, "foot": foot, "double": foot > 1} | columns))


@pytest.mark.parametrize("seed", range(20))
def test_what_the_plan_has_changed_is_interpolated_between_its_points(seed):
    """Against numpy: plans that end, memories that end, samples at uneven times; no plan is no number."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 80))
    stamp = 10**18 + np.cumsum(rng.integers(5_000_000, 20_000_000, n))
    past = memory(stamp, plan=rng.standard_normal((n, 3)))
    com, preview, dt = (
        rng.standard_normal(3),
        rng.standard_normal((int(rng.integers(1, 30)), 3)),
        rng.uniform(0.01, 0.1),
    )
    then, moved = int(stamp[0] + rng.integers(0, stamp[-1] - stamp[0])), np.zeros((43, 3))
    largest = replanned(moved, com, preview, dt, np.eye(3), 1, then, past, n)
    t, ahead = np.arange(43) * STEP, np.vstack((com, preview))
    expected = np.column_stack([
        np.interp(t, np.arange(len(ahead)) * dt, ahead[:, axis])
        - np.interp(t, (stamp - then) * 1e-9, past.plan[:, axis]) for axis in range(3)
    ])  # fmt: skip
    np.testing.assert_allclose(moved, expected - expected[0], atol=1e-9)
    assert largest == pytest.approx(np.abs(moved).max())
    begin = int(stamp[0])
    past.plan[min(n - 1, 20)] = np.nan  # 0.4 s later at most
    assert replanned(moved, com, preview, dt, np.eye(3), 1, begin, past, n) == np.inf
    assert replanned(moved, com, preview, dt, np.eye(3), 2, begin, past, n) == np.inf, "never on that foot"


@pytest.mark.parametrize("yaw", [-1.0, 0.2, 3.0])
def test_a_plan_that_turns_repeats_itself(yaw):
    """The same course seen from two soles, the second turned; and a part of it that is new."""
    rng = np.random.default_rng(0)
    stamp = 10**18 + 10_000_000 * np.arange(60, dtype=np.int64)
    course, new = rng.standard_normal((60, 3)), rng.standard_normal((41, 3))
    before, now = (Rotation.from_euler("z", angle).as_matrix() for angle in (0.4, 0.4 + yaw))
    past = memory(stamp, plan=course @ before.T + 2.0, planned_sole=np.tile(before, (60, 1, 1)))
    plan, moved = (course[:41] + new) @ now.T - 1.0, np.zeros((40, 3))
    replanned(moved, plan[0], plan[1:], 0.01, now, 1, int(stamp[0]), past, 60)
    np.testing.assert_allclose(moved, (new - new[0])[:40], atol=1e-12)


@pytest.mark.parametrize("period", [0.9, 1.4, 1.8])
def test_the_stride_is_found_within_a_millisecond(period):
    """Motors that repeat themselves, sampled unevenly; the phases say the period only within 25 ms."""
    rng = np.random.default_rng(0)
    t = np.arange(600) * 0.005 + rng.uniform(-0.001, 0.001, 600)
    phases = rng.uniform(0.0, 6.0, 12)
    theta = 0.3 * np.sin(2.0 * np.pi * t[:, None] / period + phases) + 1e-4 * rng.standard_normal((600, 12))
    stamp = 10**18 + np.round(t * 1e9).astype(np.int64)
    past = memory(stamp, theta=theta)
    guesses = np.array([0.4e9, (period + 0.025) * 1e9, 1.13 * period * 1e9], dtype=np.int64)
    lag = find_lag(int(stamp[-1]), guesses, past, 600)
    assert lag * 1e-9 == pytest.approx(period, abs=1e-3)
    assert mismatch(int(stamp[-1]), lag, past, 600)[0] < 5e-3
    assert mismatch(int(stamp[-1]), lag + 100_000_000, past, 600)[0] > 0.05


def rmse_of(bag, plan=True):
    settings = Config().replaced({"prediction.horizons": [0.1, 0.2, 0.4]})
    with Session(bag, settings) as session:
        for stream, _, raw in session.messages():
            if plan or stream != REFERENCE:
                session.pipeline.feed(stream, raw, session.decoders[stream])
        session.pipeline.flush()
    return session.pipeline.judge.rmse()


@pytest.mark.slow
@pytest.mark.parametrize(("name", "plan"), [("test1", True), ("test2", True), ("test2", False)])
def test_two_tenths_of_a_second_ahead_it_beats_a_rigid_robot_whose_motors_are_known(name, plan):
    rmse = rmse_of(bag_path(name), plan)
    # Setting off and stopping included, where the model knows no more than they do; theirs starts from the estimate.
    for h, most in (("0.1", 0.75 if plan else 1.05), ("0.2", 0.7 if plan else 0.9)):
        assert rmse[h]["model"][0] < most * min(rmse[h][other][0] for other in ("clairvoyant", "lipm", "persistence"))
    assert not plan or rmse["0.4"]["model"][2] < 0.2 * rmse["0.4"]["clairvoyant"][2]


@pytest.mark.slow
def test_nothing_is_compiled_in_mid_walk():
    """Samples with a plan and without have arrays of one layout, that for which all is compiled at the beginning."""
    for plan in (True, False):
        rmse_of(bag_path("test2"), plan)
    assert len(keep.signatures) == len(follow.signatures) == 1


@pytest.mark.slow
def test_a_horizon_beyond_a_stride_leaves_the_others_to_it():
    settings = {"prediction.horizons": [0.1, 2.0], "model.lateral_compliance": "without"}
    with Session(bag_path("test2"), Config().replaced(settings)) as session:
        found = list(session.predictions())
    assert np.mean([each.repeating for each in found[len(found) // 2 :]]) > 0.5
    assert all(np.isfinite(each.horizons[1].com).all() for each in found if each.repeating)
    # And sideways it follows its plan, now and ahead, whatever is known of the future.
    assert {float(one.com[1]) for each in found for one in each.deflections} == {0.0}


@pytest.mark.slow
def test_strides_are_recognised_also_where_a_foot_brushes_the_ground(tmp_path):
    """Backwards, feet touch the ground in mid-swing: the phase changes more often than the robot steps."""
    with Session(record("backwards", tmp_path / "walk", duration_s=12.0).bag, Config()) as session:
        found = [(each.stamp_ns, each.support.phase, each.repeating) for each in session.predictions()]
    stamps, phases, repeating = (np.array(column) for column in zip(*found, strict=True))
    steady = (stamps - stamps[0] > 4.5e9) & (stamps - stamps[0] < 9e9)
    changes = np.count_nonzero(np.diff(phases[steady]))
    assert changes > 4.5 / 0.7 * 2 + 2, "nothing brushes the ground here: take another walk"
    assert repeating[steady].mean() > 0.95


@pytest.mark.slow
def test_it_beats_a_rigid_robot_whose_motors_are_known_while_it_turns(tmp_path):
    rmse = rmse_of(record("turn", tmp_path / "walk", duration_s=15.0).bag)
    for h in ("0.1", "0.2", "0.4"):
        assert rmse[h]["model"][0] < 0.8 * rmse[h]["clairvoyant"][0]
        assert rmse[h]["model"][1] < 0.9 * rmse[h]["clairvoyant"][1]


@pytest.mark.slow
def test_a_stabilised_robot_that_turns_is_predicted_without_a_plan(tmp_path):
    """Its controller moves the motors beside the plan, of which it says nothing: in steady strides, 0.2 s ahead."""
    kinds = {"controller": "imu_control", "streams": "no_reference", "gait": "turn"}
    world = replace(draw_world(0, plain_kinds() | kinds), duration_s=14.0)
    assert record_world(world, tmp_path / "walk").fallen_s is None
    with Session(tmp_path / "walk", Config().replaced({"prediction.horizons": [0.2]})) as session:
        first_ns = 0
        for prediction in session.predictions():
            first_ns = first_ns or prediction.stamp_ns
            if prediction.stamp_ns - first_ns < 6e9:
                session.pipeline.judge.count_from_now()
            if prediction.stamp_ns - first_ns > 11e9:  # before it stops
                break
        rmse = session.pipeline.judge.rmse()["0.2"]
    best = np.min([rmse[name] for name in BASELINES], axis=0)
    skill = 1.0 - rmse["published"] / best
    assert (skill > [0.6, 0.8, 0.6]).all(), skill


def test_stride_and_planned_steps_start_from_the_joints_and_anything_else_from_the_estimate():
    """A COM that is 5 mm off moves the prediction only where neither is known."""
    moved: dict[bool, list[float]] = {False: [], True: []}
    with Session(bag_path("test1"), Config()) as session:
        predictor = session.pipeline.predictor
        dynamics, ahead = predictor.dynamics, predictor.dynamics.ahead

        def twice(now, com, com_vel, plan, horizons):
            off = ahead(now, com + np.array([5e-3, 0.0, 0.0]), com_vel, plan, horizons)
            out = ahead(now, com, com_vel, plan, horizons)
            moved[dynamics.repeating or dynamics.stepping].append(np.abs(off - out).max())
            return out

        dynamics.ahead = twice
        for _ in session.predictions():
            if len(moved[True]) > 100:
                break
    assert max(moved[True]) == 0.0 and min(moved[False]) > 1e-6
