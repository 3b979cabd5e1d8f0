# SPDX-License-Identifier: BSD-3-Clause
"""The model simulated ahead, through motors and equations of motion of another time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...base.compiled import apply, compiled, mul
from ...base.types import Array
from .contact import ROWS, Linear, Solver, State, step_soles, switch_support
from .kinematics import geometry_of, linear_of, terms_of
from .memory import STEP, Memory, motors_at, nearest, swapped

EVERY = 0.0395  # [s] between two simulations: in between the last one is read further


class Start(NamedTuple):
    """From where a simulation ahead starts."""

    stamp: int  # [ns]
    foot: int  # support foot
    block: Array  # of `Assembled`
    state: State  # the filtered measurement
    T_odom_sole: Array  # (4, 4) pose of the support sole


@compiled
def along(course: Array, since: float, horizons: Array, T_odom_sole: Array) -> Array:
    """A course (n, 6 + m) of `Stride`, every `STEP`, at since + horizons (k,) [s], its vectors in the support sole."""
    out = np.zeros((horizons.shape[0], course.shape[1]))
    for k in range(horizons.shape[0]):
        at = (since + horizons[k]) / STEP
        i = min(int(at), course.shape[0] - 2)
        w = at - i
        now = (1.0 - w) * course[i] + w * course[i + 1]
        for axis in range(3):
            for j in range(3):
                out[k, j] += (now[axis] - T_odom_sole[axis, 3]) * T_odom_sole[axis, j]
                out[k, 3 + j] += now[3 + axis] * T_odom_sole[axis, j]
        out[k, 6:] = now[6:]
    return out


@compiled
def simulate(
    start: Start, T_then: Array, then: int, points: int, past: Memory, n: int, soles: Array, friction: float,
    planned: bool,
) -> Array:  # fmt: skip
    """The model from a measured state through remembered or planned motors and equations of motion.

    Args:
        start: now.
        T_then: (4, 4) pose of the support sole where the memory has this moment.
        then: stamp of this moment in the memory [ns].
        points: of the course, every STEP.
        past, n: the memory.
        soles: (2, 4) edges of the left and the right sole [m].
        friction: coefficient.
        planned: the memory is of a plan. Then a sole stands where it is by the joints, not where the memory has it: the
            robot's steps are not quite those of the plan, as its last ones were.

    Returns:
        (points, 6 + m) as in `Stride`.
    """
    m = past.theta.shape[1]
    terms, q, foot = terms_of(start.block, m), nearest(then, past.stamp, n, n - 1), start.foot
    R = mul(start.T_odom_sole[:3, :3].copy(), T_then[:3, :3].copy().T.copy())  # odom of then in that of now
    p = start.T_odom_sole[:3, 3] - apply(R, T_then[:3, 3].copy())

    off, before, after = np.empty(m), np.empty(m), np.empty(m)
    motors_at(off, then, past, n, q, foot)
    off[:] = terms.theta - off  # of the motors from what they did; stays
    state = State(start.state.y.copy(), start.state.w.copy(), np.zeros(2 * ROWS))
    linear, out = terms.linear, np.zeros((points, 6 + m))
    if planned:
        if past.foot[q] != foot:
            foot = past.foot[q]
            state, off = switch_support(state, linear, soles[foot - 1]), swapped(off)
            linear = remembered(past, q)[0]
            p = p - apply(R, stepped(linear, state, past.T_odom_sole[q]))
        else:
            linear = remembered(past, q)[0]
    last, taken = q, -1
    for k in range(points):
        t = then + int(k * STEP * 1e9)
        if k > 0:
            q = nearest(t - int(0.5 * STEP * 1e9), past.stamp, n, q)
            if past.foot[q] != foot:  # the support changes
                foot = past.foot[q]
                if planned:
                    p = p + apply(R, stepped(linear, state, past.T_odom_sole[last]))
                state = switch_support(state, linear, soles[foot - 1])
                off = swapped(off)
            last = q
            if q != taken:
                linear, solver = remembered(past, q)
                taken = q
            for at, motors in ((t - int(STEP * 1e9), before), (t, after)):
                motors_at(motors, at, past, n, q, foot)
                motors += off
            step_soles(state, linear, solver, before, after, 1, friction)
        q = nearest(t, past.stamp, n, q)
        motors_at(after, t, past, n, q, foot)
        after += off
        write_point(out[k], state.y, after, past, q, foot, R, p)
    return out


@compiled
def shift(course: Array, moved: Array, R: Array) -> None:
    """Move the COM of a course (n, 6 + m), in place, by (n, 3) [m] in axes R (3, 3) of those of the course."""
    for k in range(course.shape[0]):
        for axis in range(3):
            for j in range(3):
                course[k, axis] += R[axis, j] * moved[k, j]


@compiled
def stepped(linear: Linear, state: State, T_odom_sole: Array) -> Array:
    """By how much (3,) the other sole stands beside where `linear` has it, in the odom of the support sole [m]."""
    beside = np.zeros(3)
    for axis in range(2):
        for j in range(linear.y.shape[0]):
            beside[axis] += linear.C[ROWS + 4 + axis, j] * (state.y[j] - linear.y[j])
    return apply(T_odom_sole[:3, :3].copy(), beside)


@compiled
def write_point(point: Array, y: Array, motors: Array, past: Memory, q: int, foot: int, R: Array, p: Array) -> None:
    """A point of a course (6 + m,), of zeros, at coordinates y and motors (m,), by the posture of sample q.

    The leg of `foot` comes first in y and motors. R, p: pose (3, 3), (3,) of the memory's odom in that of the course.
    """
    m = motors.shape[0]
    own = 0 if foot == 1 else m // 2  # where the left leg begins
    order = 0 if past.foot[q] == foot else m // 2  # and the support leg of sample q
    then, at = geometry_of(past.block[q], m), linear_of(past.block[q], m).y
    J, com, bent = then.J, then.com.copy(), then.com - past.reference[q]
    for k in range(m):
        i = (k + order) % m
        for axis in range(3):
            com[axis] += J[axis, k] * (y[i] - at[k])
            bent[axis] += J[axis, k] * (y[i] - at[k] - motors[i] + past.theta[q, k])
        point[6 + k] = y[(k + own) % m] - motors[(k + own) % m]
    for i in range(3):
        at_odom, bent_odom = past.T_odom_sole[q, i, 3], 0.0
        for j in range(3):
            at_odom += past.T_odom_sole[q, i, j] * com[j]
            bent_odom += past.T_odom_sole[q, i, j] * bent[j]
        for axis in range(3):
            point[axis] += R[axis, i] * at_odom
            point[3 + axis] += R[axis, i] * bent_odom
    for axis in range(3):
        point[axis] += p[axis]


@compiled
def remembered(past: Memory, q: int) -> tuple[Linear, Solver]:
    """The equations of motion of a remembered sample, and their solver for steps of STEP."""
    r = 2 * ROWS if past.double[q] else ROWS
    linear = linear_of(past.block[q], past.theta.shape[1])
    return linear, Solver(STEP, r, past.inverse[q], past.by_impulse[q], past.contact[q])
