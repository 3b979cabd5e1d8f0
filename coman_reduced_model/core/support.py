# SPDX-License-Identifier: BSD-3-Clause
"""Support phase from the vertical foot forces: a Schmitt trigger a foot, debounced in time.

A foot lands when its force stays above `contact_on` shares of the weight for `dwell_on` seconds and lifts when it
stays below `contact_off` for `dwell_off`. Dwell times are counted in stamps, so a phase does not depend on the rate;
a change is reported when its dwell has passed but dated back to the first sample that showed it, so that
`phase_time` carries no such delay.
"""

from __future__ import annotations

from math import isfinite

from .config import SupportConfig
from .types import Foot, Phase, SupportState

NAN = float("nan")


class _Debounced:
    """A value that changes once another value has been asked for long enough without a break."""

    __slots__ = ("since_ns", "value", "wanted", "_first_ns")

    def __init__(self, value: int, stamp_ns: int) -> None:
        self.value = value
        self.since_ns = stamp_ns  # when the value began to hold
        self.wanted = value
        self._first_ns = stamp_ns

    def update(self, wanted: int, stamp_ns: int, dwell_ns: float) -> bool:
        """Ask for a value; True when it was adopted now."""
        if wanted == self.value:
            self.wanted = wanted
            return False
        if wanted != self.wanted:
            self.wanted = wanted
            self._first_ns = stamp_ns
        if stamp_ns - self._first_ns < dwell_ns:
            return False
        self.value = wanted
        self.since_ns = self._first_ns
        return True

    def interrupt(self) -> None:
        """Forget a change that is under way: the samples that would confirm it are missing."""
        self.wanted = self.value


class SupportDetector:
    """Phase, support foot and load share from the vertical forces of both feet.

    Args:
        config: thresholds as shares of the weight, dwell times [s].
        weight_N: weight of the robot [N]; `config.weight` takes precedence if it is not zero.
    """

    def __init__(self, config: SupportConfig, weight_N: float) -> None:
        self.config = config
        self.weight = config.weight or weight_N  # [N]
        if not self.weight > 0.0:
            raise ValueError(f"weight for the support phase must be positive, got {self.weight} N")
        self.reset()

    def reset(self) -> None:
        """Forget everything; the next complete sample decides without dwell."""
        self._left: _Debounced | None = None
        self._right: _Debounced | None = None
        self._foot: _Debounced | None = None
        self._phase = Phase.FLIGHT
        self._began_ns = 0
        self._last_ns = 0

    def update(self, stamp_ns: int, left_fz: float | None, right_fz: float | None) -> SupportState:
        """Take one pair of forces.

        Args:
            stamp_ns: stamp [ns]; one that goes back (a bag that loops) starts afresh.
            left_fz: vertical force of the ground on the left foot [N], positive upwards; None (or not finite): stale.
            right_fz: the same for the right foot.

        Returns:
            A fresh state. While a wrench is stale, phase and support foot are held and share and force are NaN. In
            flight the support foot is the last one; NONE only before any foot has been seen on the ground.
        """
        if stamp_ns < self._last_ns:
            self.reset()
        self._last_ns = stamp_ns
        if left_fz is None or right_fz is None or not isfinite(left_fz + right_fz):
            return self._stale(stamp_ns)
        total = left_fz + right_fz
        if self._left is None:
            self._start(stamp_ns, left_fz, right_fz)
        else:
            self._track(stamp_ns, left_fz, right_fz)
        share = min(1.0, max(0.0, left_fz / total)) if total > 0.02 * self.weight else NAN
        return SupportState(self._phase, Foot(self._foot.value), share, (stamp_ns - self._began_ns) * 1e-9, total)

    def _stale(self, stamp_ns: int) -> SupportState:
        if self._left is None:
            return SupportState()
        for part in (self._left, self._right, self._foot):
            part.interrupt()
        return SupportState(self._phase, Foot(self._foot.value), NAN, (stamp_ns - self._began_ns) * 1e-9, NAN)

    def _start(self, stamp_ns: int, left_fz: float, right_fz: float) -> None:
        middle = 0.5 * (self.config.contact_on + self.config.contact_off) * self.weight
        left, right = left_fz > middle, right_fz > middle
        foot = Foot.NONE if not (left or right) else Foot.LEFT if left_fz >= right_fz else Foot.RIGHT
        self._left, self._right = _Debounced(left, stamp_ns), _Debounced(right, stamp_ns)
        self._foot = _Debounced(foot, stamp_ns)
        self._phase = Phase(left + 2 * right)
        self._began_ns = stamp_ns

    def _track(self, stamp_ns: int, left_fz: float, right_fz: float) -> None:
        config, changed = self.config, False
        for foot, fz in ((self._left, left_fz), (self._right, right_fz)):
            share = fz / self.weight
            if foot.value:
                changed |= foot.update(share >= config.contact_off, stamp_ns, config.dwell_off * 1e9)
            else:
                changed |= foot.update(share > config.contact_on, stamp_ns, config.dwell_on * 1e9)
        if changed:
            self._phase = Phase(self._left.value + 2 * self._right.value)
            self._began_ns = max(self._began_ns, self._left.since_ns, self._right.since_ns)
        current = self._foot.value
        if self._phase in (Phase.LEFT, Phase.RIGHT):
            if current != self._phase:
                self._foot = _Debounced(Foot(int(self._phase)), self._began_ns)
        elif self._phase == Phase.DOUBLE:
            lead = (left_fz - right_fz) / max(left_fz + right_fz, 1e-9)
            wanted = current
            if current != Foot.LEFT and lead > config.share_hysteresis:
                wanted = Foot.LEFT
            elif current != Foot.RIGHT and -lead > config.share_hysteresis:
                wanted = Foot.RIGHT
            elif current == Foot.NONE:
                wanted = Foot.LEFT if lead >= 0 else Foot.RIGHT
            self._foot.update(wanted, stamp_ns, config.dwell_on * 1e9)
