# SPDX-License-Identifier: BSD-3-Clause
"""What a robot publishes straight to serialised messages (CDR); see layout.py."""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from ..core.base.pose import quaternion
from ..core.base.stream_names import CONTACTS, IMU, JOINTS, MOTORS, REFERENCE, WRENCHES
from ..core.base.types import ContactMessage, ImuMessage, JointMessage, Reference, WrenchMessage
from ..messages import ODOM
from .layout import LITTLE_ENDIAN, Layout, cdr_string, header_values

_NONE: tuple[float, ...] = ()


@lru_cache(maxsize=64)
def _joint_format(names: tuple[str, ...], lengths: tuple[int, int, int]) -> tuple[struct.Struct, tuple[Any, ...]]:
    """The format of a JointState with arrays of these lengths, and what fills it between stamp and positions."""
    layout, values = Layout().header(b"\0").add("I"), [1, b"\0", len(names)]
    for name in names:
        text = cdr_string(name)
        layout.add("I").add("s", len(text))
        values += [len(text), text]
    for length in lengths:
        layout.doubles(length)
    return layout.packer(), tuple(values)


def encode_joints(message: JointMessage) -> bytes:
    """A sensor_msgs/JointState; messages.joint_to, serialised."""
    position = message.position.tolist()
    velocity = _NONE if message.velocity is None else message.velocity.tolist()
    effort = _NONE if message.effort is None else message.effort.tolist()
    lengths = len(position), len(velocity), len(effort)
    packer, middle = _joint_format(tuple(message.names), lengths)
    stamp = header_values(message.stamp_ns, b"\0")[:2]
    return LITTLE_ENDIAN + packer.pack(
        *stamp, *middle, lengths[0], *position, lengths[1], *velocity, lengths[2], *effort
    )


@lru_cache(maxsize=64)
def _wrench_format(frame: bytes) -> struct.Struct:
    return Layout().header(frame).add("d", 6).packer()


def encode_wrench(message: WrenchMessage) -> bytes:
    """A geometry_msgs/WrenchStamped; messages.wrench_to, serialised."""
    frame = cdr_string(message.frame_id)
    return LITTLE_ENDIAN + _wrench_format(frame).pack(
        *header_values(message.stamp_ns, frame), *message.force.tolist(), *message.torque.tolist()
    )


@lru_cache(maxsize=64)
def _imu_format(frame: bytes) -> struct.Struct:
    return Layout().header(frame).add("d", 4 + 9 + 3 + 9 + 3 + 9).packer()


_ZEROS = (0.0,) * 9
_UNKNOWN = (-1.0,) + (0.0,) * 8


def encode_imu(message: ImuMessage) -> bytes:
    """A sensor_msgs/Imu; messages.imu_to, serialised."""
    frame = cdr_string(message.frame_id)
    turn = (0.0, 0.0, 0.0, 1.0, *_UNKNOWN)
    if message.orientation is not None:
        turn = (*message.orientation.tolist(), *_ZEROS)
    rates, accelerations = message.angular_velocity.tolist(), message.linear_acceleration.tolist()
    return LITTLE_ENDIAN + _imu_format(frame).pack(
        *header_values(message.stamp_ns, frame), *turn, *rates, *_ZEROS, *accelerations, *_ZEROS
    )


_CONTACTS = Layout().header(cdr_string("")).add("B").add("B").packer()


def encode_contacts(message: ContactMessage) -> bytes:
    """A FootContacts; messages.contacts_to, serialised."""
    values = header_values(message.stamp_ns, cdr_string(""))
    return LITTLE_ENDIAN + _CONTACTS.pack(*values, message.left, message.right)


@lru_cache(maxsize=8)
def _reference_format(frame: bytes, preview: int, feet: int) -> struct.Struct:
    # A phase, the step, the interval of the preview; then its positions and velocities, soles and phases.
    layout = Layout().header(frame).add("d", 4 * 3 + 2 * 7).add("B").add("i").add("d")
    layout.doubles(preview).doubles(preview).doubles(14 * feet).add("I")
    return (layout.add("s", feet) if feet else layout).packer()


@lru_cache(maxsize=4)
def _pose(matrix: bytes) -> tuple[float, ...]:
    """Position and quaternion of (4, 4): the same as long as the foot stands."""
    T = np.frombuffer(matrix).reshape(4, 4)
    return (*T[:3, 3].tolist(), *quaternion(T[:3, :3]))


def encode_reference(reference: Reference) -> bytes:
    """A ComReference; messages.reference_to, serialised."""
    r, frame = reference, cdr_string(ODOM)
    preview, rates = np.ravel(r.preview_com).tolist(), np.ravel(r.preview_com_vel).tolist()
    feet, phases = (_NONE, b"") if r.steps is None else (r.steps.soles.ravel().tolist(), bytes(r.steps.phase.tolist()))
    return LITTLE_ENDIAN + _reference_format(frame, len(preview), len(phases)).pack(
        *header_values(r.stamp_ns, frame),
        *r.com.tolist(),
        *r.com_vel.tolist(),
        *r.com_acc.tolist(),
        *r.zmp.tolist(),
        *_pose(r.T_odom_left.tobytes()),
        *_pose(r.T_odom_right.tobytes()),
        int(r.phase),
        r.step,
        r.preview_dt,
        len(preview),
        *preview,
        len(rates),
        *rates,
        len(feet),
        *feet,
        len(phases),
        *([phases] if phases else ()),
    )


ENCODE: dict[str, Callable[[Any], bytes]] = {  # by stream
    JOINTS: encode_joints,
    MOTORS: encode_joints,
    **dict.fromkeys(WRENCHES.values(), encode_wrench),
    IMU: encode_imu,
    CONTACTS: encode_contacts,
    REFERENCE: encode_reference,
}
