# SPDX-License-Identifier: BSD-3-Clause
"""What happens between foot and floor: blows and slipping."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from effect_tools import PAPER, config, predicted, values
from synthetic import T0, robot, walk

from coman_reduced_model.core.base.types import Foot, Phase, SupportState
from coman_reduced_model.core.effects.catalogue import build_effects

LIMP = {f"robot.{side}.{key}": [value] * 6 for side in ("left", "right")
        for key, value in (("stiffness", 1e-3), ("damping", 0.0))}  # fmt: skip


@pytest.mark.parametrize("rate", [100.0, 200.0, 1000.0])
def test_a_landing_changes_the_momentum_by_its_impulse(rate):
    """On legs that hold nothing; the foot is below the hip, so that the blow is upward within some percent."""
    base = PAPER.replaced({**LIMP, "prediction.horizons": [], "prediction.reset_every_steps": 0})
    messages = walk(1.5, rate)
    plain, _ = predicted(messages, base)
    struck, _ = predicted(messages, config("touchdown_impact", base=base, impulse=0.5))
    phases = [p.support.phase for p in plain]
    landings = [k for k in range(1, len(phases)) if phases[k] == Phase.DOUBLE and phases[k - 1] in (1, 2)]
    assert len(landings) >= 2
    gained = values(struck, "predicted_com_vel") - values(plain, "predicted_com_vel")
    after = landings[0] + round(0.05 * rate)
    assert landings[1] > after
    assert gained[landings[0] - 1, 2] == 0.0
    assert robot().mass * gained[after, 2] == pytest.approx(0.5, rel=0.03)


def test_a_foot_slides_back_once_a_step_and_carries_the_robot_along():
    (effect,), _ = build_effects(config("foot_slip", "right", distance=0.02).effects, robot())
    dt, slid, speed, push = 0.001, 0.0, 0.0, 0.0
    for k in range(1500):
        t = k * dt
        # Left alone, both from 0.3 s with the right foot in charge at once, right alone, both again, left alone.
        phase = [Phase.LEFT, Phase.DOUBLE, Phase.RIGHT, Phase.DOUBLE, Phase.LEFT][round(t * 1000) // 300]
        foot = Foot.LEFT if phase == Phase.LEFT or (phase == Phase.DOUBLE and t > 0.5) else Foot.RIGHT
        effect.begin(T0 + round(1e9 * t), SupportState(phase, foot, 0.5, t % 0.3))
        slid += effect.slide()
        felt = SimpleNamespace(force=np.zeros(3))  # in the frame of the sole, which accelerates
        effect.push(felt, None)
        speed -= felt.force[0] / robot().mass * dt
        push += speed * dt
    assert slid == pytest.approx(-0.02, rel=1e-6)  # the left foot holds
    assert push == pytest.approx(-0.02, rel=0.02) and speed == pytest.approx(0.0, abs=2e-3)


def test_odometry_follows_the_sliding_foot():
    messages = walk(2.4)
    held, _ = predicted(messages, PAPER)
    slipped, _ = predicted(messages, config("foot_slip", "", distance=0.01))
    way = values(slipped, "T_odom_sole")[:, 0, 3] - values(held, "T_odom_sole")[:, 0, 3]
    phases = [p.support.phase for p in held]
    landings = sum(now == Phase.DOUBLE and before in (1, 2) for before, now in zip(phases, phases[1:], strict=False))
    assert landings >= 3
    # What slides before the foot is in charge is in the measured distance of the feet already.
    assert -0.01 * landings <= way[-1] < -0.002 * landings
    assert np.diff(way).max() <= 0.0 and np.diff(way).min() > -0.001
    np.testing.assert_array_equal(values(slipped, "measured_com"), values(held, "measured_com"))
