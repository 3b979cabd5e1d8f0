# SPDX-License-Identifier: BSD-3-Clause
"""What a robot publishes, serialised: the bytes of the general serialiser."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from coman_reduced_model.bag.encode_input import ENCODE
from coman_reduced_model.bag.types import bag_types, typestore
from coman_reduced_model.core.base.stream_names import CONTACTS, IMU, JOINTS, REFERENCE, WRENCHES
from coman_reduced_model.core.base.types import ContactMessage, Foot, ImuMessage, JointMessage, WrenchMessage
from coman_reduced_model.core.gait.gait import plan_walk
from coman_reduced_model.core.gait.parameters import gait
from coman_reduced_model.messages import INPUT_TYPES, contacts_to, imu_to, joint_to, reference_to, wrench_to

STAMP = 1_700_000_000_123_456_789
RNG = np.random.default_rng(1)
JOINT = JointMessage(STAMP, ("LHipSag", "b", "RKnee"), *RNG.standard_normal((3, 3)))
ONE = replace(JOINT, names=("a",), position=JOINT.position[:1], velocity=None, effort=JOINT.effort[:1])
WRENCH = WrenchMessage(STAMP, "l_sole", *RNG.standard_normal((2, 3)))
TURNED = ImuMessage(STAMP, "imu_link", np.array([0.1, 0.2, 0.3, 0.9]), *RNG.standard_normal((2, 3)))
POINT = plan_walk(gait("test2")).reference(2.2, STAMP, 0.02, 25)


@pytest.mark.parametrize(
    ("stream", "message", "convert"),
    [
        (JOINTS, JOINT, joint_to),
        (JOINTS, replace(JOINT, velocity=None, effort=None), joint_to),
        (JOINTS, ONE, joint_to),
        (WRENCHES[Foot.LEFT], WRENCH, wrench_to),
        (WRENCHES[Foot.RIGHT], replace(WRENCH, frame_id="r_ft"), wrench_to),
        (IMU, TURNED, imu_to),
        (IMU, replace(TURNED, orientation=None), imu_to),
        (CONTACTS, ContactMessage(STAMP, True, False), contacts_to),
        (REFERENCE, POINT, reference_to),
        (REFERENCE, plan_walk(gait("test2")).reference(0.0, STAMP), reference_to),
    ],
)
def test_bytes_are_those_of_the_general_serialiser(stream, message, convert):
    general = typestore().serialize_cdr(convert(bag_types(), message), INPUT_TYPES[stream])
    assert ENCODE[stream](message) == bytes(general)
