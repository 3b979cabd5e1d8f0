# SPDX-License-Identifier: BSD-3-Clause
"""How both soles lie to each other by the encoders: learnt while the robot stands, never while it walks."""

import numpy as np
import pytest

from coman_reduced_model.core.base.types import Foot, Phase, SupportState
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.measured.standing import SETTLED, StandingSoles
from coman_reduced_model.core.robot.robot import Posture, Robot
from coman_reduced_model.resources import config_path

BENT = [-0.4, 0.0, 0.0, 0.8, -0.4, 0.0] * 2
ANKLE = 0.02  # [rad] zero of the encoder of the left ankle pitch


def link(q: list[float]) -> Posture:
    posture = Robot(config_path("coman.urdf").read_text(encoding="utf-8"), Config().robot).posture()
    posture.update(np.array(q), np.zeros(12))
    return posture


def crooked() -> Posture:
    q = list(BENT)
    q[4] += ANKLE
    return link(q)


def double(phase_time: float, share: float = 0.5) -> SupportState:
    return SupportState(Phase.DOUBLE, Foot.LEFT, share, phase_time, 170.0, phase_time)


def test_soles_that_stand_are_taken_as_the_encoders_show_them():
    soles, posture = StandingSoles(), crooked()
    for _ in range(10):
        soles.update(posture, double(1.0), 0.005)
    planes = soles.planes()
    assert planes[Foot.LEFT][1] == pytest.approx(np.sin(ANKLE), rel=1e-6)  # by x: the other sole's toes are up
    assert planes[Foot.RIGHT][1] == pytest.approx(-np.sin(ANKLE), rel=1e-6)


def test_what_a_step_shows_is_not_taken():
    soles, posture = StandingSoles(), crooked()
    soles.update(link(BENT), double(0.0), 0.0)
    for phase_time in np.arange(0.005, SETTLED, 0.005):
        soles.update(posture, double(phase_time), 0.005)
    for support in (double(1.0, share=0.9), SupportState(Phase.LEFT, Foot.LEFT, 1.0, 1.0, 170.0, 1.0)):
        soles.update(posture, support, 0.005)
    assert np.abs(soles.planes()[Foot.LEFT]).max() < 1e-9


def test_the_first_sample_counts_until_a_foot_is_lifted():
    soles = StandingSoles()
    soles.update(crooked(), double(0.0), 0.0)
    assert soles.planes()[Foot.LEFT][1] == pytest.approx(np.sin(ANKLE), rel=1e-6)
    soles.update(crooked(), SupportState(Phase.LEFT, Foot.LEFT, 1.0, 0.0, 170.0, 0.0), 0.005)
    assert not soles.planes()[Foot.LEFT].any()
