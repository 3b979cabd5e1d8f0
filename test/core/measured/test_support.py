# SPDX-License-Identifier: BSD-3-Clause
"""Support phase from foot forces: what walks, noise, lost samples and wrong sensors make of it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from coman_reduced_model.core.base.types import Array, Foot, Phase, SupportState
from coman_reduced_model.core.config.sections import SupportConfig
from coman_reduced_model.core.measured.support import SupportDetector

WEIGHT = 170.0
CONFIG = SupportConfig()
SLACK = max(CONFIG.dwell_on, CONFIG.dwell_off)

# One step of the left foot's share: landing with a dip, load transfer, stance, transfer, a light peel-off, swing.
_STEP_T = [0.0, 0.004, 0.03, 0.06, 0.15, 0.3, 0.7, 0.71, 0.85, 0.87, 0.9, 0.905, 1.4]
_STEP_SHARE = [0.0, 0.17, 0.20, 0.10, 0.65, 1.0, 1.0, 0.83, 0.30, 0.09, 0.06, 0.0, 0.0]
PERIOD, LANDS, LIFTS = 1.4, 0.0, 0.905


def share_of_left(t: Array) -> Array:
    return np.interp(np.mod(t, PERIOD), _STEP_T, _STEP_SHARE)


def walk(t: Array) -> tuple[Array, Array]:
    """Forces of both feet [N]; the right one does the same half a period later."""
    return WEIGHT * share_of_left(t), WEIGHT * share_of_left(t + PERIOD / 2)


def true_phase(t: Array) -> Array:
    left, right = walk(t)
    return (left > 0) + 2 * (right > 0)


def run(
    t: Array, left: Array, right: Array, config: SupportConfig = CONFIG, weight: float = WEIGHT
) -> list[SupportState]:
    detector = SupportDetector(config, weight)
    return [
        detector.update(round(1e9 * (1.0 + time)), float(a), float(b))
        for time, a, b in zip(t, left, right, strict=True)
    ]


def changes(t: Array, states: list[SupportState]) -> list[tuple[Phase, float]]:
    return [
        (b.phase, float(t[i + 1]))
        for i, (a, b) in enumerate(zip(states, states[1:], strict=False))
        if a.phase != b.phase
    ]


def ideal(t: Array) -> list[tuple[Phase, float]]:
    phases = true_phase(t)
    return [(Phase(int(phases[i])), float(t[i])) for i in range(1, len(t)) if phases[i] != phases[i - 1]]


@pytest.mark.parametrize("rate", [1000, 200, 100])
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("bias", [0.0, 3.0, -3.0])
def test_noisy_and_biased_walk_gives_each_phase_once(rate: int, seed: int, bias: float) -> None:
    t = np.arange(0.3, 12.0, 1 / rate)
    rng = np.random.default_rng(seed)
    left, right = walk(t)
    states = run(t, left + bias + rng.normal(0, 1.5, len(t)), right - bias + rng.normal(0, 1.5, len(t)))
    found, wanted = changes(t, states), ideal(np.arange(0.3, 12.0, 1e-4))
    assert [phase for phase, _ in found] == [phase for phase, _ in wanted]
    assert max(abs(a - b) for (_, a), (_, b) in zip(found, wanted, strict=True)) < 0.025


def begins(t: Array, states: list[SupportState]) -> list[float]:
    """When each new phase says that it began [s]."""
    pairs = zip(t[1:], states, states[1:], strict=False)
    return [float(time) - after.phase_time for time, before, after in pairs if before.phase != after.phase]


FINE = np.arange(0.45, 3.95, 0.0005)  # on one leg at both ends
FINE_STATES = run(FINE, *walk(FINE))


@given(st.floats(0.0, 0.01), st.sampled_from([1000, 200, 100]))
def test_phases_do_not_depend_on_the_rate(offset: float, rate: int) -> None:
    fine, coarse = FINE, np.arange(0.45 + offset, 3.95, 1 / rate)
    one, other = FINE_STATES, run(coarse, *walk(coarse))
    assert [p for p, _ in changes(fine, one)] == [p for p, _ in changes(coarse, other)]
    for a, b in zip(begins(fine, one), begins(coarse, other), strict=True):
        assert abs(a - b) <= 1 / rate + 0.001
    for (_, a), (_, b) in zip(changes(fine, one), changes(coarse, other), strict=True):
        assert abs(a - b) <= (1 + math.ceil(SLACK * rate)) / rate + 0.001  # a dwell is seen to end at a sample


@given(st.integers(0, 10_000), st.floats(0.0, 0.3))
def test_lost_samples_only_delay(seed: int, lost: float) -> None:
    t = np.arange(0.3, 5.0, 0.005)
    kept = t[np.random.default_rng(seed).random(len(t)) >= lost]
    assert [phase for phase, _ in changes(kept, run(kept, *walk(kept)))][:8] == [p for p, _ in ideal(t)][:8]


@given(
    st.sampled_from([Phase.FLIGHT, Phase.LEFT, Phase.RIGHT, Phase.DOUBLE]),
    st.lists(st.tuples(st.floats(-1, 1), st.floats(-1, 1)), min_size=10, max_size=100),
)
def test_noise_within_the_hysteresis_never_changes_the_phase(phase: Phase, noise: list[tuple[float, float]]) -> None:
    loads = [0.5 if phase & 1 else 0.0, 0.5 if phase & 2 else 0.0]
    # An unloaded foot may read anything up to contact_on, a loaded one anything down to contact_off.
    room = [0.46 if loaded else 0.069 for loaded in loads]
    detector = SupportDetector(CONFIG, WEIGHT)
    detector.update(1, *(WEIGHT * load for load in loads))
    for k, pair in enumerate(noise, 1):
        force = [WEIGHT * (load + r * n) for load, r, n in zip(loads, room, pair, strict=True)]
        # At 1 kHz this ends before the zero of a sensor is learnt, which would move the room that there is.
        assert detector.update(k * 1_000_000, *force).phase == phase


@given(st.floats(0.05, 50.0), st.integers(0, 1000))
def test_thresholds_scale_with_the_weight(scale: float, seed: int) -> None:
    t = np.arange(0.3, 3.0, 0.005)
    noise = np.random.default_rng(seed).normal(0, 1.0, (2, len(t)))
    forces = [force + n for force, n in zip(walk(t), noise, strict=True)]
    one = run(t, *forces)
    other = run(t, *(scale * force for force in forces), weight=scale * WEIGHT)
    assert [(s.phase, s.support_foot) for s in one] == [(s.phase, s.support_foot) for s in other]


forces = st.one_of(st.none(), st.floats(-50, 400), st.sampled_from([math.nan, math.inf]))


@given(st.lists(st.tuples(st.integers(0, 20_000_000), forces, forces), max_size=60))
def test_any_input_gives_a_consistent_state(inputs: list[tuple[int, float | None, float | None]]) -> None:
    detector, stamp, before = SupportDetector(CONFIG, WEIGHT), 10**9, None
    for dt, left, right in inputs:
        stamp += dt
        state = detector.update(stamp, left, right)
        if state.phase in (Phase.LEFT, Phase.RIGHT):
            assert state.support_foot == Foot(int(state.phase))
        if state.phase != Phase.FLIGHT:
            assert state.support_foot != Foot.NONE
        assert state.phase_time >= 0.0
        missing = any(x is None or not math.isfinite(x) for x in (left, right))
        assert not missing or (math.isnan(state.left_share) and math.isnan(state.total_force))
        assert math.isnan(state.left_share) or 0.0 <= state.left_share <= 1.0
        if before is not None:
            if missing and before.support_foot:
                assert (state.phase, state.support_foot) == (before.phase, before.support_foot)
            if state.phase == before.phase and before.total_force == before.total_force and not missing:
                assert state.phase_time == pytest.approx(before.phase_time + dt * 1e-9)
        before = state


@given(st.integers(0, 1000))
def test_swapped_feet_swap_the_answer(seed: int) -> None:
    t = np.arange(0.3, 3.0, 0.005)
    rng = np.random.default_rng(seed)
    left, right = (force + rng.normal(0, 1.5, len(t)) for force in walk(t))
    swap = {0: 0, 1: 2, 2: 1, 3: 3}
    for a, b in zip(run(t, left, right), run(t, right, left), strict=True):
        assert (swap[int(a.phase)], swap[int(a.support_foot)]) == (int(b.phase), int(b.support_foot))
        assert a.left_share == pytest.approx(1.0 - b.left_share, nan_ok=True)


def test_nothing_is_known_before_the_first_complete_pair() -> None:
    detector = SupportDetector(CONFIG, WEIGHT)
    for pair in ((None, None), (85.0, None), (None, 85.0), (math.nan, 85.0)):
        state = detector.update(10, *pair)
        assert (state.phase, state.support_foot) == (Phase.FLIGHT, Foot.NONE)
        assert math.isnan(state.left_share) and math.isnan(state.total_force)
    state = detector.update(20, 90.0, 80.0)
    assert (state.phase, state.support_foot, state.left_share) == (Phase.DOUBLE, Foot.LEFT, pytest.approx(90 / 170))


def test_flight_keeps_the_last_foot() -> None:
    detector, ms = SupportDetector(CONFIG, WEIGHT), 1_000_000
    assert detector.update(1 * ms, 0.0, 0.0).support_foot == Foot.NONE
    detector = SupportDetector(CONFIG, WEIGHT)
    detector.update(0, 0.0, WEIGHT)
    for k in range(1, 20):
        state = detector.update(k * ms, 0.0, 0.0)
    assert (state.phase, state.support_foot) == (Phase.FLIGHT, Foot.RIGHT)
    assert state.phase_time == pytest.approx(0.019 - 0.96e-3)  # since 4 % were crossed
    assert math.isnan(state.left_share)


def test_spikes_shorter_than_the_dwell_change_nothing() -> None:
    left = np.full(100, WEIGHT)
    right = np.zeros(100)
    right[50], left[70] = 100.0, 0.0
    assert {s.phase for s in run(np.arange(100) * 0.001, left, right)} == {Phase.LEFT}


@pytest.mark.parametrize("rate", [1000, 200, 100])
def test_a_foot_that_bounces_after_landing_has_landed_once(rate: int) -> None:
    t = np.arange(0, 1.0, 1 / rate)
    right = WEIGHT * np.interp(t, [0, 0.5, 0.505, 0.52, 0.54, 0.58, 0.6, 1.0], [0, 0, 0.3, 0.3, 0, 0, 0.5, 0.5])
    found = changes(t, run(t, WEIGHT - right, right))
    assert [phase for phase, _ in found] == [Phase.DOUBLE] and found[0][1] == pytest.approx(0.505, abs=0.02)


def test_a_short_touch_ends_at_last_and_says_when_it_did() -> None:
    t = np.arange(0, 1.0, 0.005)
    right = np.where((t >= 0.4995) & (t < 0.5495), 0.3 * WEIGHT, 0.0)
    states = run(t, WEIGHT - right, right)
    assert [phase for phase, _ in changes(t, states)] == [Phase.DOUBLE, Phase.LEFT]
    assert begins(t, states) == [pytest.approx(0.5, abs=0.006), pytest.approx(0.55, abs=0.006)]


def test_a_phase_begins_where_the_force_crosses_the_threshold() -> None:
    t = np.arange(0, 0.2, 0.01)
    ramp = WEIGHT * np.clip((t - 0.1) / 0.05, 0.0, 1.0) * 0.5
    states = run(t, WEIGHT - ramp, ramp)
    crossing = 0.1 + 0.05 * CONFIG.contact_on / 0.5
    assert begins(t, states) == [pytest.approx(crossing, abs=1e-6)]


def test_a_stale_wrench_interrupts_what_was_under_way() -> None:
    detector, ms = SupportDetector(CONFIG, WEIGHT), 1_000_000
    detector.update(0, WEIGHT, 0.0)
    for k in range(1, 200):  # landing and stale samples in turn never add up to a dwell
        assert detector.update(k * ms, WEIGHT, 50.0 if k % 2 else None).phase == Phase.LEFT


def test_support_foot_in_double_support_has_hysteresis() -> None:
    t = np.arange(0, 4.0, 0.005)
    share = 0.5 + 0.3 * np.sin(2 * np.pi * t / 2.0)
    rng = np.random.default_rng(1)
    noise = rng.normal(0, 0.01, len(t))
    states = run(t, WEIGHT * (share + noise), WEIGHT * (1 - share - noise))
    feet = [int(s.support_foot) for s in states]
    at = [i for i in range(1, len(feet)) if feet[i] != feet[i - 1]]
    assert len(at) == 4 - (feet[0] == Foot.LEFT)
    # The new foot carries more by the hysteresis, and carried it for the dwell.
    for i in at:
        assert abs(2 * share[i] - 1) == pytest.approx(CONFIG.share_hysteresis, abs=0.06)


def test_standing_with_swaying_load_stays_in_double_support_on_one_foot() -> None:
    t = np.arange(0, 20.0, 0.01)
    share = 0.5 + 0.04 * np.sin(2 * np.pi * t / 3.0)
    states = run(t, WEIGHT * share, WEIGHT * (1 - share))
    assert {s.phase for s in states} == {Phase.DOUBLE} and len({s.support_foot for s in states}) == 1


@pytest.mark.parametrize("bias", [0.03, -0.03])
def test_the_zero_of_a_sensor_is_learnt_while_its_foot_is_in_the_air(bias: float) -> None:
    t = np.arange(0.3, 12.0, 0.005)
    left, right = walk(t)
    detector = SupportDetector(CONFIG, WEIGHT)
    for k, time in enumerate(t):
        state = detector.update(round(1e9 * time), float(left[k] + bias * WEIGHT), float(right[k]))
        if time > 8.0 and left[k] == 0.0 and right[k] == WEIGHT:
            assert state.left_share == pytest.approx(0.0, abs=0.01)
    assert detector.zeros == pytest.approx((bias * WEIGHT, 0.0), abs=0.01 * WEIGHT)


def test_what_is_learnt_as_zero_stays_below_the_lower_threshold() -> None:
    """A foot that rests lightly for minutes is taken for a bias, but only up to contact_off."""
    detector = SupportDetector(CONFIG, WEIGHT)
    for k in range(5000):
        detector.update(k * 10_000_000, WEIGHT, 0.038 * WEIGHT)
    assert detector.zeros[1] <= CONFIG.contact_off * WEIGHT
    for k in range(5000, 5010):
        state = detector.update(k * 10_000_000, 0.5 * WEIGHT, 0.5 * WEIGHT)
    assert state.phase == Phase.DOUBLE


def test_stamps_that_go_back_start_afresh() -> None:
    detector = SupportDetector(CONFIG, WEIGHT)
    for k in range(100):
        detector.update(5_000_000_000 + k * 5_000_000, WEIGHT, 0.0)
    state = detector.update(1_000_000_000, 0.0, WEIGHT)
    assert (state.phase, state.support_foot, state.phase_time) == (Phase.RIGHT, Foot.RIGHT, 0.0)


def test_configuration_may_change_at_run_time_and_weight_of_the_configuration_wins() -> None:
    detector = SupportDetector(replace(CONFIG, weight=100.0), WEIGHT)
    assert detector.weight == 100.0
    assert detector.update(0, 50.0, 6.0).phase == Phase.DOUBLE
    detector.config = replace(CONFIG, weight=100.0, contact_on=0.5, contact_off=0.4)
    for k in range(1, 10):
        state = detector.update(k * 1_000_000, 50.0, 6.0)
    assert state.phase == Phase.LEFT
    for weight in (0.0, -1.0, math.nan):
        with pytest.raises(ValueError, match="weight"):
            SupportDetector(CONFIG, weight)


def test_after_a_reset_nothing_is_left_of_the_past() -> None:
    t = np.arange(0.3, 3.0, 0.005)
    detector = SupportDetector(CONFIG, WEIGHT)
    for k in range(500):
        detector.update(k * 5_000_000, 3.0, 150.0)
    detector.reset()
    again = [detector.update(round(1e9 * (1 + x)), float(a), float(b)) for x, a, b in zip(t, *walk(t), strict=True)]
    assert again == run(t, *walk(t))


@pytest.mark.parametrize("rate", [1000, 200, 100])
def test_the_support_foot_changes_when_the_load_has_passed_whatever_the_rate(rate: int) -> None:
    """`foot_time` counts from where the other foot began to carry more by the hysteresis, between two samples."""
    detector = SupportDetector(SupportConfig(share_hysteresis=0.1, dwell_on=0.0), WEIGHT)
    began = []
    foot = Foot.LEFT
    for i in range(rate):  # the load passes from left to right and back: 55 % at 0.2675 and 0.7825 s
        t = i / rate
        right = 0.2 + 0.6 * min(1.0, max(0.0, (0.5 - abs(t - 0.525)) / 0.4154))
        state = detector.update(10**9 + round(t * 1e9), (1.0 - right) * WEIGHT, right * WEIGHT)
        assert state.phase is Phase.DOUBLE
        if state.support_foot is not foot:
            foot = state.support_foot
            assert state.foot_time < 1.001 / rate
            began.append(t - state.foot_time)
    wanted = [0.025 + 0.35 / 0.6 * 0.4154, 1.025 - 0.25 / 0.6 * 0.4154]
    assert began == pytest.approx(wanted, abs=1e-6)
