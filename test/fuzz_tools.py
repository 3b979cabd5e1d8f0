# SPDX-License-Identifier: BSD-3-Clause
"""What the fuzzers share: well-formed messages of a walk with spoiled values, and the bounds that predictions keep."""

from __future__ import annotations

import math
import random
import struct
from functools import cache
from typing import Any

import numpy as np

from coman_reduced_model.bag.decode import decoder
from coman_reduced_model.bag.session import Session
from coman_reduced_model.core.base.limits import DIVERGED
from coman_reduced_model.core.base.types import Flags, Prediction
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.pipeline import Pipeline
from coman_reduced_model.core.robot.limits import Limits, limits_of
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
        self.sent = self.predictions = self.spoiled = 0

    def run(self, rng: random.Random, count: int, share: float = 0.02, damage: float = 0.1) -> None:
        """Send `count` messages of which a share is spoiled.

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
                data = (with_other_bytes if rng.random() < damage else with_other_numbers)(raw, rng)
            convert = decoders.setdefault(stream, decoder(stream))
            self._check(pipeline.feed(stream, data, convert))
            self.sent += 1
        self._check(pipeline.flush())
        status = pipeline.status()
        for name, stream in status.streams.items():
            lost = {key: n for key, n in status.rejected.items() if key.rpartition("/")[0] == name}
            assert stream.received == stream.accepted + sum(lost.values()), (name, stream, lost)

    def _check(self, predictions: list[Prediction]) -> None:
        for prediction in predictions:
            wrong = out_of_bounds(prediction, self.limits)
            assert not wrong, f"at {prediction.stamp_ns}: {wrong}"
        self.predictions += len(predictions)
