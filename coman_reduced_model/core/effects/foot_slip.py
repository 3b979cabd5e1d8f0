# SPDX-License-Identifier: BSD-3-Clause
"""A foot that slips while it bears."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar

from ..base.parameter import Parameter
from ..base.types import Foot, Phase
from .base import Effect
from .unknown import About, Unknown, world_plus

if TYPE_CHECKING:
    from ..base.types import SupportState
    from ..robot.robot import Robot
    from .hooks import Now, Push

_FROM, SLIPS_TO = 0.05, 0.2  # [s] after the landing: when it slips, as it takes over the load


class FootSlip(Effect):
    """A foot that has landed slides back along its x axis, gently beginning and ending.

    Odometry follows the sliding sole, and whoever stands on it feels its acceleration.
    """

    name: ClassVar[str] = "foot_slip"
    place: ClassVar[str] = "foot"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("distance", "float", 0.0, "m", "that the foot slides in each step, against x of its sole", -0.2, 0.2),
    )
    sentence: ClassVar[str] = "{at} slips back by {distance} in each step"
    experiment: ClassVar[str] = "the same walk on a rough floor"
    absent: ClassVar[bool] = True
    exact: ClassVar[bool] = False

    def __init__(self, where: str, values: Mapping[str, float]) -> None:
        super().__init__(where, values)
        self.reset()

    def reset(self) -> None:
        self._phase = Phase.FLIGHT
        self._landed_ns = {Foot.LEFT: 0, Foot.RIGHT: 0}  # 0: not yet
        self._stamp_ns = 0
        self._slid = 0.0  # [m] of the support sole along its x axis since the last sample
        self._acceleration = 0.0  # [m/s^2] of the support sole along its x axis

    def bind(self, robot: Robot) -> None:
        super().bind(robot)
        self._mass = robot.mass

    def begin(self, stamp_ns: int, support: SupportState) -> None:
        before, self._phase = self._phase, support.phase
        if support.phase == Phase.DOUBLE and before in (Phase.LEFT, Phase.RIGHT):
            landed = Foot.RIGHT if before == Phase.LEFT else Foot.LEFT
            self._landed_ns[landed] = stamp_ns - round(support.phase_time * 1e9)
        last, self._stamp_ns = self._stamp_ns, stamp_ns
        self._slid = self._acceleration = 0.0
        foot = support.support_foot
        if foot not in self.feet or not self._landed_ns[foot]:
            return
        since = (stamp_ns - self._landed_ns[foot]) * 1e-9
        share, second = glide(since)
        self._acceleration = -self.values["distance"] * second
        self._slid = -self.values["distance"] * (share - glide(since - (stamp_ns - last) * 1e-9)[0])

    def slide(self) -> float:
        return self._slid

    def push(self, push: Push, now: Now) -> None:
        push.force[0] -= self._mass * self._acceleration

    @classmethod
    def unknowns(cls, about: About) -> list[Unknown]:
        prior = about.widths("foot_slip.distance", "spread", "reach")
        feet = enumerate(("left", "right"))
        return [cls.unknown("distance", world_plus("slip", k), where, **prior) for k, where in feet]


def glide(since: float) -> tuple[float, float]:
    """Share of the way, 0..1, that is done some time after the landing [s], and its second derivative [1/s^2]."""
    s = (since - _FROM) / (SLIPS_TO - _FROM)
    if not 0.0 < s < 1.0:
        return (1.0 if s >= 1.0 else 0.0), 0.0
    return s * s * (3.0 - 2.0 * s), (6.0 - 12.0 * s) / (SLIPS_TO - _FROM) ** 2
