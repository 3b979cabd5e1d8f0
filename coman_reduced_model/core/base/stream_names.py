# SPDX-License-Identifier: BSD-3-Clause
"""The names of the input streams: relative topic names, but for the IMU's."""

from __future__ import annotations

from .types import Foot

JOINTS, MOTORS, REFERENCE, IMU, CONTACTS = "joint_states", "motor_states", "com/reference", "imu", "foot_contacts"
WRENCHES = {Foot.LEFT: "left_foot/wrench", Foot.RIGHT: "right_foot/wrench"}
