# SPDX-License-Identifier: BSD-3-Clause
"""The predictor on a synthetic walk: rates, support changes, restarts, flags and sources of the reference."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from predictor_tools import CONFIG, ROBOT, T0, WEIGHT, column, in_odom, motor, run, sample
from robots import bent

from coman_reduced_model.core.base.types import Flags, Foot, Phase, Sample
from coman_reduced_model.core.evaluation.statistics import RunStatistics
from coman_reduced_model.core.predictor import Predictor


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"support.dwell_on": 0.012, "support.dwell_off": 0.012},
        {"model.lateral_compliance": "with", "model.shares": "measured"},
        {"model.double_support": "both_legs", "model.stiffness": "condensed"},
    ],
)
def test_the_rate_of_the_samples_does_not_matter(changes):
    """1000, 200 and 100 Hz within 2 % of the deflection, at the common stamps."""
    config = CONFIG.replaced({**changes, "prediction.reset_every_steps": 0, "prediction.horizons": []})
    fine = run(config, rate=1000.0)[::10]
    deflection = column(fine, "predicted_com") - column(fine, "reference_com")
    size = np.sqrt((deflection[20:] ** 2).mean(axis=0))
    assert size[[0, 2]].min() > 1e-4
    for rate in (200.0, 100.0):
        coarse = run(config, rate=rate)[:: round(rate / 100.0)]
        # A change is known one sample late at most: until then the two tell their states in different soles.
        same = [
            a.frame_id == b.frame_id and a.support.phase == b.support.phase for a, b in zip(fine, coarse, strict=True)
        ]
        assert np.mean(same) > 0.95
        error = (column(coarse, "predicted_com") - column(fine, "predicted_com"))[same]
        axes = [0, 1, 2] if "model.lateral_compliance" in changes else [0, 2]
        assert (np.sqrt((error**2).mean(axis=0)) < 0.02 * size)[axes].all()
        assert (np.abs(error).max(axis=0) < 0.1 * size)[axes].all()


def test_free_run_is_the_dense_integration_of_its_terms():
    """Standing on one leg with moving motors: m p'' = K (p_r - p) + D (p_r' - p') + m g."""
    from scipy.integrate import solve_ivp

    from coman_reduced_model.core.base.types import SupportState

    config = CONFIG.replaced({"prediction.horizons": []})
    still = [sample(i / 200.0, phase_time=0.4) for i in range(101)]
    predictor = Predictor(ROBOT, config)
    found = [predictor.update(s) for s in still]
    posture = ROBOT.posture()

    def motion(t, z):
        q, qd = motor(t)
        posture.update(q, qd)
        p_r, v_r = posture.com_in_sole(Foot.LEFT)
        terms = predictor.model.terms(posture, SupportState(Phase.LEFT, Foot.LEFT, 1.0), {Foot.LEFT: (p_r, v_r)}, False)
        p, v = np.array([z[0], p_r[1], z[1]]), np.array([z[2], v_r[1], z[3]])
        return np.concatenate((z[2:], np.linalg.solve(terms.M, terms.force - terms.K @ p - terms.D @ v)[[0, 2]]))

    start = np.concatenate((found[0].measured_com[[0, 2]], found[0].measured_com_vel[[0, 2]]))
    dense = solve_ivp(motion, (0.0, 0.5), start, rtol=1e-8, atol=1e-10, t_eval=np.arange(101) / 200.0).y.T
    np.testing.assert_allclose(column(found, "predicted_com")[:, [0, 2]], dense[:, :2], atol=2e-5)
    assert np.abs(column(found, "predicted_com") - column(found, "reference_com"))[:, 2].max() > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("source", ["motor", "none"])
def test_predicted_com_is_continuous_in_odom(source):
    """Without restarts nothing jumps when the support foot changes, whatever the feet do."""
    config = CONFIG.replaced({"prediction.reset_every_steps": 0, "prediction.reference": source,
                              "model.lateral_compliance": "with"})  # fmt: skip
    predictions = run(config, rate=1000.0)
    changes = [i for i in range(2, len(predictions)) if predictions[i].frame_id != predictions[i - 1].frame_id]
    assert len(changes) > 3
    path = np.array([in_odom(p) for p in predictions])
    speed = np.diff(path, axis=0) * 1000.0
    jumps = np.abs(np.diff(speed, axis=0)).max(axis=1)  # [m/s] from sample to sample
    restarted = np.array([bool(p.flags.invalid) for p in predictions])  # the pendulum of no walk topples
    jumps = jumps[~(restarted[:-2] | restarted[1:-1] | restarted[2:])]
    # 0.5 mm within a millisecond; the legs of this walk disagree by centimetres and pull hard when they take over.
    assert len(jumps) > 2900 and jumps.max() < 0.5
    i = changes[0]
    assert np.abs(predictions[i].predicted_com - predictions[i - 1].predicted_com).max() > 0.05  # but in the sole


def test_velocity_turns_with_the_frame():
    """Feet that point apart: in odom the velocity stays what it was when the support foot changes."""
    config = CONFIG.replaced({"prediction.reset_every_steps": 0, "prediction.reference": "none"})
    q, still, leaning = bent(ROBOT, 0.6), np.zeros(12), np.zeros(12)
    for i, name in enumerate(ROBOT.joint_names):
        q[i] += {"LHipYaw": 0.3, "RHipYaw": -0.3}.get(name, 0.0)
        leaning[i] = 0.3 if name[1:] == "AnkSag" else 0.0

    def make(t):  # it falls forwards from the first sample on, and changes its foot at 0.1 s
        return replace(sample(t), q=q, qd=still if t else leaning)

    predictions = run(config, end=0.15, rate=1000.0, make=make)
    (i,) = [i for i in range(2, 150) if predictions[i].frame_id != predictions[i - 1].frame_id]
    before, after = predictions[i - 1 : i + 1]
    velocity = [p.T_odom_sole[:3, :3] @ p.predicted_com_vel for p in (before, after)]
    assert np.linalg.norm(velocity[0]) > 0.05
    assert np.linalg.norm(before.predicted_com_vel - after.predicted_com_vel) > 0.02
    np.testing.assert_allclose(velocity[1], velocity[0], atol=0.005)


def test_the_leg_behind_and_the_leg_that_has_landed_have_their_own_shares():
    """In a double support first the leg after its single support carries more, then the one before its own."""
    alone = CONFIG.replaced({"prediction.blend": False})
    plain = run(alone, end=1.3)
    for key, times in (("share_z_after", (0.72, 0.81)), ("share_z_before", (0.815, 0.885))):
        other = run(alone.replaced({f"model.{key}": 0.9}), end=1.3)
        # The horizons start at the measured state: they show the terms of their own sample alone.
        ahead = [np.array([p.horizons[0].com[2] for p in run]) for run in (plain, other)]
        changed = np.flatnonzero(np.abs(ahead[0] - ahead[1]) > 1e-7) / 200.0
        changed = changed[changed > 0.5]  # the first double support comes from standing
        assert times[0] - 0.006 < changed.min() < times[0] + 0.006, (key, changed)
        assert times[1] - 0.011 < changed.max() < times[1] + 0.011, (key, changed)


def test_lateral_follows_the_reference_unless_integrated():
    plain = run(end=1.0)[5:]
    for p in plain:
        if not p.flags.invalid:
            assert p.predicted_com[1] == p.reference_com[1] and p.predicted_com_vel[1] == p.reference_com_vel[1]
    lateral = run(CONFIG.replaced({"model.lateral_compliance": "with"}), end=1.0)[5:]
    assert np.abs(column(lateral, "predicted_com") - column(lateral, "reference_com"))[:, 1].max() > 1e-5


# --- restarts ---


def resets(predictions):
    return [round((p.stamp_ns - T0) * 1e-9, 6) for p in predictions if Flags.RESET in p.flags]


@pytest.mark.parametrize("every", [0, 1, 2])
def test_free_run_restarts_at_touchdown_every_so_many_steps(every):
    touchdowns = [0.715, 1.415, 2.115, 2.815, 3.515]  # 7 % of the weight 14 ms after the first contact
    predictions = run(CONFIG.replaced({"prediction.reset_every_steps": every}), end=4.0)
    # At 0.015 s the other foot is down again so soon that it has made no step.
    assert resets(predictions) == [0.0, *(touchdowns[every - 1 :: every] if every else [])]
    for p in predictions:
        if Flags.RESET in p.flags:
            np.testing.assert_array_equal(p.predicted_com, p.measured_com)
            np.testing.assert_array_equal(p.predicted_com_vel, p.measured_com_vel)
            np.testing.assert_array_equal(p.residual, 0.0)


def test_a_gap_and_time_that_goes_back_restart_everything():
    predictor = Predictor(ROBOT, CONFIG)
    first = run(end=1.0, predictor=predictor)
    after_gap = [predictor.update(sample(1.3 + i / 200.0)) for i in range(100)]
    assert resets(after_gap)[0] == 1.3
    np.testing.assert_array_equal(after_gap[0].T_odom_sole, np.eye(4))
    again = run(end=1.0, predictor=predictor)
    for a, b in zip(first, again, strict=True):  # exactly as if it were new
        for name in ("predicted_com", "predicted_com_vel", "T_odom_sole", "measured_com"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
        assert a.flags == b.flags and a.support == b.support
    short = Predictor(ROBOT, CONFIG)
    run(end=0.5, predictor=short)
    assert not short.update(sample(0.5 + 0.18)).flags.invalid, "a short gap is bridged"


# --- what is missing ---


def test_no_motor_states_give_no_reference_and_no_zeros():
    predictor = Predictor(ROBOT, CONFIG)
    for i in range(50):
        p = predictor.update(sample(i / 200.0, motor_q=None))
        assert p.flags == Flags.NO_REFERENCE | Flags.NOT_INITIALISED
        for name in ("predicted_com", "predicted_com_vel", "reference_com", "reference_com_vel", "residual"):
            assert np.isnan(getattr(p, name)).all()
        assert p.horizons == []
        assert np.isfinite(p.measured_com).all()
    assert predictor.update(sample(0.25)).flags == Flags.RESET
    assert predictor.update(sample(0.255)).flags == Flags.OK


def test_stale_wrenches_hold_the_phase():
    predictor = Predictor(ROBOT, CONFIG)
    run(end=0.4, predictor=predictor)
    p = predictor.update(sample(0.405, left_wrench=None))
    assert p.flags == Flags.STALE_WRENCH and p.support.phase == Phase.LEFT and np.isfinite(p.predicted_com).all()
    assert np.isnan(p.support.left_share)
    blind = Predictor(ROBOT, CONFIG).update(sample(0.0, left_wrench=None, right_wrench=None))
    assert blind.flags == Flags.STALE_WRENCH | Flags.NO_SUPPORT | Flags.NOT_INITIALISED
    assert blind.frame_id == "" and np.isnan(blind.measured_com).all() and np.isnan(blind.T_odom_sole).all()


def test_one_lost_wrench_does_not_spoil_the_judgement():
    predictor = Predictor(ROBOT, CONFIG)
    for i in range(200):
        predictor.update(sample(i / 200.0, **({"left_wrench": None} if i == 50 else {})))
    for errors in predictor.judge.rmse().values():
        assert all(np.isfinite(errors[name]).all() for name in errors), errors


def test_flight_stops_the_prediction_and_landing_starts_it():
    air = np.zeros(6)
    predictor = Predictor(ROBOT, CONFIG)
    run(end=0.4, predictor=predictor)
    for i in range(20):
        p = predictor.update(sample(0.405 + i / 200.0, left_wrench=air, right_wrench=air))
    assert p.flags == Flags.NO_SUPPORT | Flags.NOT_INITIALISED and p.support.phase == Phase.FLIGHT
    assert np.isnan(p.predicted_com).all() and np.isfinite(p.measured_com).all()
    landing = predictor.update(sample(0.505))
    assert landing.flags == Flags.RESET
    np.testing.assert_array_equal(landing.predicted_com, landing.measured_com)


def test_straight_legs_are_flagged():
    straight = np.zeros(12)
    make = lambda t: replace(sample(t), motor_q=straight, motor_qd=straight, q=straight, qd=straight)  # noqa: E731
    predictions = run(end=0.5, make=make)
    assert all(Flags.NEAR_SINGULAR in p.flags for p in predictions)
    assert np.isfinite(column(predictions, "predicted_com")).all()
    assert not any(Flags.REJECTED_STATE in p.flags for p in predictions)


def test_a_free_run_that_diverges_is_restarted_and_told():
    """A spring that pushes away: flagged, and never more than half a metre off."""
    config = CONFIG.replaced({"prediction.reset_every_steps": 0, "prediction.reference": "none"})
    tipped = np.array([0.0, 0.0, WEIGHT, 0.0, 50.0, 0.0])
    make = lambda t: sample(t, phase_time=0.4, left_wrench=tipped, right_wrench=np.zeros(6))  # noqa: E731
    predictions = run(config, end=4.0, make=make)
    assert any(p.flags == Flags.RESET | Flags.REJECTED_STATE for p in predictions)
    assert np.abs(column(predictions, "residual")).max() < 0.5
    statistics = RunStatistics(0.25)
    for p in predictions:
        statistics.add(p)
    restarts = sum(p.flags.diverged for p in predictions)
    assert 0 < statistics.summary()["judged_samples"] == len(predictions) - restarts, "a restart predicts nothing"


def in_degrees(t: float) -> Sample:
    q, motor_q = (np.degrees(getattr(sample(t), name)) for name in ("q", "motor_q"))
    return sample(t, q=q, motor_q=motor_q)


@pytest.mark.parametrize("changes", [{"model.trunk_rotation": "with"}, {"model.c1": 8.0, "model.c2": 8.0}])
def test_whatever_the_encoders_say_no_prediction_is_beyond_physics(changes):
    """By positions in degrees the legs cross and the COM sinks below the soles; filters diverge as well."""
    config = CONFIG.replaced({"prediction.horizons": [0.1, 0.4], **changes})
    predictions = run(config, make=in_degrees)
    diverged = np.array([p.flags.diverged for p in predictions])
    assert diverged.any() and not diverged.all()
    residual = column(predictions, "residual")
    assert np.linalg.norm(residual, axis=1).max() < Predictor.DIVERGED
    tilt = column(predictions, "predicted_tilt") - column(predictions, "measured_tilt")
    assert not (np.abs(tilt) >= Predictor.TOPPLED).any()
    for p in predictions:
        for each in p.horizons:
            assert np.isfinite(each.com).all() or Flags.REJECTED_STATE in p.flags
            assert not (np.abs(each.com - p.measured_com) > 0.5 + np.linalg.norm(p.measured_com_vel) * 0.4 + 0.8).any()
