# SPDX-License-Identifier: BSD-3-Clause
"""A robot whose joints are at rest, and what an IMU on it says."""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from coman_reduced_model import Config, Robot
from coman_reduced_model.core.base.nominal import load_nominal
from coman_reduced_model.core.base.pose import LEVEL
from coman_reduced_model.core.base.types import Foot, ImuMessage, Phase, Sample, SupportState
from coman_reduced_model.core.effects.hooks import Now
from coman_reduced_model.resources import config_path

STILL = np.zeros(12)
BENT = np.array([-0.4, 0.0, 0.0, 0.8, -0.4, 0.0] * 2)  # the trunk is level
RATE = 200.0
NOMINAL = load_nominal()


@cache
def robot() -> Robot:
    return Robot(config_path("coman.urdf").read_text(encoding="utf-8"), Config().robot)


def imu(stamp: int, turn: Rotation, rate: np.ndarray, frame: str = "imu_link") -> ImuMessage:
    return ImuMessage(stamp, frame, turn.as_quat(), rate, np.zeros(3))


def now(stamp: int, q: np.ndarray, imu: ImuMessage | None, foot: Foot = Foot.LEFT, down: np.ndarray = LEVEL) -> Now:
    link = robot().posture()
    link.update(q, STILL)
    phase = Phase.LEFT if foot == Foot.LEFT else Phase.RIGHT
    com, com_vel = link.com_in_sole(foot)
    return Now(
        Sample(stamp, q, STILL, imu=imu), SupportState(phase, foot), 1.0 / RATE, link, com, com_vel, None, np.eye(4),
        0, foot, down, np.zeros(2), 0.0, False,
    )  # fmt: skip
