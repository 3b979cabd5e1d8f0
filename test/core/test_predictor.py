# SPDX-License-Identifier: BSD-3-Clause
"""The predictor on a synthetic walk: rates, support changes, restarts, flags and sources of the reference."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from robots import bent, robot_of

from coman_reduced_model.core.base.types import Flags, Foot, Phase, Reference, Sample
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.evaluation.statistics import RunStatistics
from coman_reduced_model.core.predictor import Predictor

ROBOT = robot_of("coman")
WEIGHT = 9.81 * ROBOT.mass
PERIOD = 1.4  # [s] double, left, double, right
# Phases change between two samples of 100 Hz, whatever the rate: no dwell.
CONFIG = Config().replaced({"model.trunk_rotation": "without", "support.dwell_on": 0.0, "support.dwell_off": 0.0})
T0 = 10**12


def loads(t: float) -> tuple[float, float]:
    """Shares of the weight: in double support the load passes over, then one leg carries all."""
    left = float(np.interp((t + 1e-9) % PERIOD, [0.0, 0.2, 0.7, 0.9], [0.0, 1.0, 1.0, 0.0]))
    return left, 1.0 - left


WAVES = np.random.default_rng(3).uniform(0.5, 1.0, (2, 12))
BENT = bent(ROBOT, 0.6, 0.03)


def motor(t: float) -> tuple[np.ndarray, np.ndarray]:
    """Smooth motion of all motors."""
    rate = 2.0 * np.pi * WAVES[0] / PERIOD
    return BENT + 0.03 * np.sin(rate * t + 6.0 * WAVES[1]), 0.03 * rate * np.cos(rate * t + 6.0 * WAVES[1])


def sample(t: float, phase_time: float | None = None, **changes) -> Sample:
    """What the sensors would tell; the link side sags a little behind the motors."""
    q, qd = motor(t)
    sag = 0.01 * np.cos(np.arange(12) + 3.0 * t)
    left, right = (
        np.array([0.0, 0.0, share * WEIGHT, 0.0, 0.0, 0.0]) for share in loads(t if phase_time is None else phase_time)
    )
    values = {"q": q + sag, "qd": qd - 0.03 * np.sin(np.arange(12) + 3.0 * t), "motor_q": q, "motor_qd": qd}
    values |= {"left_wrench": left, "right_wrench": right}
    return Sample(T0 + round(t * 1e9), **{**values, **changes})


def run(config: Config = CONFIG, end: float = 3.0, rate: float = 200.0, make=sample, predictor=None):
    predictor = predictor or Predictor(ROBOT, config)
    return [predictor.update(make(i / rate)) for i in range(round(end * rate) + 1)]


def column(predictions, name):
    return np.array([getattr(p, name) for p in predictions])


def in_odom(prediction, name="predicted_com"):
    T = prediction.T_odom_sole
    return T[:3, :3] @ getattr(prediction, name) + T[:3, 3]


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
    restarted = np.array([bool(p.flags) for p in predictions])  # the pendulum of no walk topples
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
        if not p.flags:
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
    assert resets(predictions) == [0.0, *([0.015, *touchdowns][every - 1 :: every] if every else [])]
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
    assert not short.update(sample(0.5 + 0.18)).flags, "a short gap is bridged"


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


# --- sources of the reference ---


def test_motor_reference_is_the_kinematics_of_the_motor_side():
    posture = ROBOT.posture()
    for i, p in enumerate(run(end=1.0)):
        posture.update(*motor(i / 200.0))
        com, com_vel = posture.com_in_sole(p.support.support_foot)
        np.testing.assert_allclose(p.reference_com, com, atol=1e-12)
        np.testing.assert_allclose(p.reference_com_vel, com_vel, atol=1e-12)


def plan(t: float, preview=0, turn=0.3) -> Reference:
    """A planned COM that moves in odom, both planned soles turned and shifted against odom."""
    c, s = np.cos(turn), np.sin(turn)
    left = np.array([[c, -s, 0, 1.0], [s, c, 0, 2.0], [0, 0, 1, 0], [0, 0, 0, 1]])
    right = left.copy()
    right[:3, 3] += left[:3, :3] @ [0.0, -0.15, 0.0]

    def com(at):
        return left[:3, 3] + left[:3, :3] @ [0.02 * np.sin(4 * at), -0.07, 0.4]

    def com_vel(at):
        return left[:3, :3] @ [0.08 * np.cos(4 * at), 0.0, 0.0]

    ahead = t + 0.02 * np.arange(1, preview + 1)
    return Reference(
        T0 + round(t * 1e9), com(t), com_vel(t), np.zeros(3), np.zeros(3), left, right, Phase.DOUBLE, 0,
        0.02 if preview else 0.0,
        np.array([com(at) for at in ahead]).reshape(-1, 3), np.array([com_vel(at) for at in ahead]).reshape(-1, 3),
    )  # fmt: skip


TOPIC = CONFIG.replaced({"prediction.reference": "topic"})


def test_planned_reference_is_told_in_the_planned_sole():
    """Where odom thinks the robot is does not matter."""
    for p in run(TOPIC, end=1.5, make=lambda t: sample(t, reference=plan(t), motor_q=None)):
        t = (p.stamp_ns - T0) * 1e-9
        y = -0.07 if p.support.support_foot == Foot.LEFT else 0.08
        np.testing.assert_allclose(p.reference_com, [0.02 * np.sin(4 * t), y, 0.4], atol=1e-9)
        np.testing.assert_allclose(p.reference_com_vel, [0.08 * np.cos(4 * t), 0, 0], atol=1e-9)
    missing = Predictor(ROBOT, TOPIC).update(sample(0.0))
    assert Flags.NO_REFERENCE in missing.flags and np.isnan(missing.reference_com).all()


def test_preview_is_used():
    """What follows the reference without being felt shows the plan itself: y, and x within the springs."""
    for preview in (0, 30):
        (p,) = [Predictor(ROBOT, TOPIC).update(sample(0.4, reference=plan(0.4, preview)))]
        for horizon in p.horizons:
            ahead = 0.4 + horizon.h
            known = 0.02 * np.sin(4 * ahead)
            guess = 0.02 * np.sin(1.6) + 0.08 * np.cos(1.6) * horizon.h
            a, b = abs(horizon.com[0] - known), abs(horizon.com[0] - guess)
            if horizon.h > 0.3:
                assert (a < b) == (preview > 0)
            assert horizon.com[1] == pytest.approx(-0.07)


def test_horizons_are_those_of_the_configuration_in_ascending_order():
    config = CONFIG.replaced({"prediction.horizons": [0.4, 0.05]})
    assert [h.h for h in run(config, end=0.1)[-1].horizons] == [0.05, 0.4]
    assert run(CONFIG.replaced({"prediction.horizons": []}), end=0.1)[-1].horizons == []


def test_without_reference_the_free_run_is_the_pendulum_on_the_measured_zmp():
    """Constant ZMP and height: cosh and sinh, to the last digits; the height stays."""
    config = CONFIG.replaced({"prediction.reference": "none"})
    still = bent(ROBOT, 0.6)
    zmp = np.array([0.01, -0.02])
    wrench = np.array([0.0, 0.0, WEIGHT, zmp[1] * WEIGHT, -zmp[0] * WEIGHT, 0.0])
    make = lambda t: Sample(T0 + round(t * 1e9), still, np.zeros(12), None, None, None, wrench, np.zeros(6))  # noqa: E731
    predictions = run(config, end=0.3, make=make)
    start = predictions[0].measured_com
    omega = np.sqrt(9.81 / start[2])
    for i, p in enumerate(predictions):
        wanted = zmp + (start[:2] - zmp) * np.cosh(omega * i / 200.0)
        np.testing.assert_allclose(p.predicted_com, [*wanted, start[2]], atol=1e-10)
        assert np.isnan(p.reference_com).all() and Flags.NO_REFERENCE not in p.flags
    lost = Predictor(ROBOT, config)
    lost.update(make(0.0))
    p = lost.update(replace(make(0.005), left_wrench=None))
    assert p.flags == Flags.STALE_WRENCH | Flags.NO_REFERENCE | Flags.NOT_INITIALISED
    assert np.isnan(p.predicted_com).all()


def test_the_rate_does_not_matter_for_the_pendulum_either():
    """The ZMP goes linearly from sample to sample."""
    config = CONFIG.replaced({"prediction.reference": "none", "prediction.horizons": []})
    still = bent(ROBOT, 0.6)

    def make(t):
        wrench = WEIGHT * np.array([0.0, 0.0, 1.0, 0.02 * np.sin(9 * t), -0.03 * np.sin(7 * t), 0.0])
        return Sample(T0 + round(t * 1e9), still, np.zeros(12), None, None, None, wrench, np.zeros(6))

    fine = column(run(config, end=0.4, rate=1000.0, make=make)[::10], "predicted_com")
    coarse = column(run(config, end=0.4, rate=100.0, make=make), "predicted_com")
    moved = np.abs(fine - fine[0]).max(axis=0)[:2]
    assert (np.abs(coarse - fine).max(axis=0)[:2] < 0.02 * moved).all()


def test_predictions_own_their_arrays():
    """A prediction that is kept does not change when the next sample comes."""
    predictor = Predictor(ROBOT, CONFIG)
    kept = [predictor.update(sample(i / 200.0)) for i in range(10)]
    copies = [(p.measured_com.copy(), p.predicted_com.copy(), p.reference_com.copy()) for p in kept]
    for i in range(10, 30):
        predictor.update(sample(i / 200.0))
    for p, (measured, predicted, reference) in zip(kept, copies, strict=True):
        np.testing.assert_array_equal(p.measured_com, measured)
        np.testing.assert_array_equal(p.predicted_com, predicted)
        np.testing.assert_array_equal(p.reference_com, reference)
