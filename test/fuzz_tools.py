# SPDX-License-Identifier: BSD-3-Clause
"""What the fuzzers share: well-formed messages of a walk with spoiled values, and the bounds that predictions keep."""

from __future__ import annotations

import math
import random
import struct
from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np

from coman_reduced_model.bag.decode import decoder
from coman_reduced_model.bag.session import Session
from coman_reduced_model.bag.types import typestore
from coman_reduced_model.core.base.limits import DIVERGED
from coman_reduced_model.core.base.types import Flags, Prediction
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.pipeline import Pipeline
from coman_reduced_model.core.robot.limits import Limits, limits_of
from coman_reduced_model.messages import INPUT_TYPES
from coman_reduced_model.resources import bag_path

SIZES = (-1e300, -1e9, -1e4, -60.0, -6.0, -0.6, 0.0, 0.6, 6.0, 60.0, 1e4, 1e9, 1e300, math.nan, math.inf)


@cache
def walk(name: str = "test1") -> tuple[Any, list[tuple[str, bytes]]]:
    """Robot and serialised messages by stream, in order, of a shipped walk."""
    with Session(bag_path(name)) as session:
        return session.robot, [(stream, bytes(raw)) for stream, _, raw in session.messages()]


def with_other_numbers(raw: bytes, rng: random.Random) -> bytes:
    """The message, still well formed: some of the doubles at its end replaced."""
    data = bytearray(raw)
    count = rng.choice((1, 1, 2, 6, 12))
    for _ in range(count):
        offset = 4 + 8 * rng.randrange(max(1, (len(data) - 44) // 8)) + 40
        if offset + 8 <= len(data):
            struct.pack_into("<d", data, offset, rng.choice(SIZES) * rng.uniform(0.5, 1.5))
    return bytes(data)


def with_other_field(stream: str, raw: bytes, rng: random.Random) -> bytes:
    """The message, still well formed: one of its fields, whichever, with another value of its type."""
    store = typestore()
    message = store.deserialize_cdr(raw, INPUT_TYPES[stream])
    owner, name = rng.choice(list(_fields(message)))
    value = getattr(owner, name)
    if isinstance(value, np.ndarray):
        value = np.array(value)
        if value.size and rng.random() < 0.7:
            value[rng.randrange(value.size)] = rng.choice(SIZES) * rng.uniform(0.5, 1.5)
        elif value.size not in (9, 36):  # of a covariance, which has no other length
            value = np.resize(value, rng.choice((0, 1, 3, 13)))
    elif isinstance(value, list):
        value = [*value[: rng.randrange(len(value) + 1)], *rng.sample(["", "LKneeSag", "x"], rng.randrange(3))]
    elif isinstance(value, str):
        value = rng.choice(("", "l_sole", "r_sole", "base_link", "nobody", "x" * 300))
    elif isinstance(value, int):
        value = rng.choice((0, 1, 255, value + 1, max(0, value - 1), max(0, value - 300_000_000)))
    else:
        value = rng.choice(SIZES) * rng.uniform(0.5, 1.5)
    setattr(owner, name, value)
    return bytes(store.serialize_cdr(message, INPUT_TYPES[stream]))


def _fields(message: Any) -> Iterator[tuple[Any, str]]:
    """Each field below a message that is none itself: the message that it belongs to, and its name."""
    for name in vars(message):
        if name != "__msgtype__":
            value = getattr(message, name)
            if hasattr(value, "__msgtype__"):
                yield from _fields(value)
            else:
                yield message, name


def with_other_bytes(raw: bytes, rng: random.Random) -> bytes:
    """The message damaged anywhere: bits, length, or all of it."""
    data = bytearray(raw)
    for _ in range(rng.choice((1, 2, 8))):
        data[rng.randrange(len(data))] = rng.randrange(256)
    return bytes(data[: rng.randrange(len(data) + 1)] if rng.random() < 0.2 else data)


def out_of_bounds(prediction: Prediction, limits: Limits) -> str:
    """What of a prediction no robot can do; empty if nothing is."""
    com, vel = prediction.measured_com, prediction.measured_com_vel
    residual = float(np.linalg.norm(prediction.residual))
    if residual >= DIVERGED:
        return f"the free run is {residual} m off"
    if np.linalg.norm(com) > limits.reach or np.linalg.norm(vel) > limits.com_speed:
        return f"the measured COM is at {com}, {vel}"
    for each in prediction.horizons:
        most = DIVERGED + limits.com_speed * each.h + 0.5 * limits.gravity * each.h**2
        if not np.isfinite(each.com).all():
            if Flags.REJECTED_STATE not in prediction.flags:
                return f"NaN {each.h} s ahead without a flag"
        elif np.abs(each.com - com).max() > most:
            return f"{each.com - com} from the COM {each.h} s ahead, {most} m at most"
    return ""


class Fuzzed:
    """A walk through a pipeline, with some messages spoiled."""

    def __init__(self, reference: str = "motor") -> None:
        robot, self._messages = walk()
        self._config = Config().replaced({"prediction.reference": reference})
        self._robot = robot
        self.limits = limits_of(robot, 9.81, robot.mass * 9.81)
        self.predictions = self.spoiled = 0
        self.off = 0.0  # [m] largest residual, or distance of a prediction ahead from the COM

    def run(self, rng: random.Random, count: int, share: float = 0.02) -> None:
        """Send `count` messages of which a share is spoiled: numbers or any field, a tenth of these not well formed.

        Raises:
            AssertionError: a prediction is out of bounds, or a message is neither used nor counted.
        """
        pipeline = Pipeline(self._robot, self._config)
        decoders = {stream: decoder(stream) for stream, _ in self._messages[:100]}
        first = rng.randrange(max(1, len(self._messages) - count))
        for stream, raw in self._messages[first : first + count]:
            data = raw
            if rng.random() < share:
                self.spoiled += 1
                kind = rng.random()
                if kind < 0.1:
                    data = with_other_bytes(raw, rng)
                else:
                    data = with_other_numbers(raw, rng) if kind < 0.55 else with_other_field(stream, raw, rng)
            convert = decoders.setdefault(stream, decoder(stream))
            self._check(pipeline.feed(stream, data, convert))
        self._check(pipeline.flush())
        status = pipeline.status()
        for name, stream in status.streams.items():
            lost = {key: n for key, n in status.rejected.items() if key.rpartition("/")[0] == name}
            assert stream.received == stream.accepted + sum(lost.values()), (name, stream, lost)

    def _check(self, predictions: list[Prediction]) -> None:
        for prediction in predictions:
            wrong = out_of_bounds(prediction, self.limits)
            assert not wrong, f"at {prediction.stamp_ns}: {wrong}"
            ahead = (np.linalg.norm(each.com - prediction.measured_com) for each in prediction.horizons)
            self.off = float(np.nanmax([self.off, np.linalg.norm(prediction.residual), *ahead]))
        self.predictions += len(predictions)
