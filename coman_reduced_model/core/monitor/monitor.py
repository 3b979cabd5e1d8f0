# SPDX-License-Identifier: BSD-3-Clause
"""Online change detection on mechanical residuals: which law no longer holds, and since when.

Each channel (channels.py) gives one value a support phase. Each kind of phase (left, right, double support after
either, standing) has its own level, which a Kalman filter learns while the robot walks, and its own noise (levels.py).
The change of a channel in a kind is that of its last deviations from the level, two or more, if all have the same
sign. A channel is reported as *changed* if its change over all kinds together exceeds
`monitor.threshold`, and as *off* if two values in a row of one kind are as far from zero, relative to the scatter of
nominal robots. A single outlier counts as noise, so a stumble is no mismatch. A phase whose duration, posture or motion
differs from those of its kind before belongs to another gait, and levels are learnt again. An intermittent force has no
level: `unsteady/x, y` report by how much the scatter of the residual force has grown (unsteady.py). A mismatch that has
not been seen for 10 s is dropped.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.types import Array, Phase, Prediction, Sample
from ..config.schema import Config
from ..measured.sensor_zeros import SensorZeros
from .channels import AFTER_LEFT, AFTER_RIGHT, KINDS, STANDING, of_laws
from .forces import WINDOW_NS
from .laws import LANDED_S, Laws, PhaseMean
from .levels import CHANNEL, noise_by_law, update_channels
from .unsteady import INTERVAL_NS, IntermittentForces

if TYPE_CHECKING:
    from ..robot.robot import Posture, Robot

_LOOK_NS = 9_000_000  # shortest time between looks, so that of 5 or 10 ms with jitter none is left out
_MIN_LOOKS = 5  # of a phase
_STANDING_PIECES = 3  # pieces of standing in a row after which steps are over
_PIECE_NS = 1_000_000_000  # longer double support is standing, in pieces of this length
_UNLIKE = 0.05, 0.15, 0.03  # [rad] joints, share and [s] of duration: a larger difference is another gait
_GAIT_MEMORY = 20.0  # phases over which duration and posture of a gait are averaged
STALE_S = 10.0  # [s] after which a value is dropped: the robot stands, or tips, or has lost a sensor
_RELEASE = 0.75  # of the threshold: below it, a reported change is over
# Fields of `CHANNEL` with size, sigma and onset of a mismatch.
_CHANGE_FIELDS = "error", "change_sigma", "change_onset"
_OFFSET_FIELDS = "offset", "offset_sigma", "offset_onset"
_LANDINGS = (Phase.LEFT, Phase.RIGHT)  # before a double support: the other foot has landed
_SHOWN = {"rad": (1e3, "mrad"), "m": (1e3, "mm"), "s": (1e3, "ms")}  # other units as they are


@dataclass(frozen=True)
class Mismatch:
    """One law that does not hold.

    Attributes:
        channel: its name, as in `Laws`; or `unsteady/x`, `unsteady/y`.
        phase: kind of phase with the largest deviation.
        size: deviation there [unit], from the level if `changed`, else from what is usual: zero, without a baseline.
        sigma: in standard deviations; over all kinds of phases together if `changed`.
        onset_ns: onset stamp: start of the first phase with the deviation.
        detected_ns: detection stamp.
        changed: the level has changed; else the residual is off zero.
    """

    channel: str
    phase: str
    size: float
    unit: str
    sigma: float
    onset_ns: int
    detected_ns: int
    changed: bool

    def __str__(self) -> str:
        factor, unit = _SHOWN.get(self.unit, (1.0, self.unit))
        how = "changed by" if self.changed else "is off by"
        return f"{self.channel} {how} {factor * self.size:+.3g} {unit} ({abs(self.sigma):.0f} sigma, {self.phase})"


class _Evidence(NamedTuple):
    """What speaks for mismatches now, by kind and channel."""

    change: Array  # (kinds, n) magnitude of `change_sigma`, 0 where stale
    offset: Array  # (kinds, n) magnitude of `offset_sigma`, 0 where stale
    strength: Array  # (n,) change over all kinds together
    changed: NDArray[np.bool_]  # (n,) to be reported as changed
    off: NDArray[np.bool_]  # (n,) to be reported as off zero, unless changed


class Monitor:
    """Watches one robot.

    Attributes:
        mismatches: present ones, the strongest first.
        first: by channel, the first mismatch since the start.
        phases: support phases that were compared with others of their kind.
        laws: residuals of the current phase.
        kept: if a list, each phase is appended: its kind, (n,) values, NaN where they are those of another gait, which
            of them are tested against zero, and the load.
    """

    def __init__(self, robot: Robot, config: Config, zeros: SensorZeros | None = None) -> None:
        """Zeros: what is taken off the foot wrenches of its samples; while that changes, their laws say nothing."""
        self.laws = Laws(robot, config)
        self._zeros = zeros or SensorZeros(self.laws.forces.memory.weight)
        self._threshold = config.monitor.threshold
        self._intermittent = IntermittentForces(self.laws.noise_of_forces, self._threshold)
        self.first: dict[str, Mismatch] = {}
        self.kept: list[tuple[int, Array, NDArray[np.bool_], Array]] | None = None
        self.phases = 0
        self.reset()
        names = self.laws.names
        self._feet, self._forces = of_laws(names, ("feet",)), of_laws(names, ("force",))
        self._unloaded = of_laws(names, ("unloaded",))
        unknown = np.full(len(names), np.nan)  # compiled before the first phase ends
        nothing = PhaseMean(unknown, unknown, unknown, unknown)
        self._update_channels(0, nothing, self._feet, 0.0)

    def change_threshold(self, threshold: float) -> None:
        """Take over another `monitor.threshold`; what was learnt is kept."""
        self._threshold = threshold
        self._intermittent.threshold = threshold

    def reset(self) -> None:
        """Forget the past, except for `first`."""
        self._channels = np.zeros((len(KINDS), len(self.laws.names)), dtype=CHANNEL)
        self._channels["error_sigma"] = np.nan
        self._noise = noise_by_law(self.laws)
        self._gait: dict[int, Array] = {}  # by kind: mean duration, posture and motion
        self._gait_phases = [0] * len(KINDS)
        self._last_unlike = [False] * len(KINDS)  # the last phase of the kind was unlike those before it
        self._phase = self._phase_before = Phase.FLIGHT
        self._start_ns = self._phase_start_ns = 0  # of the walk, of the phase
        self._last_ns = self._next_look_ns = self._last_window_ns = self._reported_ns = 0
        self.mismatches: list[Mismatch] = []
        self._changed = np.zeros(len(self.laws.names), dtype=bool)  # channels reported as changed
        self._intermittent.reset()
        self._standing_pieces = 0  # in a row
        self._used_imu = False  # for the force balance of the last phase
        self._had_torques: bool | None = None  # for the spring laws of the last phase
        self.laws.forces.reset()
        self._begin_phase()

    def interrupt(self) -> None:
        """A short gap: forget the phase under way; levels and what is reported are kept."""
        self._phase = self._phase_before = Phase.FLIGHT
        self._next_look_ns = self._last_window_ns = 0
        self._standing_pieces = 0
        self._intermittent.reset()
        self._begin_phase()

    def _begin_phase(self) -> None:
        self.laws.begin()
        self._zeros_before = self._zeros.both

    def update(self, sample: Sample, link: Posture, prediction: Prediction) -> None:
        """Take one sample, with the posture and the prediction made of it; stamps increase between resets."""
        stamp, phase = sample.stamp_ns, prediction.support.phase
        is_piece = phase is Phase.DOUBLE and stamp - self._phase_start_ns >= _PIECE_NS
        if phase is not self._phase or is_piece:
            self._end_phase(stamp, phase)
            self._phase_before, self._phase = self._phase, phase
            self._phase_start_ns = self._next_look_ns = stamp
            self._start_ns = self._start_ns or stamp
            self._begin_phase()
        if self.mismatches and stamp - self._reported_ns >= _PIECE_NS:  # no phase may end for long
            self._report(stamp)
        if phase is Phase.DOUBLE and self._phase_before in _LANDINGS:
            self._update_landing(sample)
        self._last_ns = stamp
        if phase is Phase.FLIGHT or sample.left_wrench is None or sample.right_wrench is None:
            return
        if stamp < self._next_look_ns:
            self.laws.feel(sample)
            return
        self._next_look_ns = stamp + _LOOK_NS
        self.laws.look(sample, link, prediction)
        if stamp >= self._last_window_ns + INTERVAL_NS:
            self._last_window_ns = stamp
            if self.laws.forces.uses_imu:  # without one, soles that rock look like external forces
                force = self.laws.forces.residual(stamp - WINDOW_NS, stamp)
                self._intermittent.update(self._seconds(stamp), force, self.laws.forces.heading)

    def _update_landing(self, sample: Sample) -> None:
        """Take the force on the foot that has just landed."""
        since = (sample.stamp_ns - self._phase_start_ns) * 1e-9
        wrench = sample.right_wrench if self._phase_before is Phase.LEFT else sample.left_wrench
        if since < LANDED_S and wrench is not None:
            self.laws.land(since, (sample.stamp_ns - self._last_ns) * 1e-9, wrench[2])

    def _seconds(self, stamp_ns: int) -> float:
        """Time since the start of the walk [s]."""
        return (stamp_ns - self._start_ns) * 1e-9

    def _end_phase(self, stamp: int, after: Phase) -> None:
        """A phase, or a piece of standing, has ended."""
        if self.laws.looks < _MIN_LOOKS:
            return
        kind = self._kind()
        if kind in (AFTER_LEFT, AFTER_RIGHT) and after is self._phase_before:  # the foot was lifted again
            return
        self._standing_pieces = self._standing_pieces + 1 if kind == STANDING else 0
        if self._standing_pieces >= _STANDING_PIECES:
            self._intermittent.reset()
        mean = self.laws.mean(kind)
        if self.laws.wrenches_moved(self._zeros.both - self._zeros_before):
            self._forget(mean, self.laws.by_wrenches)
            self._intermittent.reset()
        same_gait = self._same_gait(kind, np.append((stamp - self._phase_start_ns) * 1e-9, mean.posture))
        self.phases += same_gait
        if self.laws.forces.uses_imu != self._used_imu:  # its mounting differs a little from the URDF
            self._used_imu = self.laws.forces.uses_imu
            self._forget_levels(self._forces)
            self._intermittent.reset()
        if self.laws.torques_known is not self._had_torques:  # the springs' laws are others without
            if self._had_torques is not None:
                self._forget(mean, self.laws.of_springs)
            self._had_torques = self.laws.torques_known
        comparable = self.laws.gait_independent | same_gait
        if self.kept is not None:
            self.kept.append((kind, np.where(comparable, mean.values, np.nan), mean.variance > 0.0, mean.load))
        self._update_channels(kind, mean, comparable, self._seconds(self._phase_start_ns))
        self._report(stamp)

    def _kind(self) -> int:
        """Index in KINDS of the current phase."""
        if self._phase is not Phase.DOUBLE:
            return int(self._phase) - 1
        return 1 + int(self._phase_before) if self._phase_before in _LANDINGS else STANDING

    def _update_channels(self, kind: int, mean: PhaseMean, comparable: NDArray[np.bool_], start: float) -> None:
        drift = np.where(self._changed, 0.0, self.laws.drift)  # a reported change is no drift
        update_channels(
            self._channels[kind], *self._noise, mean, comparable, self.laws.noise[kind], drift, self.laws.by_load,
            self._threshold, start,
        )  # fmt: skip

    def _same_gait(self, kind: int, features: Array) -> bool:
        """Whether a phase with that duration [s], posture and motion [rad] belongs to the gait before it."""
        mean, count = self._gait.get(kind, features), self._gait_phases[kind]
        difference, (angle, share, seconds) = np.abs(features - mean), _UNLIKE
        if difference[1:].max() > angle or difference[0] > share * mean[0] + seconds:
            twice, self._last_unlike[kind] = self._last_unlike[kind], True
            if count > 1 and not twice:
                return False
            self._forget_levels(~self.laws.gait_independent, kind)
            mean, count = features, 0
        self._last_unlike[kind], self._gait_phases[kind] = False, count + 1
        self._gait[kind] = mean + (features - mean) / min(count + 1.0, _GAIT_MEMORY)
        return True

    def _forget(self, mean: PhaseMean, which: NDArray[np.bool_]) -> None:
        """Channels (n,) become others in this phase: its mean and all before say nothing of them."""
        mean.values[which] = np.nan
        self._forget_levels(which)
        self._channels["offset_sigma"][:, which] = 0.0

    def _forget_levels(self, which: NDArray[np.bool_], kind: int | slice = slice(None)) -> None:
        """Forget the levels of channels (n,); their noise stays."""
        for field in ("level", "level_share", "level_phases", "pending", "change_sigma"):
            self._channels[field][kind, which] = 0.0
        self._channels["error_sigma"][kind, which] = np.nan

    def _report(self, stamp: int) -> None:
        """Update `mismatches` and `first`."""
        self._reported_ns = stamp
        oldest = self._seconds(stamp) - STALE_S
        evidence = self._evidence(oldest)
        self._changed = evidence.changed
        found = [self._mismatch(int(i), evidence, stamp) for i in np.flatnonzero(evidence.changed | evidence.off)]
        if self._intermittent.last > oldest:
            for force in self._intermittent.forces:
                onset = self._start_ns + round(1e9 * force.onset)
                channel = f"unsteady/{'xy'[force.axis]}"
                found.append(Mismatch(channel, "all phases", force.size, "N", force.ratio, onset, stamp, True))
        self.mismatches = sorted(found, key=lambda each: -abs(each.sigma))
        for each in self.mismatches:
            self.first.setdefault(each.channel, each)

    def _evidence(self, oldest: float) -> _Evidence:
        """Of phases that began after `oldest` [s]."""
        channels = self._channels
        recent = channels["last_phase"] > oldest
        change, offset = np.abs(channels["change_sigma"]) * recent, np.abs(channels["offset_sigma"]) * recent
        # A robot on the edges of its soles has errors of `feet` with opposite signs in the two double supports, which
        # is no evidence twice, and no fault in a gait that always did; an encoder error has the same sign in both.
        strength = np.where(self._opposite("change_sigma"), change.max(axis=0), np.sqrt((change**2).sum(axis=0)))
        changed = strength > np.where(self._changed, _RELEASE * self._threshold, self._threshold)
        off = (offset[STANDING] > 0.0) | (offset.any(axis=0) & ~self._opposite("offset_sigma"))
        if not self._zeros.settled:  # large zeros are going to be found, taken off and reported
            off &= ~self._unloaded
        return _Evidence(change, offset, strength, changed, off)

    def _opposite(self, field: str) -> NDArray[np.bool_]:
        """Channels (n,) `feet` whose field does not have the same sign in both double supports."""
        values = self._channels[field]
        return np.asarray(self._feet & (values[AFTER_LEFT] * values[AFTER_RIGHT] <= 0.0))

    def _mismatch(self, i: int, evidence: _Evidence, stamp: int) -> Mismatch:
        """The mismatch of channel i."""
        changed = bool(evidence.changed[i])
        magnitudes = (evidence.change if changed else evidence.offset)[:, i]
        size, sigma, onset = _CHANGE_FIELDS if changed else _OFFSET_FIELDS
        kind = int(np.argmax(magnitudes))
        worst = self._channels[kind, i]
        first = self._channels[onset][magnitudes > 0.5 * magnitudes[kind], i].min()
        return Mismatch(
            self.laws.names[i],
            KINDS[kind],
            float(worst[size]),
            self.laws.units[i],
            float(np.sign(worst[sigma]) * evidence.strength[i] if changed else worst[sigma]),
            self._start_ns + round(1e9 * first),
            stamp,
            changed,
        )
