# SPDX-License-Identifier: BSD-3-Clause
"""One input stream: which stamps it accepts, and the messages that wait to be joined.

A stream judges its stamps by its own past alone. What other streams do cannot change the verdict, so that the
order in which the streams arrive cannot either.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from ..base.compiled import compiled
from ..base.types import Array, Integers

# No stream of a robot has this many messages in flight; it only bounds the memory of a stream that nobody joins.
CAPACITY = 8192

# No angle, speed, force or moment of a robot is that large in SI units; what is, is garbage that happens to be finite.
LIMIT = 1e9

Item = tuple[int, Any]


@compiled
def usable(array: Array) -> bool:
    """Whether all values are finite and their norm below LIMIT."""
    total = 0.0
    for value in array.flat:
        total += value * value
    return total < LIMIT * LIMIT


def fault(value: float) -> str:
    """Why a value is not usable: the reason for the counter."""
    return "out_of_range" if math.isfinite(value) else "nan"


class Refused(Exception):
    """A message that cannot be used: a reason for the counter and a sentence for people."""

    def __init__(self, reason: str, sentence: str) -> None:
        super().__init__(sentence)
        self.reason = reason


class Rejections:
    """What was not used and why, counted by "stream/reason", with the last sentence for each."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self.last: dict[str, str] = {}

    def add(self, stream: str, reason: str, sentence: str) -> None:
        """Count one rejected message."""
        key = f"{stream}/{reason}"
        self.counts[key] += 1
        self.last[key] = f"{stream}: {sentence}"


class Stream:
    """Accepted messages of one topic, in the order of their stamps.

    Attributes:
        items: (stamp_ns, value) that may still be needed, oldest first.
        last: newest accepted stamp [ns]; None before the first.
        jumped: `accept` found that the clock went back (bag loop, restarted driver); the joiner clears it.
        late: by how much its stamps are later than the truth [ns]; taken off the stamp of each message.
        received, accepted: numbers of messages.
        overdue: how many of the accepted came when the samples of their stamps had gone without them.
        margin: how much older than a sample a message may come [ns]; more where nothing waits for it.
        went_back: its clock went back, that of the joint states not yet; the joiner clears it.
        period_s: smoothed interval of the accepted stamps; NaN before there are two.
    """

    def __init__(self, name: str, max_age_s: float, jump_s: float, rejections: Rejections) -> None:
        self.name = name
        self.max_age = round(max_age_s * 1e9)
        self._jump = round(jump_s * 1e9)
        self._rejections = rejections
        self.items: deque[Item] = deque(maxlen=CAPACITY)
        self.last: int | None = None
        self.late = self.margin = 0
        self.jumped = self.went_back = False
        self._suspect: Item | None = None
        self.received = self.accepted = self.overdue = 0
        self.period_s = float("nan")

    def start_afresh(self) -> None:
        """Drop what belongs to a run that is over. A suspect is the first message of the new one."""
        self.items.clear()
        suspect, self._suspect, self.last = self._suspect, None, None
        if suspect is not None:
            self.items.extend(self.accept(*suspect))

    def true_stamp(self, stamp: int) -> int:
        """The stamp without what is known to be late [ns]; one that is not filled in stays so."""
        return stamp - self.late if stamp > 0 else stamp

    def accept(self, stamp: int, value: Any) -> tuple[Item, ...]:
        """The messages that this one makes usable: itself, none, or itself and the suspect before it.

        A stamp that jumps by more than `jump_s` is suspect until the next message of the stream follows it: one wild
        stamp is rejected and changes nothing, a real gap or a clock that was set back costs one message of delay.
        """
        last, suspect = self.last, self._suspect
        if suspect is None and last is not None and last < stamp <= last + self._jump:
            self.last = stamp
            self.accepted += 1
            dt = (stamp - last) * 1e-9
            self.period_s = dt if self.period_s != self.period_s else self.period_s + 0.05 * (dt - self.period_s)
            return ((stamp, value),)
        return self._accept_unusual(stamp, value)

    def follows(self, stamps: Integers) -> bool:
        """Whether `accept` would take messages with these stamps one after the other, and nothing else."""
        if self._suspect is not None or self.jumped or not stamps[0] > 0:
            return False
        steps = np.diff(stamps) if self.last is None else np.diff(stamps, prepend=self.last)
        return bool((steps > 0).all() and (steps <= self._jump).all())

    def accept_all(self, stamps: Integers) -> None:
        """`accept` for messages that follow: the stream counts them, its items are those of the caller to add."""
        steps = np.diff(stamps) if self.last is None else np.diff(stamps, prepend=self.last)
        self.period_s = smoothed(self.period_s, steps * 1e-9)
        self.last = int(stamps[-1])
        self.accepted += len(stamps)
        self.received += len(stamps)

    def _accept_unusual(self, stamp: int, value: Any) -> tuple[Item, ...]:
        if stamp <= 0:
            self._reject("zero_stamp", f"stamp {stamp * 1e-9:.9g} s: the header is not filled in")
            return ()
        last, suspect = self.last, self._suspect
        if last is None:
            self.last = stamp
            self.accepted += 1
            return ((stamp, value),)
        if suspect is None:
            return self._accept_after(last, stamp, value)
        self._suspect = None
        forward = suspect[0] > last
        confirmed = stamp > suspect[0] if forward else suspect[0] < stamp < last
        if not confirmed:
            if stamp == suspect[0]:  # a repeated message neither confirms nor disproves
                self._suspect = suspect
                self._reject("stamp_repeated", f"stamp {_seconds(stamp)} came twice")
                return ()
            self._reject_suspect(suspect[0], last)
            return self.accept(stamp, value)
        if not forward:
            self.jumped = self.went_back = True
        self.last = suspect[0]
        self.accepted += 1
        self.period_s = float("nan")
        return (suspect, *self.accept(stamp, value))

    def _accept_after(self, last: int, stamp: int, value: Any) -> tuple[Item, ...]:
        if stamp == last:
            self._reject("stamp_repeated", f"stamp {_seconds(stamp)} came twice")
        elif last - self._jump <= stamp < last:
            self._reject("stamp_back", f"stamp {_seconds(stamp)} is {(last - stamp) * 1e-6:.3f} ms before the last one")
        elif last < stamp <= last + self._jump:
            return self.accept(stamp, value)
        else:
            self._suspect = (stamp, value)
        return ()

    def take(self, items: Sequence[Item], given: int | None) -> None:
        """Hold accepted messages; `given`: stamp of the last sample that was given out."""
        self.items.extend(items)
        if given is not None:
            self.count_overdue(given - stamp for stamp, _ in items)

    def count_overdue(self, ages: Iterable[int]) -> None:
        """Count messages by their ages [ns] at the last sample that was given out before they came."""
        # Where this clock has gone back before that of the joint states, its samples are still to come.
        most = self._jump if self.went_back else None
        self.overdue += sum(age > self.margin and (most is None or age <= most) for age in ages)

    def withdraw(self, reason: str, sentence: str) -> None:
        """A message that was accepted by its stamp is not used for its values."""
        self.accepted -= 1
        self._reject(reason, sentence)

    def finish(self) -> None:
        """No more messages: a suspect that nothing followed is rejected."""
        if self._suspect is not None and self.last is not None:
            self._reject_suspect(self._suspect[0], self.last)
            self._suspect = None

    def _reject_suspect(self, suspect: int, last: int) -> None:
        side = "after" if suspect > last else "before"
        sentence = f"stamp {_seconds(suspect)} is {abs(suspect - last) * 1e-9:.3f} s {side} the others of the stream"
        self._reject("stamp_jump", sentence)

    def _reject(self, reason: str, sentence: str) -> None:
        self._rejections.add(self.name, reason, sentence)

    def bracket(self, stamp: int, reach: int) -> tuple[Item | None, Item | None]:
        """The newest item at or before a stamp and the oldest within `reach` [ns] after it, each within max_age.

        Items that no later stamp can need are dropped: stamps asked for must not decrease.
        """
        items = self.items
        while len(items) > 1 and items[1][0] <= stamp:
            items.popleft()
        if not items:
            return None, None
        before: Item | None = items[0]
        after = items[1] if len(items) > 1 else None
        if items[0][0] > stamp:
            before, after = None, items[0]
        if before is not None and stamp - before[0] > self.max_age:
            before = None
        if after is not None and after[0] - stamp > min(reach, self.max_age):
            after = None
        return before, after

    def latest(self, stamp: int) -> Any | None:
        """The value that holds at a stamp until the next message: the newest one before it, within max_age."""
        before, after = self.bracket(stamp, 0)
        found = before or after
        return None if found is None else found[1]

    def nearest(self, stamp: int) -> Any | None:
        """The value nearest to a stamp within max_age, for streams that nothing waits for."""
        before, after = self.bracket(stamp, self.max_age)
        if before is None or after is None:
            found = before or after
            return None if found is None else found[1]
        return before[1] if stamp - before[0] <= after[0] - stamp else after[1]


@compiled
def smoothed(start: float, values: Array) -> float:
    """Values taken into an average that follows them by a twentieth; NaN: there is none yet."""
    for value in values:
        start = value if np.isnan(start) else start + 0.05 * (value - start)
    return start


@compiled
def all_usable_rows(values: Array) -> bool:
    """Whether each row is usable."""
    good = True
    for k in range(values.shape[0]):
        good = good and usable(values[k])
    return good


def _seconds(stamp: int) -> str:
    return f"{stamp // 10**9}.{stamp % 10**9:09d} s"
