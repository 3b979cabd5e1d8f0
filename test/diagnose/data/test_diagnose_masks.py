# SPDX-License-Identifier: BSD-3-Clause
"""Which samples the laws may use: contacts, gaps, feet in the air, edges of soles, joints with play."""

from __future__ import annotations

import numpy as np
import pytest
from diagnose_tools import standing, stretched, swaying, t

from coman_reduced_model.core.base.types import Foot, Phase
from coman_reduced_model.diagnose.data.masks import masks, not_on_edges, on_flat_soles
from coman_reduced_model.diagnose.data.recording import Recording, moving
from coman_reduced_model.diagnose.physics.balance import evaluate


def test_contacts_and_gaps_are_left_out_and_feet_in_the_air_found():
    recording, world = standing()
    phase = np.select([t < 1.0, t < 2.0, t < 3.0], [Phase.DOUBLE, Phase.LEFT, Phase.DOUBLE], Phase.RIGHT)
    valid = ~((t > 0.4) & (t < 0.5))
    where = masks(recording.changed(phase=phase, valid=valid), world)
    at = t[where.ticks]
    assert not where.steady[(np.abs(at - 1.0) < 0.05) | (np.abs(at - 2.0) < 0.05) | ((at > 0.4) & (at < 0.5))].any()
    assert where.steady[(at > 1.2) & (at < 1.8)].all()
    assert where.air[Foot.RIGHT][(at > 1.2) & (at < 1.8)].all() and not where.air[Foot.RIGHT][at < 1.1].any()
    assert not where.air[Foot.LEFT][at < 3.1].any()
    assert where.double[(at > 2.1) & (at < 2.9)].all() and not where.double[(at > 1.0) & (at < 2.0)].any()
    (slide,) = where.slides
    assert slide.foot == Foot.RIGHT and 2.0 < t[slide.first.start] < t[slide.last.stop] <= 2.2 and slide.share > 0.9
    assert moving(phase) and not moving(recording.phase)


@pytest.mark.parametrize("steps", [1, 3])
def test_a_step_that_was_mostly_stood_on_an_edge_is_left_out_unless_most_are(steps):
    """Four steps, left and right; in some, more than half of the time on the edge of the sole, by the IMU."""
    recording, world = standing()
    since, step = np.mod(t, 1.0), np.floor(t)
    phase = np.where(since < 0.2, Phase.DOUBLE, np.where(step % 2, Phase.RIGHT, Phase.LEFT))
    edge = (step < steps) & (since > 0.2) & (since < 0.64)
    up = np.column_stack([np.zeros(len(t)), 0.02 * (1.0 + since) * edge, np.ones(len(t))])
    rocked = recording.changed(phase=phase, up=up, left_share=np.where(since < 0.2, 0.5, step % 2 == 0))
    where = masks(rocked, world)
    flat = on_flat_soles(where, evaluate(rocked, world, where).residuals, world)
    single, at = flat.steady & ~flat.double, t[flat.ticks]
    assert not single[edge[flat.ticks]].any()
    rest = single[(at > 0.74) & (at < 0.92)]
    assert not rest.any() if steps == 1 else rest.all()
    assert single[(at > 3.3) & (at < 3.8)].all() and not flat.staggers
    # What is an edge is what the population, or the robot's own baseline, says.
    wide = world.changed(limits={**world.limits, "sole_turned": 0.1})
    assert on_flat_soles(where, evaluate(rocked, world, where).residuals, wide).steady.sum() == where.steady.sum()


def test_who_is_nearly_always_on_an_edge_staggers():
    recording, world = swaying(Phase.DOUBLE), standing()[1]
    where = masks(recording, world)
    found = on_flat_soles(where, evaluate(recording, world, where).residuals, world)
    assert found.staggers and found.steady.sum() == where.steady.sum()


def bearing(at: float, when: np.ndarray) -> Recording:
    """Standing on both feet, the left one bearing at a share of its sole's half length while `when` (n,)."""
    recording, world = standing()
    x0, x1, _, _ = world.robot.soles[Foot.LEFT]
    wrench = {foot: values * [1.0, 1.0, 1.0, 0.0, 0.0, 0.0] for foot, values in recording.wrench.items()}
    wrench[Foot.LEFT][:, 4] = -wrench[Foot.LEFT][:, 2] * (0.5 * (x0 + x1) + at * 0.5 * (x1 - x0) * when)
    return recording.changed(wrench=wrench)


def test_a_foot_that_bears_at_its_edge_is_not_flat():
    _, world = standing()
    late = t > 0.7 * t[-1]
    for at, flat in ((0.98, False), (-0.98, False), (0.6, True)):
        recording = bearing(at, late)
        where = not_on_edges(masks(recording, world), recording, world)
        begun = t[where.ticks] > 0.7 * t[-1] + 0.1
        assert where.flat[begun].all() == flat and (flat or not where.flat[begun].any())
        assert where.flat[t[where.ticks] < 0.7 * t[-1] - 0.1].all() and where.double[begun].all()
        found = evaluate(recording, world, where).residuals
        assert np.isfinite(found["feet/pitch"][begun]).all() == np.isfinite(found["tilt/pitch"][begun]).all() == flat
        assert np.isfinite(found["force/z"][begun]).all()


def test_soles_on_whose_edge_a_robot_always_stands_are_other_ones():
    recording, world = bearing(0.98, np.ones(len(t), dtype=bool)), standing()[1]
    where = masks(recording, world)
    assert (not_on_edges(where, recording, world).flat == where.flat).all()


def test_the_zero_of_an_encoder_takes_up_no_play():
    """Where torques are too small to tell at which end a joint is, the law tells it, about its middle."""
    played, off = (
        masks(stretched(lambda tau, nominal, zero=zero: nominal + 0.005 * np.sign(tau) + zero), standing()[1]).taken_up
        for zero in (0.0, 0.004)
    )
    np.testing.assert_allclose(off, played, atol=1e-9)
    assert np.abs(played).max() == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize(("play", "seen"), [(0.0, 0.02), (0.01, 0.9)])
def test_noise_of_encoders_takes_up_no_play(play, seen):
    """Play that is seen in what noise makes of a law is in the residual and in its derivative: all noise were play."""
    recording, world = standing()
    noise = np.random.default_rng(0).normal(0.0, 0.0005, recording.q.shape)
    stretch = 0.01 * (recording.motor_q - recording.q) + 0.5 * play * np.sign(recording.tau) + noise
    light = recording.changed(tau=0.01 * recording.tau, motor_q=recording.q + stretch)
    assert np.abs(masks(light, world).taken_up).max() == pytest.approx(seen, abs=0.1)
