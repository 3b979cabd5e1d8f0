# SPDX-License-Identifier: BSD-3-Clause
"""Messages for the joiner, by milliseconds, and what it makes of them."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace

import numpy as np
from synthetic import LEFT, RIGHT, T0, names, robot

from coman_reduced_model.core.base.stream_names import JOINTS, MOTORS, REFERENCE
from coman_reduced_model.core.base.types import Foot, JointMessage, WrenchMessage
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.streams.joiner import Joiner

MS = 1_000_000


def config(**changes):
    return Config().replaced({key.replace("__", "."): value for key, value in changes.items()})


NO_MOTOR = config(prediction__reference="none")


def add(joiner, stream, message):
    if stream in (LEFT, RIGHT):
        return joiner.add_wrench(Foot.LEFT if stream == LEFT else Foot.RIGHT, message)
    return {JOINTS: joiner.add_joint, MOTORS: joiner.add_motor, REFERENCE: joiner.add_reference}[stream](message)


def joined(messages, settings=None, flush=True):
    """Samples of messages in this order of arrival, and the joiner."""
    joiner = Joiner(robot(), settings or config())
    samples = [sample for stream, message in messages for sample in add(joiner, stream, message)]
    return (samples + joiner.flush() if flush else samples), joiner


def joint(ms, q=0.0, **changes):
    position = np.full(12, q) if np.isscalar(q) else q
    return JOINTS, replace(JointMessage(T0 + round(ms * MS), names(), position, np.zeros(12), None), **changes)


def motor(ms, q=0.0, **changes):
    return MOTORS, joint(ms, q, **changes)[1]


def wrench(stream, ms, fz=100.0, frame=None):
    frame = ("l_sole" if stream == LEFT else "r_sole") if frame is None else frame
    return stream, WrenchMessage(T0 + round(ms * MS), frame, np.array([0.0, 0.0, fz]), np.zeros(3))


def both(ms, fz=100.0):
    return [wrench(LEFT, ms, fz), wrench(RIGHT, ms, fz)]


def steady(count, period_ms=5.0, start_ms=0.0):
    """Joint states and wrenches with equal stamps."""
    times = [start_ms + k * period_ms for k in range(count)]
    return [message for t in times for message in (joint(t), *both(t))]


def exact(value):
    """Anything as a text that differs if a bit does."""
    if isinstance(value, np.ndarray):
        return value.tobytes().hex()
    if is_dataclass(value):
        return {field.name: exact(getattr(value, field.name)) for field in fields(value)}
    return repr(value)
