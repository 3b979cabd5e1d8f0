# SPDX-License-Identifier: BSD-3-Clause
"""Motors follow their references with a finite bandwidth, against assumption (A1)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import exp, expm1
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from ..base.delays import lagged
from ..base.parameter import Parameter
from .ambiguity import DRIVE_DELAY, Ambiguity
from .base import Effect
from .unknown import PLAN, About, Unknown, arrays_changed

if TYPE_CHECKING:
    from ..base.types import Array, Reference, Sample

_GAP = 0.25  # [s] after a longer one the filter starts again


class MotorLag(Effect):
    """T y' = u - y from the reference u to the position y, exact for references that are linear between samples.

    Acts on the motor states (that echo the command) and on the plan with its preview. Of no use where the motor states
    are measured: those lag already.
    """

    name: ClassVar[str] = "motor_lag"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("time_constant", "float", 0.0, "s", "of the closed loop of the motors", 0.0, 1.0),
    )
    ambiguity: ClassVar[Ambiguity | None] = DRIVE_DELAY
    sentence: ClassVar[str] = "the motors lag behind their reference by {time_constant}"
    experiment: ClassVar[str] = DRIVE_DELAY.experiment
    exact: ClassVar[bool] = False
    clock: ClassVar[bool] = True

    def __init__(self, where: str, values: Mapping[str, float]) -> None:
        super().__init__(where, values)
        self.reset()

    def reset(self) -> None:
        self._motors = _Lag(self.values["time_constant"])
        self._plan = _Lag(self.values["time_constant"])

    def correct(self, sample: Sample) -> None:
        if not self.values["time_constant"] > 0.0:
            return
        if sample.motor_q is not None and sample.motor_qd is not None:
            sample.motor_q, sample.motor_qd = self._motors.update(sample.stamp_ns, sample.motor_q, sample.motor_qd)
        if sample.reference is not None:
            sample.reference = self._planned(sample.stamp_ns, sample.reference)

    def _planned(self, stamp_ns: int, plan: Reference) -> Reference:
        """The plan is shared between samples: a changed copy."""
        com, com_vel = self._plan.update(stamp_ns, plan.com, plan.com_vel)
        ahead, ahead_vel = np.empty_like(plan.preview_com), np.empty_like(plan.preview_com)
        last, now = plan.com, com
        for k, planned in enumerate(plan.preview_com):
            now, ahead_vel[k] = self._plan.step(now, last, planned, plan.preview_dt)
            ahead[k], last = now, planned
        late = round(1e9 * self.values["time_constant"])  # to first order, as soles move with their joints
        steps = None if plan.steps is None else replace(plan.steps, stamp_ns=plan.steps.stamp_ns + late)
        return replace(plan, com=com, com_vel=com_vel, preview_com=ahead, preview_com_vel=ahead_vel, steps=steps)

    @classmethod
    def unknowns(cls, about: About) -> list[Unknown]:
        prior = {
            "": about.widths("motor_lag.time_constant", "spread", "reach"),
            PLAN: about.widths("motor_lag.plan", "spread", "reach"),
        }
        ways = {"": "motor_q", PLAN: "plan"} if about.plan else {"": "motor_q"}
        return [
            cls.unknown("time_constant", arrays_changed([array], lagged), way, step=0.005, low=0.0, **prior[way])
            for way, array in ways.items()
            if about.motors
        ]


class _Lag:
    """A first-order lag of an array."""

    def __init__(self, time_constant: float) -> None:
        self._T = time_constant  # [s]
        self._stamp_ns = 0
        self._u: Array | None = None
        self._y: Array | None = None

    def update(self, stamp_ns: int, u: Array, rate: Array) -> tuple[Array, Array]:
        """Position and velocity of what follows the reference u, which moves at `rate`."""
        dt = (stamp_ns - self._stamp_ns) * 1e-9
        if self._y is None or self._u is None or not 0.0 < dt <= _GAP:
            y, y_rate = u - self._T * rate, rate.copy()  # as if it had always moved like this
        else:
            y, y_rate = self.step(self._y, self._u, u, dt)
        self._stamp_ns, self._u, self._y = stamp_ns, u, y
        return y, y_rate

    def step(self, y: Array, u_0: Array, u_1: Array, dt: float) -> tuple[Array, Array]:
        """Position and velocity dt [s] later, while the reference goes linearly from u_0 to u_1."""
        decay = exp(-dt / self._T)
        slope = (u_1 - u_0) / dt
        y_1 = u_0 + (y - u_0) * decay + slope * (dt + self._T * expm1(-dt / self._T))
        return y_1, (u_1 - y_1) / self._T
