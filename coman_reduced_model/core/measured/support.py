# SPDX-License-Identifier: BSD-3-Clause
"""Support phase from the vertical foot forces: a Schmitt trigger a foot, debounced in time.

A foot lands when its force stays above `contact_on` shares of the weight for `dwell_on` seconds and lifts when it
stays below `contact_off` for `dwell_off`. Dwell times are counted in stamps from where the force, taken as linear
between samples, crossed the threshold: so a phase does not depend on the rate, and a landing that jumps far above the
threshold is believed sooner than one that grazes it. A change is reported when its dwell has passed but dated back to
the crossing, so `phase_time` carries no such delay. A foot that has just landed may bounce: it lifts again only if it
is still unloaded 0.1 s after the landing.

The thresholds are low, because a foot that lands or peels off carries a few percent of the weight for several
hundredths of a second, and a foot sensor's zero drifts by as much. So the zero of each sensor is learnt while its
foot is in the air, slowly, and never by more than `contact_off`: whatever is learnt, an unloaded foot cannot be
made to look loaded, nor a loaded one unloaded.
"""

from __future__ import annotations

from math import isfinite

from ..base.types import Foot, Phase, SupportState
from ..config.sections import SupportConfig

_NAN = float("nan")
_PHASES = (Phase.FLIGHT, Phase.LEFT, Phase.RIGHT, Phase.DOUBLE)  # by left + 2 right; a lookup is faster than Phase()
_FEET = (Foot.NONE, Foot.LEFT, Foot.RIGHT)  # by phase
_AIR_SETTLE_NS = 0.1e9  # the zero is learnt from this long after lift-off: peeling and ringing are over by then
_BOUNCE_NS = 0.1e9  # after a landing; shorter than any stance, longer than feet bounce or unload once more
_ZERO_TIME_NS = 0.5e9  # time constant of the zero: about one swing, far longer than a landing
_SHARE_FORCE = 0.05  # share of the weight that must be on the ground for a load share to mean anything


class _Contact:
    """Contact of one foot, and the zero of its sensor."""

    __slots__ = ("_first_ns", "_last_load", "_last_ns", "loaded", "since_ns", "zero")

    def __init__(self, loaded: bool, stamp_ns: int) -> None:
        self.loaded = loaded
        # Beginning of the present contact or swing; a foot that is down at first has not just landed.
        self.since_ns = stamp_ns - int(_BOUNCE_NS) if loaded else stamp_ns
        self.zero = 0.0  # [N] what the sensor reads unloaded
        self._first_ns = -1  # beginning of a change under way; -1: none is
        self._last_ns = stamp_ns
        self._last_load = _NAN  # [N] at the last sample; NaN if that is not to be interpolated from

    def update(self, stamp_ns: int, force: float, on: float, off: float, dwell_on: float, dwell_off: float) -> bool:
        """Take a raw force; thresholds in N, dwell times in ns. True when the contact changed."""
        dt, self._last_ns = stamp_ns - self._last_ns, stamp_ns
        load = force - self.zero
        before, self._last_load = self._last_load, load
        if (load >= off) if self.loaded else (load <= on):
            self._first_ns = -1
            if not self.loaded and stamp_ns - self.since_ns > _AIR_SETTLE_NS and load < off:
                zero = self.zero + load * min(1.0, dt / _ZERO_TIME_NS)
                self.zero = min(off, max(-off, zero))
            return False
        if self._first_ns < 0:
            self._first_ns = stamp_ns
            threshold = off if self.loaded else on
            if (before - threshold) * (load - threshold) <= 0.0:  # not so after a gap or a change of the thresholds
                self._first_ns -= int(dt * (load - threshold) / (load - before))
        if stamp_ns - self._first_ns < (dwell_off if self.loaded else dwell_on):
            return False
        if self.loaded and stamp_ns - self.since_ns < _BOUNCE_NS:
            return False
        self.loaded = not self.loaded
        self.since_ns = self._first_ns
        self._first_ns = -1
        return True

    def interrupt(self, stamp_ns: int) -> None:
        """Forget a change that is under way: the samples that would confirm it are missing."""
        self._first_ns = -1
        self._last_ns = stamp_ns
        self._last_load = _NAN


class SupportDetector:
    """Phase, support foot and load share from the vertical forces of both feet.

    Args:
        config: thresholds as shares of the weight, dwell times [s].
        weight_N: weight of the robot [N]; `config.weight` takes precedence if it is not zero.

    Raises:
        ValueError: the weight is not positive.
    """

    def __init__(self, config: SupportConfig, weight_N: float) -> None:
        self.reconfigure(config, weight_N)
        self.reset()

    def reconfigure(self, config: SupportConfig, weight_N: float) -> None:
        """Take over other thresholds; may be called at any time, with the arguments of the constructor."""
        self.config = config
        self.weight = config.weight or weight_N  # [N]
        if not self.weight > 0.0:
            raise ValueError(f"weight for the support phase must be positive, got {self.weight} N")

    @property
    def lifting(self) -> float:
        """Force below which a foot lifts [N]."""
        return self.config.contact_off * self.weight

    def reset(self) -> None:
        """Forget everything; the next complete sample decides without dwell."""
        self._feet: tuple[_Contact, _Contact] | None = None
        self._phase = Phase.FLIGHT
        self._foot = Foot.NONE
        self._began_ns = 0
        self._last_ns = 0
        self._foot_ns = 0  # since when it has been the support foot
        self._lead_ns = -1  # since when the other foot has carried more; -1: it does not
        self._lead = _NAN  # [N] what the other foot carries beyond the hysteresis, at the last sample

    @property
    def zeros(self) -> tuple[float, float]:
        """What the left and right sensor read without load [N], as learnt so far."""
        return (self._feet[0].zero, self._feet[1].zero) if self._feet else (0.0, 0.0)

    def update(self, stamp_ns: int, left_fz: float | None, right_fz: float | None) -> SupportState:
        """Take one pair of forces.

        Args:
            stamp_ns: stamp [ns]; one that goes back (a bag that loops) starts afresh.
            left_fz: vertical force of the ground on the left foot [N], positive upwards; None (or not finite): stale.
            right_fz: the same for the right foot.

        Returns:
            A fresh state. `left_share` is free of the sensors' zeros, `total_force` is the plain sum. While a wrench is
            stale, phase and support foot are held and share and force are NaN. In flight the support foot is the last
            one; NONE only before any foot has been seen on the ground.
        """
        if stamp_ns < self._last_ns:
            self.reset()
        dt_ns, self._last_ns = stamp_ns - self._last_ns, stamp_ns
        if left_fz is None or right_fz is None or not isfinite(left_fz + right_fz):
            return self._stale(stamp_ns)
        if self._feet is None:
            self._feet = self._start(stamp_ns, left_fz, right_fz)
        left, right = self._feet
        config = self.config
        on, off = config.contact_on * self.weight, self.lifting
        dwell_on, dwell_off = config.dwell_on * 1e9, config.dwell_off * 1e9
        changed = left.update(stamp_ns, left_fz, on, off, dwell_on, dwell_off)
        changed |= right.update(stamp_ns, right_fz, on, off, dwell_on, dwell_off)
        if changed:
            self._phase = _PHASES[left.loaded + 2 * right.loaded]
            self._began_ns = max(self._began_ns, left.since_ns, right.since_ns)
        left_load, right_load = left_fz - left.zero, right_fz - right.zero
        load = left_load + right_load
        foot, self._foot = self._foot, self._follow(stamp_ns, dt_ns, left_load - right_load, load, dwell_on)
        if self._foot is not foot:
            self._foot_ns = self._lead_ns if self._phase is Phase.DOUBLE and self._lead_ns >= 0 else self._began_ns
            self._lead_ns, self._lead = -1, _NAN
        share = min(1.0, max(0.0, left_load / load)) if load > _SHARE_FORCE * self.weight else _NAN
        return self._state(stamp_ns, share, left_fz + right_fz)

    def _stale(self, stamp_ns: int) -> SupportState:
        if self._feet is None:
            return SupportState()
        for foot in self._feet:
            foot.interrupt(stamp_ns)
        self._lead_ns, self._lead = -1, _NAN
        return self._state(stamp_ns, _NAN, _NAN)

    def _state(self, stamp_ns: int, share: float, force: float) -> SupportState:
        phase_time, foot_time = (stamp_ns - self._began_ns) * 1e-9, (stamp_ns - self._foot_ns) * 1e-9
        return SupportState(self._phase, self._foot, share, phase_time, force, foot_time)

    def _start(self, stamp_ns: int, left_fz: float, right_fz: float) -> tuple[_Contact, _Contact]:
        middle = 0.5 * (self.config.contact_on + self.config.contact_off) * self.weight
        left, right = _Contact(left_fz > middle, stamp_ns), _Contact(right_fz > middle, stamp_ns)
        self._phase = _PHASES[left.loaded + 2 * right.loaded]
        if self._phase:
            self._foot = Foot.LEFT if left_fz >= right_fz else Foot.RIGHT
        self._began_ns = self._foot_ns = stamp_ns
        return left, right

    def _follow(self, stamp_ns: int, dt_ns: int, difference: float, load: float, dwell_ns: float) -> Foot:
        """The support foot: the one on the ground, or of two the one that has carried clearly more for a while."""
        if self._phase is not Phase.DOUBLE:
            self._lead_ns, self._lead = -1, _NAN
            return _FEET[self._phase] or self._foot
        if self._foot is Foot.NONE:
            return Foot.LEFT if difference > 0.0 else Foot.RIGHT
        # Taken as linear between samples, like the thresholds of the contacts.
        before = self._lead
        ahead = difference if self._foot is Foot.RIGHT else -difference
        self._lead = lead = ahead - self.config.share_hysteresis * load
        if lead <= 0.0:
            self._lead_ns = -1
            return self._foot
        if self._lead_ns < 0:
            self._lead_ns = stamp_ns - (round(dt_ns * lead / (lead - before)) if before <= 0.0 else 0)
        return self._foot.other if stamp_ns - self._lead_ns >= dwell_ns else self._foot
