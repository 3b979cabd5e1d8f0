# SPDX-License-Identifier: BSD-3-Clause
"""The walk of the trajectory node: which plan is followed since when, and what start, stop and reset do to it."""

from __future__ import annotations

import dataclasses

from ...errors import ConfigError
from ..base.types import Reference
from ..config.schema import Config
from .gait import WalkPlan, plan_walk
from .parameters import GaitParameters, gait

_STANDING_T = -1e6  # [s] before the plan, so that its preview stands still as well
_MEMORY = 6.0  # a change so many time constants ahead moves the present COM by exp(-6) of its size: below 0.1 mm


def gait_of(config: Config) -> GaitParameters:
    """The gait that a configuration names, with the values that it replaces.

    Raises:
        ConfigError: the gait does not exist, or a value is not allowed.
    """
    return gait(config.gait.name, gravity=config.robot.gravity, **config.gait.changes())


class Walk:
    """Standing or walking along a plan, in any clock [ns].

    Attributes:
        plan: what is followed, or would be from `start` on.
        start_ns: when the plan began or will begin; None: standing at its beginning.
        refused: why the last repetition could not begin.
    """

    def __init__(self, config: Config) -> None:
        """Plan the configured gait.

        Raises:
            ConfigError: it is not possible.
        """
        self._take_over(config)
        self.refused = ""
        self.reset()

    def _take_over(self, config: Config) -> None:
        self._gait = gait_of(config)
        self._repeat = config.gait.repeat
        self._preview = (config.gait.preview_interval, config.gait.preview_length)

    def change(self, config: Config) -> None:
        """Take over another gait for the next plan, of `start` or a repetition; a walk under way ends as planned.

        Raises:
            ConfigError: it is not possible, or would move the COM of a robot that stands.
        """
        wanted = gait_of(config)
        for key in ("com_height_m", "zmp_offset_x_m"):
            value, now = getattr(wanted, key), getattr(self._gait, key)
            if value != now:
                raise ConfigError(f"gait: {key}: {value:g} for {now:g} would move a COM that stands: restart the node")
        plan_walk(wanted)
        repeated = self._repeat
        self._take_over(config)
        if self._repeat != repeated:
            self._again = self._repeat

    def reset(self) -> None:
        """Back to standing at the beginning, at once."""
        self.plan: WalkPlan = plan_walk(self._gait)
        self._feet: tuple = ()  # where the plan starts: default
        self.start_ns: int | None = None
        self._again = self._repeat  # whether the walk under way begins again at its end; not after `stop`

    def time(self, now_ns: int) -> float:
        """Time in the plan [s]."""
        return _STANDING_T if self.start_ns is None else (now_ns - self.start_ns) * 1e-9

    @property
    def _lasts_ns(self) -> int:
        return round(self.plan.duration_s * 1e9)

    def walking(self, now_ns: int) -> bool:
        """Whether the plan is under way."""
        return self.start_ns is not None and now_ns < self.start_ns + self._lasts_ns

    def start(self, now_ns: int) -> str | None:
        """Begin the plan now; after its end, plan it again from where the robot stands. A sentence if it cannot."""
        if self.walking(now_ns):
            return f"is walking already, {self.describe(now_ns)}"
        if self.start_ns is not None or self.plan.parameters != self._gait:
            stands = self.plan.sample(self.time(now_ns))
            feet = (stands.T_odom_left, stands.T_odom_right)
            try:
                self.plan, self._feet = plan_walk(self._gait, *feet), feet
            except ConfigError as error:
                return f"cannot walk from where it stands: {error}"
        self.start_ns = now_ns
        self._again = self._repeat
        return None

    def stop(self, now_ns: int) -> str | None:
        """End the walk with as few more steps as leave the present motion smooth. A sentence if it cannot.

        The COM has to know of a stop before it happens: a step or two more, then the feet are brought together.
        """
        if not self.walking(now_ns):
            return "stands already"
        self._again = False
        t = self.time(now_ns)
        horizon = t + _MEMORY / self.plan.parameters.omega
        for index, step in enumerate(self.plan.footsteps[:-1]):
            if step.t_lift > t and step.t_land > horizon:
                changed = dataclasses.replace(self.plan.parameters, steps=index + 1)
                self.plan = plan_walk(changed, *self._feet)
                break
        return None

    def go_on(self, now_ns: int) -> bool:
        """Begin again at the end of the plan, if it is to be repeated and was not stopped; whether it does."""
        if not self._again or self.start_ns is None or self.walking(now_ns):
            return False
        self.refused = self.start(self.start_ns + self._lasts_ns) or ""
        self._again = not self.refused
        return self._again

    def reference(self, stamp_ns: int) -> Reference:
        """The plan at a time, with its preview."""
        return self.plan.reference(self.time(stamp_ns), stamp_ns, *self._preview)

    def describe(self, now_ns: int) -> str:
        """Where in the plan, for people."""
        t, steps = self.time(now_ns), len(self.plan.footsteps)
        if self.start_ns is None:
            return "stands, waiting for ~/start"
        if t < 0.0:
            return f"stands, walks in {-t:.1f} s"
        if t >= self.plan.duration_s:
            return f"stands after {steps} steps"
        return f"step {self.plan.sample(t).step + 1} of {steps}, {t:.1f} s of {self.plan.duration_s:.1f} s"
