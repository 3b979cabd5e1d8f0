# SPDX-License-Identifier: BSD-3-Clause
"""Says while the robot walks that it no longer is what it was, or what it is described as: which law broke, since when.

Strides are compared with strides. Each channel of monitor/laws.py gives one value a support phase; each kind of phase
(left, right, double support after either, standing) has a level of its own, learnt by a Kalman filter while the robot
walks, and a noise of its own. How much a channel has changed in a kind is the weaker of its last two values there, in
standard deviations, if both are off their level the same way. What has *changed* in all kinds together by more than
`monitor.threshold` is told; so is what *is off* zero by as much of what healthy robots differ by, in two phases of a
kind running. A value that does not come again was noise, and is learnt as such: a stumble is no fault. A phase of other
duration, posture or motion than those of its kind before is another gait, and is learnt anew. What pushes and pulls by
turns has no level: `unsteady/x, y` tell by how much forces scatter that did not (unsteady.py). What has not been
seen for 10 s is not told any more.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..base.compiled import compiled
from ..base.types import Array, Phase, Prediction, Sample
from ..config.schema import Config
from .forces import WINDOW_NS
from .laws import BORNE_S, KINDS, Laws
from .unsteady import EVERY_NS, Unsteady

if TYPE_CHECKING:
    from ..robot.robot import Posture, Robot

_INTERVAL_NS = 10_000_000  # looks at 100 Hz: edges of phases are known as well as that
_FEWEST = 5  # looks that make a phase
_STANDS = 3  # pieces of standing, between which there were no steps
_PIECE_NS = 1_000_000_000  # double support that lasts longer is standing, told in pieces of this
_UNLIKE = 0.05, 0.15, 0.03  # [rad] joints, [1] and [s] of duration: by more than that it is another gait
_LEARNT = 2  # phases of a kind that a level is made of at least
_QUIETEST = 0.3  # of the usual noise: sensors that never vary must not make every hair's breadth a mismatch
_MEMORY = 20.0  # phases over which a level follows, and noise is known
_PRIOR = 6.0  # phases that the usual noise is worth
_STUDENT = 2.0  # by how much more spread is allowed for while few phases tell of the noise
_DOUBT = 2.5  # standard deviations beyond which a value is learnt no sooner than the next of its kind is known
_STALE = 10.0  # [s] after which a value says nothing of now: the robot stands, or tips, or has lost a sensor
_BACK = 0.75  # of the threshold: below that, what was told is over
# Rows of a channel's state: level, its variance, the phases it is made of; variance of a value, the phases it is known
# from, square of a value in doubt; what the last value was off its level by, the same in standard deviations; by how
# many of these the weaker of the last two was, with sign, and since when [s]; which way the last value was off zero;
# by how many standard deviations, with sign, and by how much two running were, and since when [s]; when the last phase
# began that told anything [s]; how much the level owes to how the robot is loaded.
_LEVEL, _VARIANCE, _COUNT, _NOISE, _KNOWN, _PENDING = range(6)
_ERROR, _LAST, _CHANGED, _SINCE, _WAY, _OFF, _VALUE, _OFF_SINCE, _WHEN, _LOADED, _ROWS = range(6, 17)
_LANDED = (Phase.LEFT, Phase.RIGHT)  # before a double support: the other foot has landed
_SHOWN = {"rad": (1e3, "mrad"), "m": (1e3, "mm"), "s": (1e3, "ms")}  # other units as they are


@dataclass(frozen=True)
class Mismatch:
    """One law that broke.

    Attributes:
        channel: its name, as in `Laws`; or `unsteady/x`, `unsteady/y`.
        phase: in which it shows most.
        size: by how much in that phase [unit]: against its own level if it has changed, else against the law.
        sigma: in standard deviations, of all kinds of phases together if it has changed.
        since_ns, told_ns: stamps at which the first phase that showed it began, and at which it was told.
        changed: it was different before.
    """

    channel: str
    phase: str
    size: float
    unit: str
    sigma: float
    since_ns: int
    told_ns: int
    changed: bool

    def __str__(self) -> str:
        factor, unit = _SHOWN.get(self.unit, (1.0, self.unit))
        how = "changed by" if self.changed else "is off by"
        return f"{self.channel} {how} {factor * self.size:+.3g} {unit} ({abs(self.sigma):.0f} sigma, {self.phase})"


class Monitor:
    """Watches one robot.

    Attributes:
        mismatches: what disagrees now, the clearest first.
        first: by channel, the mismatch as it was first told since the start.
        phases: support phases that could be compared with others of their kind.
    """

    def __init__(self, robot: Robot, config: Config) -> None:
        self.laws = Laws(robot, config)
        self._threshold = config.monitor.threshold
        self._unsteady = Unsteady(robot.mass * config.robot.gravity, self._threshold)
        self.first: dict[str, Mismatch] = {}
        self.phases = 0
        self.reset()
        names = self.laws.names
        self._feet, self._forces = (np.array([name.startswith(law) for name in names]) for law in ("feet/", "force/"))
        self._least, self._drift = (_QUIETEST * self.laws.noise) ** 2, self.laws.drift**2
        nothing = np.full(len(names), np.nan)  # compiled before the first phase ends
        _judge(
            self._state[0], nothing, nothing, nothing, self._least[0], self._drift[0], self._threshold, 0.0, self._feet
        )

    def reset(self) -> None:
        """Forget the past; what was told stays in `first`."""
        self._state = np.zeros((len(KINDS), _ROWS, len(self.laws.names)))
        self._state[:, _NOISE] = self.laws.noise**2
        self._state[:, _LAST] = np.nan
        self._usual: dict[int, Array] = {}  # by kind: duration, posture and motion
        self._seen = [0] * len(KINDS)  # phases of the gait
        self._strange = [False] * len(KINDS)  # the last phase of the kind was unlike those before it
        self._phase = self._before = Phase.FLIGHT
        self._start = self._next = self._began = self._weighed = self._stamp = 0
        self.mismatches: list[Mismatch] = []
        self._changed = np.zeros(len(self.laws.names), dtype=bool)  # channels that are told of now
        self._unsteady.reset()
        self._stood = 0  # pieces of standing in a row
        self._by_imu = False  # forces were known by an IMU
        self.laws.forces.reset()
        self.laws.begin()

    def update(self, sample: Sample, link: Posture, prediction: Prediction) -> None:
        """Take one sample, with the posture and the prediction made of it; stamps increase between resets."""
        stamp, phase = sample.stamp_ns, prediction.support.phase
        if phase is not self._phase or (phase is Phase.DOUBLE and stamp - self._began >= _PIECE_NS):
            self._close(stamp, phase)
            self._before, self._phase, self._began, self._next = self._phase, phase, stamp, stamp
            self._start = self._start or stamp
            self.laws.begin()
        since = (stamp - self._began) * 1e-9
        if since < BORNE_S and phase is Phase.DOUBLE and self._before in _LANDED:
            wrench = sample.right_wrench if self._before is Phase.LEFT else sample.left_wrench
            if wrench is not None:
                self.laws.land(since, (stamp - self._stamp) * 1e-9, wrench[2])
        self._stamp = stamp
        if stamp < self._next or phase is Phase.FLIGHT or sample.left_wrench is None or sample.right_wrench is None:
            return
        self._next = stamp + _INTERVAL_NS
        self.laws.look(sample, link, prediction)
        if stamp >= self._weighed + EVERY_NS:
            self._weighed = stamp
            if self.laws.forces.by_imu:  # soles that rock look like pushes
                force = self.laws.forces.over(stamp - WINDOW_NS, stamp)
                self._unsteady.take((stamp - self._start) * 1e-9, force, self.laws.forces.heading)

    def _close(self, stamp: int, after: Phase) -> None:
        """A phase has ended, or a piece of standing, and another one begins."""
        if self.laws.looks < _FEWEST:
            return
        kind = int(self._phase) - 1
        if self._phase is Phase.DOUBLE:
            kind = 1 + int(self._before) if self._before in _LANDED else 4
            if kind < 4 and after is self._before:  # the foot touched the ground, and was lifted again
                return
        self._stood = self._stood + 1 if kind == 4 else 0
        if self._stood >= _STANDS:
            self._unsteady.reset()
        values, healthy, loaded, joints = self.laws.mean(kind)
        alike = self._alike(kind, np.append((stamp - self._began) * 1e-9, joints))
        self.phases += alike
        if self.laws.forces.by_imu != self._by_imu:  # an IMU sits a little otherwise than told
            self._by_imu = self.laws.forces.by_imu
            self._forget(self._forces)
            self._unsteady.reset()
        began, state = (self._began - self._start) * 1e-9, self._state[kind]
        drift = np.where(self._changed, 0.0, self._drift[kind])  # what has been told is no drift
        comparable = self.laws.any_gait | alike
        _judge(state, values, healthy, loaded, self._least[kind], drift, self._threshold, began, comparable)
        self._tell(stamp)

    def _alike(self, kind: int, like: Array) -> bool:
        """Whether a phase of that duration [s], posture and motion [rad] can be compared with those before it."""
        usual, count = self._usual.get(kind, like), self._seen[kind]
        off, (angle, share, seconds) = np.abs(like - usual), _UNLIKE
        if off[1:].max() > angle or off[0] > share * usual[0] + seconds:
            again, self._strange[kind] = self._strange[kind], True
            if count > 1 and not again:
                return False
            # The noise stays, the level is another one.
            self._forget(~self.laws.any_gait, kind)
            usual, count = like, 0
        self._strange[kind], self._seen[kind] = False, count + 1
        self._usual[kind] = usual + (like - usual) / min(count + 1.0, _MEMORY)
        return True

    def _forget(self, which: NDArray[np.bool_], kind: int | slice = slice(None)) -> None:
        """Levels of channels (n,), which are other ones now; noise stays."""
        for row in (_LEVEL, _VARIANCE, _COUNT, _PENDING, _CHANGED, _LAST):
            self._state[kind, row, which] = np.nan if row == _LAST else 0.0

    def _tell(self, stamp: int) -> None:
        laws, threshold, state = self.laws, self._threshold, self._state
        oldest = (stamp - self._start) * 1e-9 - _STALE
        fresh = state[:, _WHEN] > oldest
        changed, off = np.abs(state[:, _CHANGED]) * fresh, np.abs(state[:, _OFF]) * fresh
        # Feet that tip do so against each other in the two double supports, which is no evidence twice, and no fault in
        # a gait that always did; by an encoder's fault they are off the same way.
        tips = self._feet & (state[2] * state[3] <= 0.0)  # by row
        strength = np.where(tips[_CHANGED], changed.max(axis=0), np.sqrt((changed**2).sum(axis=0)))
        told = self._changed = strength > np.where(self._changed, _BACK * threshold, threshold)
        found = []
        for i in np.flatnonzero(told | (off[4] > 0.0) | (off.any(axis=0) & ~tips[_OFF])):
            size, rows, since = (changed, (_ERROR, _CHANGED), _SINCE) if told[i] else (off, (_VALUE, _OFF), _OFF_SINCE)
            kind = int(np.argmax(size[:, i]))
            value, sigma = state[kind, rows, i]
            began = state[size[:, i] > 0.5 * size[kind, i], since, i].min()
            sigma = np.sign(sigma) * strength[i] if told[i] else sigma
            found.append((laws.names[i], KINDS[kind], value, laws.units[i], sigma, began, bool(told[i])))
        if self._unsteady.seen > oldest:
            for push in self._unsteady.told:
                name = f"unsteady/{'xy'[push.axis]}"
                found.append((name, "all phases", push.size, "N", push.sigma, push.since, True))
        found.sort(key=lambda each: -abs(each[4]))
        self.mismatches = [
            Mismatch(name, phase, float(value), unit, float(sigma), self._start + round(1e9 * began), stamp, changed)
            for name, phase, value, unit, sigma, began, changed in found
        ]
        for each in self.mismatches:
            self.first.setdefault(each.channel, each)


@compiled
def _judge(
    s: Array,
    values: Array,
    healthy: Array,
    loaded: Array,
    least: Array,
    drift: Array,
    threshold: float,
    began: float,
    alike: NDArray[np.bool_],
) -> None:
    """Compare the values (n,) of a phase with those before, and learn from them.

    Args:
        s: (rows, n) state of the channels in that kind of phase.
        values: NaN: nothing known.
        healthy: (n,) variance over healthy robots; 0: not known.
        loaded: (n,) what healthy robots usually owe to how they are loaded: another load is another level.
        least: (n,) variance below which no noise is believed.
        drift: (n,) variance by which levels wander from phase to phase.
        threshold: standard deviations.
        began: when the phase began [s].
        alike: (n,) which can be compared with those before; the others are held against zero alone.
    """
    for i in range(values.shape[0]):
        value, noise = values[i], s[_NOISE, i]
        if np.isnan(value):
            continue
        s[_WHEN, i] = began
        if healthy[i] > 0.0:
            off = value / np.sqrt(healthy[i] + noise)
            way = np.sign(off) if abs(off) > threshold else 0.0
            if way != 0.0 and way == s[_WAY, i]:
                s[_OFF, i], s[_VALUE, i] = off, value
            elif abs(off) < 0.5 * threshold or off * s[_OFF, i] < 0.0:
                s[_OFF, i] = 0.0
            if way != s[_WAY, i] and s[_OFF, i] == 0.0:
                s[_OFF_SINCE, i] = began
            s[_WAY, i] = way
        if not alike[i]:
            continue
        if s[_COUNT, i] == 0.0:
            s[_LEVEL, i], s[_VARIANCE, i], s[_COUNT, i] = value, noise * (1.0 + 1.0 / _MEMORY**2) + drift[i], 1.0
            s[_LOADED, i] = loaded[i]
            continue
        error = s[_ERROR, i] = value - s[_LEVEL, i]
        known = (s[_VARIANCE, i] + noise) * (1.0 + _STUDENT / (1.0 + s[_KNOWN, i]))
        load = (loaded[i] - s[_LOADED, i]) ** 2
        sigma = error / np.sqrt(known + load)
        # Under another load, little is learnt of noise and level.
        square = (min(abs(sigma), threshold) ** 2 - 1.0) * known / (known + load)
        pending, doubtful = s[_PENDING, i], False  # what is known now to have been noise
        if s[_COUNT, i] >= _LEARNT:
            last = s[_LAST, i]
            again = sigma * last > 0.0
            s[_CHANGED, i] = np.sign(sigma) * min(abs(sigma), abs(last)) if again else 0.0
            if abs(sigma) > 1.0 and not (again and abs(last) > 1.0):
                s[_SINCE, i] = began
            s[_LAST, i], doubtful = sigma, abs(sigma) > _DOUBT
            s[_PENDING, i] = 0.0
            if doubtful:
                s[_PENDING, i] = square
                if again:
                    pending = 0.0  # no noise: it came again
                square = 0.0
        if not doubtful:
            s[_KNOWN, i] += 1.0
        if not doubtful or pending > 0.0:
            share = (square + pending) / (_PRIOR + min(s[_KNOWN, i], _MEMORY))
            noise = s[_NOISE, i] = max(least[i], noise * (1.0 + share))
        if doubtful:
            s[_VARIANCE, i] += drift[i]
        else:
            gain = s[_VARIANCE, i] / (s[_VARIANCE, i] + noise + load)
            s[_LEVEL, i] += gain * error
            s[_LOADED, i] += gain * (loaded[i] - s[_LOADED, i])
            s[_VARIANCE, i] = gain * (noise + load) + noise / _MEMORY**2 + drift[i]
            s[_COUNT, i] += 1.0
