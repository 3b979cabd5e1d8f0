# SPDX-License-Identifier: BSD-3-Clause
"""Joint arrays of a message, in whatever order it lists them, into the order of the robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from ..base.compiled import compiled
from ..base.types import Array, Booleans, JointMessage
from .stream import LIMIT, Refused, fault, usable


@dataclass(slots=True)
class JointState:
    """A joint message in the order of `Robot.joint_names`; arrays (nj,)."""

    q: Array  # [rad]; `fill` where the message does not list the joint
    qd: Array | None  # [rad/s], likewise; None: not given
    tau: Array | None  # [Nm]; NaN where not given; None: not given at all


_NO_JOINTS = np.zeros(0, dtype=bool)
_MOST = 64  # orders and names that are kept: a broken driver may send others every time


class _Order:
    """How one tuple of names maps to the robot."""

    def __init__(self, names: tuple[str, ...], joint_names: tuple[str, ...], needed: Sequence[str]) -> None:
        self.refused: Refused | None = None
        position = {name: i for i, name in enumerate(names)}
        if len(position) != len(names):
            twice = next(name for i, name in enumerate(names) if position[name] != i)
            self.refused = Refused("repeated_joint", f"joint {twice!r} is listed twice")
        missing = [name for name in needed if name not in position]
        if len(missing) == len(needed):
            # Grippers and heads often publish on the same topic; that is no fault of the legs' driver.
            self.refused = Refused(
                "no_leg_joint", f"no joint of the legs among {', '.join(names)[:120] or 'no joints'}"
            )
        elif missing:
            self.refused = Refused("missing_joint", f"joint {', '.join(map(repr, missing))} of the legs is missing")
        listed = self.listed = [name for name in joint_names if name in position]
        self.take = np.array([position[name] for name in listed], dtype=np.intp)
        self.put = np.array([i for i, name in enumerate(joint_names) if name in position], dtype=np.intp)
        self.of_legs = np.array([name in needed for name in listed], dtype=bool)
        self.complete = len(listed) == len(joint_names)
        self.extra = tuple(name for name in names if name not in joint_names)
        self.unlisted = tuple(name for name in joint_names if name not in position)

    def taken(self, values: Array) -> tuple[Array, bool]:
        """The robot's joints of a message, as an array of its own, and whether they are usable."""
        out = np.empty(len(self.take))
        return out, _take(values, self.take, out)  # what compiled code fills costs less than what it returns

    def without_velocities(self, taken: Array) -> bool:
        """Whether NaN says that there are none: of any joint, or of some outside the legs (a hand, a head)."""
        missing = np.isnan(taken)
        return bool(missing.all() or not (missing & self.of_legs).any() and usable(np.where(missing, 0.0, taken)))

    def absent(self, taken: Array) -> Booleans:
        """(m,) joints outside the legs whose position is NaN: they have none to say."""
        return np.asarray(np.isnan(taken) & ~self.of_legs)

    def place(self, values: Array, fill: float, size: int) -> Array:
        """Values (..., m) taken from messages in the order of the robot; `fill` where they list no such joint."""
        if self.complete:
            return values
        result = np.full((*values.shape[:-1], size), fill)
        result[..., self.put] = values
        return result


class JointMap:
    """Sorts joint messages; remembers each order of names that it has seen.

    Every message must list all joints of both legs: legs split over several messages are refused. Joints that the
    URDF lacks are ignored; other joints of the URDF that no message lists get `fill`.

    Attributes:
        extra: joints in messages that the URDF lacks, each once.
        unlisted: joints of the URDF that the last usable message did not list.
        partial: whether some message left out joints of the URDF.
    """

    def __init__(self, joint_names: Sequence[str], needed: Sequence[str], fill: float = 0.0) -> None:
        self._names = tuple(joint_names)
        self._needed = tuple(needed)
        self._fill = fill
        self._orders: dict[tuple[str, ...], _Order] = {}
        self.extra: set[str] = set()
        self.unlisted: tuple[str, ...] = ()
        self.partial = False

    def sort(self, message: JointMessage) -> JointState:
        """The message in the order of the robot.

        Raises:
            Refused: arrays of unequal length, a missing or repeated joint, NaN or infinite values.
        """
        names = message.names
        velocity, effort = message.velocity, message.effort
        if len(message.position) != len(names):
            raise Refused("length", f"{len(message.position)} positions for {len(names)} names")
        if velocity is not None and len(velocity) != len(names):
            raise Refused("length", f"{len(velocity)} velocities for {len(names)} names")
        if effort is not None and len(effort) != len(names):
            raise Refused("length", f"{len(effort)} efforts for {len(names)} names")
        order = self._orders.get(names) or self._learn(names)
        if order.refused is not None:
            raise order.refused
        size = len(self._names)
        position, good = order.taken(message.position)
        absent = _NO_JOINTS if good else order.absent(position)
        if not good and not (absent.any() and usable(np.where(absent, 0.0, position))):
            self._refuse("position", position, order)
        self.unlisted = order.unlisted
        if absent.any():  # as if they were not listed
            position[absent] = self._fill
            self.partial = True
            self.unlisted = (*order.unlisted, *(order.listed[i] for i in np.flatnonzero(absent)))
        q = order.place(position, self._fill, size)
        qd = tau = None
        if velocity is not None:
            velocity, good = order.taken(velocity)
            if good:
                if absent.any():
                    velocity[absent] = self._fill
                qd = order.place(velocity, self._fill, size)
            elif not order.without_velocities(velocity):
                self._refuse("velocity", velocity, order)
        if effort is not None:
            effort, good = order.taken(effort)
            if not good:  # NaN: that joint measures none
                known = np.nan_to_num(effort, nan=0.0, posinf=np.inf, neginf=-np.inf)
                if not usable(known):
                    self._refuse("effort", known, order)
            tau = order.place(effort, np.nan, size)
        return JointState(q, qd, tau)

    def sort_rows(
        self, names: tuple[str, ...], position: Array, velocity: Array | None, effort: Array | None
    ) -> tuple[Array, Array | None, Array | None] | None:
        """`sort` for rows (n, m) of messages that list the same joints; None where one of them needs a closer look."""
        rows = [each for each in (position, velocity, effort) if each is not None]
        if any(each.shape[1] != len(names) for each in rows) or (self._orders and names not in self._orders):
            return None
        order = self._orders.get(names) or self._learn(names)
        if order.refused is not None:
            return None
        self.unlisted = order.unlisted
        taken = [np.empty((len(each), len(order.take))) for each in rows]
        good = [take_rows(each, order.take, out) for each, out in zip(rows, taken, strict=True)]
        if effort is not None:  # NaN: that joint measures none
            good[-1] = good[-1] or usable_where_known(taken[-1])
        if not all(good):
            return None
        size, values = len(self._names), iter(taken)
        q = order.place(next(values), self._fill, size)
        qd = None if velocity is None else order.place(next(values), self._fill, size)
        return q, qd, None if effort is None else order.place(next(values), np.nan, size)

    def _learn(self, names: tuple[str, ...]) -> _Order:
        if len(self._orders) >= _MOST:
            self._orders.clear()
        order = self._orders[names] = _Order(names, self._names, self._needed)
        if order.refused is None:
            if len(self.extra) < _MOST:
                self.extra.update(order.extra[:_MOST])
            self.partial |= bool(order.unlisted)
        return order

    def _refuse(self, label: str, values: Array, order: _Order) -> NoReturn:
        worst = int((~(np.abs(values) < LIMIT)).argmax())
        name = self._names[int(order.put[worst])]
        raise Refused(fault(values[worst]), f"{label} of {name!r} is {values[worst]}")


@compiled
def _take(values: Array, take: NDArray[np.intp], out: Array) -> bool:
    for i in range(take.shape[0]):
        out[i] = values[take[i]]
    return usable(out)


@compiled
def take_rows(values: Array, take: NDArray[np.intp], out: Array) -> bool:
    """Write the columns `take` of each row; whether all of it is usable."""
    good = True
    for k in range(values.shape[0]):
        for i in range(take.shape[0]):
            out[k, i] = values[k, take[i]]
        good = good and usable(out[k])
    return good


@compiled
def usable_where_known(values: Array) -> bool:
    """Whether each row is usable without its NaN."""
    for k in range(values.shape[0]):
        total = 0.0
        for i in range(values.shape[1]):
            if not np.isnan(values[k, i]):
                total += values[k, i] * values[k, i]
        if not total < LIMIT * LIMIT:
            return False
    return True
