# SPDX-License-Identifier: BSD-3-Clause
"""Says while the robot walks that it no longer is what it was, or what it is described as: which law broke, since when.

Strides are compared with strides. Each channel of core/laws.py gives one value a support phase; each kind of phase
(left, right, double support after either, standing) has a level of its own, learnt by a Kalman filter while the robot
walks, and a noise of its own. A value that is off its level by more than `monitor.threshold` standard deviations, in
two phases of a kind running and the same way, has *changed*; one that is off zero by as much of what healthy robots
differ by *is off*. One that does not come again was noise, and is learnt as such: a stumble is no fault. A phase of
other duration, posture or motion than those of its kind before is another gait, and is learnt anew.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .compiled import compiled
from .config import Config
from .laws import BORNE_S, KINDS, Laws
from .types import Array, Phase, Prediction, Sample

if TYPE_CHECKING:
    from .robot import Posture, Robot

_INTERVAL_NS = 10_000_000  # looks at 100 Hz: edges of phases are known as well as that
_FEWEST = 5  # looks that make a phase
_PIECE_NS = 1_000_000_000  # double support that lasts longer is standing, told in pieces of this
_UNLIKE = 0.05, 0.15, 0.03  # [rad] joints, [1] and [s] of duration: by more than that it is another gait
_LEARNT = 2  # phases of a kind that a level is made of at least
_QUIETEST = 0.3  # of the usual noise: sensors that never vary must not make every hair's breadth a mismatch
_MEMORY = 20.0  # phases over which a level follows, and noise is known
_PRIOR = 6.0  # phases that the usual noise is worth
_STUDENT = 4.0  # by how much more spread is allowed for while few phases tell of the noise
# Rows of a channel's state: level, its variance, the phases it is made of; variance of a value, the phases it is known
# from; square of a value in doubt. Then, for changed and for off: which way the last value was off, whether that is a
# mismatch, its size and the same in standard deviations. When it began [s].
_LEVEL, _VARIANCE, _COUNT, _NOISE, _KNOWN, _DOUBT = range(6)
_WAY, _BAD, _SIZE, _SIGMA, _SINCE, _ROWS = 6, 8, 10, 12, 14, 15
_LANDED = (Phase.LEFT, Phase.RIGHT)  # before a double support: the other foot has landed
_SHOWN = {"rad": (1e3, "mrad"), "m": (1e3, "mm"), "N": (1.0, "N"), "Nm": (1.0, "Nm"), "Ns": (1.0, "Ns")}


@dataclass(frozen=True)
class Mismatch:
    """One law that broke.

    Attributes:
        channel: its name, as in `Laws`.
        phase: in which it shows most.
        size: by how much [unit]: against its own level if it has changed, else against the law.
        sigma: size in standard deviations.
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
        factor, unit = _SHOWN[self.unit]
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
        self.first: dict[str, Mismatch] = {}
        self.phases = 0
        self.reset()
        nothing = np.full(len(self.laws.names), np.nan)
        self._least = (_QUIETEST * self.laws.noise) ** 2
        _judge(
            self._state[0], nothing, nothing, self._least[0], self._threshold, 0.0
        )  # compiled before the first phase ends

    def reset(self) -> None:
        """Forget the past; what was told stays in `first`."""
        self._state = np.zeros((len(KINDS), _ROWS, len(self.laws.names)))
        self._state[:, _NOISE] = self.laws.noise**2
        self._usual: dict[int, Array] = {}  # by kind: duration, posture and motion
        self._strange = [False] * len(KINDS)  # the last phase of the kind was unlike those before it
        self._began_before = [0.0] * len(KINDS)  # [s]
        self._phase = self._before = Phase.FLIGHT
        self._start = self._next = self._began = self._first = self._last = self._stamp = 0
        self.mismatches: list[Mismatch] = []
        self.laws.begin()

    def update(self, sample: Sample, link: Posture, prediction: Prediction) -> None:
        """Take one sample, with the posture and the prediction made of it; stamps increase between resets."""
        stamp, phase = sample.stamp_ns, prediction.support.phase
        if phase is not self._phase or (phase is Phase.DOUBLE and stamp - self._began >= _PIECE_NS):
            self._close(stamp)
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
        self._next, self._last = stamp + _INTERVAL_NS, stamp
        if not self.laws.looks:
            self._first = stamp
        self.laws.look(sample, link, prediction)

    def _close(self, stamp: int) -> None:
        """A phase has ended, or a piece of standing."""
        if self.laws.looks < _FEWEST:
            return
        kind = int(self._phase) - 1
        if self._phase is Phase.DOUBLE:
            kind = 1 + int(self._before) if self._before in _LANDED else 4
        values, healthy, joints = self.laws.mean(kind, (self._last - self._first) * 1e-9)
        if not self._alike(kind, np.append((stamp - self._began) * 1e-9, joints)):
            return
        self.phases += 1
        began = (self._began - self._start) * 1e-9
        before = self._began_before[kind]
        if _judge(self._state[kind], values, healthy, self._least[kind], self._threshold, before) or self.mismatches:
            self._tell(stamp)
        self._began_before[kind] = began

    def _alike(self, kind: int, like: Array) -> bool:
        """Whether a phase of that duration [s], posture and motion [rad] can be compared with those before it."""
        usual, count = self._usual.get(kind, like), float(self._state[kind, _COUNT].max())
        off, (angle, share, seconds) = np.abs(like - usual), _UNLIKE
        if off[1:].max() > angle or off[0] > share * usual[0] + seconds:
            again, self._strange[kind] = self._strange[kind], True
            if count > 1.0 and not again:
                return False
            # The noise stays, the level is another one.
            self._state[kind, [_LEVEL, _VARIANCE, _COUNT, _DOUBT, _WAY, _WAY + 1, _BAD, _BAD + 1]] = 0.0
            usual, count = like, 0.0
        self._strange[kind] = False
        self._usual[kind] = usual + (like - usual) / min(count + 1.0, _MEMORY)
        return True

    def _tell(self, stamp: int) -> None:
        found, state = [], self._state
        for i in np.flatnonzero(state[:, _BAD : _BAD + 2].any(axis=(0, 1))):
            which = 0 if state[:, _BAD, i].any() else 1
            bad = state[:, _BAD + which, i] > 0.0
            kind = int(np.argmax(bad * np.abs(state[:, _SIGMA + which, i])))
            size, sigma = float(state[kind, _SIZE + which, i]), float(state[kind, _SIGMA + which, i])
            since = self._start + round(1e9 * float(state[bad, _SINCE, i].min()))
            laws = self.laws
            found.append(Mismatch(laws.names[i], KINDS[kind], size, laws.units[i], sigma, since, stamp, which == 0))
        self.mismatches = sorted(found, key=lambda each: -abs(each.sigma))
        for each in self.mismatches:
            self.first.setdefault(each.channel, each)


@compiled
def _judge(s: Array, values: Array, healthy: Array, least: Array, threshold: float, before: float) -> bool:
    """Compare the values (n,) of a phase with those before, and learn from them.

    Args:
        s: (rows, n) state of the channels in that kind of phase.
        values: NaN: nothing known.
        healthy: (n,) variance over healthy robots; 0: not known.
        least: (n,) variance below which no noise is believed.
        threshold: standard deviations.
        before: when the phase of that kind before this one began [s].

    Returns:
        Whether anything is a mismatch.
    """
    found = False
    for i in range(values.shape[0]):
        value = values[i]
        if np.isnan(value):
            continue
        noise, learnt = s[_NOISE, i], s[_COUNT, i] >= _LEARNT
        error = value - s[_LEVEL, i]
        sigma = error / np.sqrt((s[_VARIANCE, i] + noise) * (1.0 + _STUDENT / (1.0 + s[_KNOWN, i])))
        for which in range(2):
            size = error if which == 0 else value
            z = sigma if which == 0 else value / np.sqrt(healthy[i] + noise)
            applies = learnt if which == 0 else healthy[i] > 0.0
            way = np.sign(z) if applies and abs(z) > threshold else 0.0
            if way != 0.0 and way == s[_WAY + which, i]:
                if s[_BAD, i] == 0.0 and s[_BAD + 1, i] == 0.0:
                    s[_SINCE, i] = before
                s[_BAD + which, i], s[_SIZE + which, i], s[_SIGMA + which, i] = 1.0, size, z
            elif abs(z) < 0.5 * threshold:
                s[_BAD + which, i] = 0.0
            s[_WAY + which, i] = way
            found |= s[_BAD + which, i] > 0.0
        if s[_COUNT, i] == 0.0:
            s[_LEVEL, i], s[_VARIANCE, i], s[_COUNT, i] = value, noise * (1.0 + 1.0 / _MEMORY**2), 1.0
            continue
        if learnt and abs(sigma) > threshold:  # in doubt until the next phase of this kind
            s[_DOUBT, i] = sigma * sigma
            continue
        s[_KNOWN, i] += 1.0
        square = min(abs(sigma), threshold) ** 2 - 1.0 + s[_DOUBT, i]
        s[_NOISE, i] = max(least[i], s[_NOISE, i] * (1.0 + square / (_PRIOR + min(s[_KNOWN, i], _MEMORY))))
        s[_DOUBT, i] = 0.0
        if not learnt or abs(sigma) <= 0.5 * threshold:
            gain = s[_VARIANCE, i] / (s[_VARIANCE, i] + noise)
            s[_LEVEL, i] += gain * error
            s[_VARIANCE, i] = (gain + 1.0 / _MEMORY**2) * noise
            s[_COUNT, i] += 1.0
    return found
