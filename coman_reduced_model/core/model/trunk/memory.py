# SPDX-License-Identifier: BSD-3-Clause
"""The samples that a stride is made of, and where in them the robot did what it does now."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.compiled import Held, compiled
from ...base.types import Array
from .contact import ROWS, make_solver
from .kinematics import terms_of, terms_size

STEP = 0.01  # [s] of the simulation ahead; the contact of the other foot may change in each
WINDOW = 0.2  # [s] of the motors by which two strides are laid over each other
SEARCH = np.arange(-8, 9) * 0.005  # [s] about the lag between the phases


class Memory(NamedTuple):
    """Samples of the past, oldest first; fields as in `Assembled`, joints of the support leg first.

    Rows of the other foot hold nothing of use where it did not stand, but for C and height.
    T_odom_sole (n, 4, 4) is the pose of the support sole. In the plan's own odom, or NaN: plan (n, 3) the planned COM,
    planned_sole (n, 3, 3) the orientation of the support sole.
    """

    stamp: NDArray[np.int64]
    foot: NDArray[np.int64]
    double: NDArray[np.bool_]
    theta: Array
    block: Array  # of `Assembled`
    inverse: Array  # with by_impulse and contact as in `Solver`, for steps of STEP
    by_impulse: Array
    contact: Array
    T_odom_sole: Array
    plan: Array
    planned_sole: Array
    reference: Array  # (n, 3) COM by the motors, as that of `Geometry`


def empty_memory(m: int, capacity: int) -> Memory:
    """Room for `capacity` samples of a robot with m joints in its legs."""
    r = 2 * ROWS
    shapes = {
        "theta": (m,), "block": (terms_size(m),), "inverse": (m + 6, m + 6), "by_impulse": (r, m + 6),
        "contact": (r, r), "T_odom_sole": (4, 4), "plan": (3,), "planned_sole": (3, 3), "reference": (3,),
    }  # fmt: skip
    types = {"stamp": np.int64, "foot": np.int64, "double": np.bool_}
    return Memory(*(np.zeros((capacity, *shapes.get(f, ())), types.get(f, np.float64)) for f in Memory._fields))


@compiled
def keep(
    memory: Held, n: int, stamp: int, block: Array, foot: int, double: bool, T_odom_sole: Array, plan: Array,
    planned_sole: Array, reference: Array,
) -> None:  # fmt: skip
    """Remember a sample as number n."""
    past = memory.value
    terms, rows = terms_of(block, past.theta.shape[1]), 2 * ROWS if double else ROWS
    linear = terms.linear
    solver = make_solver(terms.M, linear.K, linear.D, linear.C, STEP, rows)
    past.stamp[n], past.foot[n], past.double[n], past.theta[n] = stamp, foot, double, terms.theta
    past.block[n], past.inverse[n] = block, solver.inverse
    past.by_impulse[n, :rows], past.contact[n, :rows, :rows] = solver.by_impulse, solver.contact
    past.T_odom_sole[n], past.plan[n], past.planned_sole[n] = T_odom_sole, plan, planned_sole
    past.reference[n] = reference


@compiled
def swapped(v: Array) -> Array:
    """Joints of both legs (m,) with the other leg's first."""
    n = v.shape[0] // 2
    return np.concatenate((v[n:], v[:n]))


@compiled
def nearest(t: int, stamp: NDArray[np.int64], n: int, i: int) -> int:
    """Index below n of the stamp nearest to t, searched from i."""
    while i > 0 and abs(stamp[i - 1] - t) <= abs(stamp[i] - t):
        i -= 1
    while i + 1 < n and abs(stamp[i + 1] - t) < abs(stamp[i] - t):
        i += 1
    return i


@compiled
def motors_at(out: Array, t: int, past: Memory, n: int, i: int, foot: int) -> None:
    """Motor positions (m,) at a stamp t near sample i, linear between samples, the leg of `foot` first; into `out`."""
    if (past.stamp[i] > t and i > 0) or i + 1 >= n:
        i -= 1
    w = (t - past.stamp[i]) / (past.stamp[i + 1] - past.stamp[i])
    m = out.shape[0]
    a, b = 0 if past.foot[i] == foot else m // 2, 0 if past.foot[i + 1] == foot else m // 2
    for j in range(m):
        out[j] = (1.0 - w) * past.theta[i, (j + a) % m] + w * past.theta[i + 1, (j + b) % m]


@compiled
def mismatch(stamp: int, lag: int, past: Memory, n: int) -> tuple[float, float]:
    """Largest and mean square difference of the motors [rad], [rad^2] over `WINDOW` to what they did a lag before."""
    largest, square, count = 0.0, 0.0, 0
    m, i = past.theta.shape[1], n - 1
    j, then = i, np.empty(m)
    while i >= 0 and past.stamp[i] >= stamp - WINDOW * 1e9:
        j = nearest(past.stamp[i] - lag, past.stamp, n, j)
        motors_at(then, past.stamp[i] - lag, past, n, j, past.foot[i])
        for k in range(m):
            off = past.theta[i, k] - then[k]
            largest = max(largest, abs(off))
            square += off * off / m
        count += 1
        i -= 1
    return largest, square / max(1, count)


@compiled
def find_lag(stamp: int, guesses: NDArray[np.int64], past: Memory, n: int) -> int:
    """The lag [ns] near one of the guesses (k,) at which the last `WINDOW` is most like what was then."""
    costs = np.empty((guesses.shape[0], SEARCH.shape[0]))
    best = 0
    for g in range(guesses.shape[0]):
        for k in range(SEARCH.shape[0]):
            costs[g, k] = mismatch(stamp, guesses[g] + int(SEARCH[k] * 1e9), past, n)[1]
        if costs[g].min() < costs[best].min():
            best = g
    cost, guess = costs[best], guesses[best]
    k = min(max(int(np.argmin(cost)), 1), SEARCH.shape[0] - 2)
    bend = cost[k - 1] - 2.0 * cost[k] + cost[k + 1]
    shift = 0.5 * (cost[k - 1] - cost[k + 1]) / bend if bend > 0.0 else 0.0
    step = SEARCH[1] - SEARCH[0]
    return guess + int((SEARCH[k] + min(1.0, max(-1.0, shift)) * step) * 1e9)
