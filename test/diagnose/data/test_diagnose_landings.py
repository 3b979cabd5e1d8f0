# SPDX-License-Identifier: BSD-3-Clause
"""Feet that slide after they have landed, and the blows of landings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from diagnose_tools import index, rms, standing, t
from synthetic import robot

from coman_reduced_model.core.base.types import Foot, Phase
from coman_reduced_model.core.effects.foot_slip import glide
from coman_reduced_model.diagnose.data.masks import masks
from coman_reduced_model.diagnose.data.recording import RATE, Recording
from coman_reduced_model.diagnose.physics.balance import evaluate
from coman_reduced_model.diagnose.physics.hypotheses import unknowns


def stepping(slides: Sequence[float], seconds: float = 0.3) -> tuple[Recording, float]:
    """The right foot lands every 0.8 s for so long; by how much of 0.01 rad its hip gives way each time as it bears.

    Also how far back 0.01 rad takes the right sole [m].
    """
    recording, _ = standing()
    since, step = np.mod(t, 0.8) - 0.3, np.minimum(np.floor(t / 0.8).astype(int), len(slides) - 1)
    phase = np.where((since >= 0.0) & (since < seconds), Phase.DOUBLE, Phase.LEFT)
    gone = np.array([glide(s)[0] for s in since])
    q = recording.q.copy()
    q[:, index("RHipSag")] += 0.01 * np.array(slides)[step] * gone
    posture, bent = robot().posture(), np.zeros(len(robot().joint_names))
    ends = []
    for angle in (0.0, 0.01):
        bent[index("RHipSag")] = angle
        posture.update(bent, bent)
        ends.append(posture.p[Foot.RIGHT][0])
    return recording.changed(phase=phase, q=q), ends[0] - ends[1]


def test_a_foot_that_slides_after_each_landing_shows_step_by_step():
    world, (recording, back) = standing()[1], stepping([1.0] * 5)
    where = masks(recording, world)
    found = evaluate(recording, world, where).residuals["slide/x"]
    assert [slide.foot for slide in where.slides] == [Foot.RIGHT] * 5
    assert found[np.isfinite(found)] == pytest.approx(np.full(5, -back), rel=0.05)
    left = evaluate(recording, world.changed(slip=np.array([0.0, back])), where).residuals["slide/x"]
    assert np.nanmax(np.abs(left)) < 0.03 * abs(back)
    other = evaluate(recording, world.changed(slip=np.array([back, 0.0])), where).residuals["slide/x"]
    np.testing.assert_array_equal(other, found)  # the left foot has not landed


def test_a_stumble_is_no_slide_and_a_foot_that_soon_leaves_tells_none():
    world = standing()[1]
    stumbled, _ = stepping([0.0, 0.0, 3.0, 0.0, 0.0])
    where = masks(stumbled, world)
    found = evaluate(stumbled, world, where).residuals["slide/x"]
    assert len(where.slides) == 4 and np.nanmax(np.abs(found)) < 1e-9
    assert not masks(stepping([1.0] * 5, seconds=0.15)[0], world).slides


def landing(force: np.ndarray, steps: int = 3) -> tuple[Recording, np.ndarray]:
    """The right foot lands every second with a force (k,) [N] that then stays; the values of `landing/z`."""
    recording, world = standing()
    since = np.mod(t, 1.0) - 0.5
    phase = np.where((since >= 0.0) & (t < steps), Phase.DOUBLE, Phase.LEFT)
    borne = force[np.clip(np.round(since * RATE).astype(int), 0, len(force) - 1)]
    wrench = {**recording.wrench, Foot.RIGHT: np.where(since >= 0.0, borne, 0.0)[:, None] * np.eye(6)[2]}
    landed = recording.changed(phase=phase, wrench=wrench)
    found = evaluate(landed, world, masks(landed, world)).residuals["landing/z"]
    return landed, found[np.isfinite(found)]


def test_a_force_that_only_rises_is_no_blow():
    for rise_s in (0.02, 0.05, 0.1):
        rising = 60.0 * np.clip(np.arange(1, 100) / RATE / rise_s, 0.0, 1.0)
        assert landing(rising)[1] == pytest.approx(np.zeros(3), abs=1e-9)
    landed, at_once = landing(np.full(100, 60.0))
    seldom = landed.changed(period=0.02)
    assert np.isnan(masks(seldom, standing()[1]).blow).all()  # of samples that are too far apart nothing is told
    assert at_once == pytest.approx(np.zeros(3), abs=1e-9)


@pytest.mark.parametrize("late", [0, 8])
@pytest.mark.parametrize("impulse", [0.7, 1.5])
def test_a_blow_is_told_from_the_load_that_follows(impulse, late):
    """A half sine of 10 ms beside a load that rises in 50 ms; the edge of the foot may have touched before."""
    k = np.arange(100)
    inside = (k >= late) & (k < late + 2)
    blow = impulse * np.pi / 0.02 * np.abs(np.sin(np.pi * (k + 0.5) / RATE / 0.01)) * inside
    recording, found = landing(blow + 50.0 * np.clip(k / RATE / 0.05, 0.0, 1.0))
    assert found == pytest.approx(np.full(3, impulse), rel=0.25)
    world = standing()[1]
    _, believed = next(f for f in unknowns(recording, world) if f.effect == "touchdown_impact").apply(
        recording, world, impulse
    )
    left = evaluate(recording, believed, masks(recording, world)).residuals["landing/z"]
    assert rms(left) < 0.35 * rms(found)


def test_what_shakes_a_foot_that_stands_is_no_blow():
    shaking = 60.0 + 25.0 * np.sin(2.0 * np.pi * 37.0 * np.arange(100) / RATE)
    assert np.abs(landing(shaking)[1]).max() < 0.1
    blow = 1.5 * np.pi / 0.02 * np.abs(np.sin(np.pi * (np.arange(100) + 0.5) / RATE / 0.01)) * (np.arange(100) < 2)
    assert landing(shaking + blow)[1] == pytest.approx(np.full(3, 1.5), rel=0.3)


def test_a_foot_that_never_stands_for_long_shows_no_blows():
    recording, world = standing()
    phase = np.where(np.mod(t, 0.6) < 0.1, Phase.DOUBLE, np.where(np.mod(t, 1.2) < 0.6, Phase.LEFT, Phase.RIGHT))
    always = masks(recording.changed(phase=phase, valid=np.mod(t, 0.6) < 0.3), world).blow
    assert np.isnan(always).all()


def test_a_foot_that_chatters_does_not_land():
    recording, world = standing()
    phase = np.where(np.mod(t, 0.2) < 0.1, Phase.DOUBLE, Phase.LEFT)
    assert np.isnan(masks(recording.changed(phase=phase), world).blow).all()
