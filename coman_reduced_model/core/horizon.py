# SPDX-License-Identifier: BSD-3-Clause
"""Predictions h seconds ahead, judged when the measurement arrives, against three baselines on the same samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .compiled import compiled, inverse, pick
from .integrator import advance_into, select, transition
from .reference import look
from .types import Array

Ints = NDArray[np.int64]

PREDICTORS = ("model", "rigid", "persistence", "lipm")
BASELINES = PREDICTORS[1:]
_STEP = 0.02  # [s] longest step of a prediction; the steps are exact, this only samples the reference
_CAPACITY = 4096  # pending predictions a horizon: 2 s at 2 kHz


@compiled
def predict_horizons(
    com: Array, com_vel: Array, horizons: Array, M: Array, K: Array, D: Array, axes: Array, force: Array,
    reference: Array, reference_vel: Array, plan: Array, plan_vel: Array, plan_dt: float,
) -> Array:  # fmt: skip
    """COM at each horizon ahead of the measured state, posture and phase staying as they are.

    Args:
        com, com_vel: (3,) measured [m], [m/s] in the support sole.
        horizons: (k,) ascending [s], at least one.
        M, K, D, axes, force: `model.Terms` now.
        reference, reference_vel: (3,) now; NaN without a reference (LIPM): what is not integrated stays.
        plan, plan_vel, plan_dt: from `reference.plan_ahead`.

    Returns:
        (k, 3) [m] in the support sole.
    """
    out = np.empty((horizons.shape[0], 3))
    n = axes.shape[0]
    M_inv, K_n, D_n = inverse(select(M, axes)), select(K, axes), select(D, axes)
    z = np.empty(2 * n)
    for i in range(n):
        z[i], z[n + i] = com[axes[i]], com_vel[axes[i]]
    free = np.isnan(reference[0])
    velocity = np.zeros(3) if free else reference_vel
    u, u_end = pick(force, axes), np.empty(n)
    z_end, moved, faster = np.empty(2 * n), np.empty(3), np.empty(3)  # once: making arrays is what takes the time here
    start, last_dt = 0.0, -1.0
    # Without a plan the reference moves linearly and any step is exact; equal ones share their transition.
    longest = _STEP if plan.shape[0] > 1 else horizons[0]
    for h in range(horizons.shape[0]):
        steps = max(1, int(np.ceil((horizons[h] - start) / longest - 1e-9)))
        dt = (horizons[h] - start) / steps
        if abs(dt - last_dt) > 1e-12:
            E, G_0, G_1 = transition(M_inv, K_n, D_n, dt)
            last_dt = dt
        for k in range(steps):
            look(plan, plan_vel, plan_dt, velocity, start + (k + 1) * dt, moved, faster)
            for i in range(n):
                u_end[i] = force[axes[i]]
                for j in range(3):
                    u_end[i] += K[axes[i], j] * moved[j] + D[axes[i], j] * faster[j]
            advance_into(z_end, z, E, G_0, G_1, u, u_end)
            z, z_end, u, u_end = z_end, z, u_end, u
        for i in range(3):
            out[h, i] = com[i] if free else reference[i] + moved[i]
        for i in range(n):
            out[h, axes[i]] = z[i]
        start = horizons[h]
    return out


@compiled
def predict_baselines(com: Array, com_vel: Array, zmp: Array, gravity: float, horizons: Array) -> Array:
    """Persistence p + p' h and the LIPM from the measured state with the measured ZMP, (2, k, 3) [m].

    Height is constant in the LIPM. A ZMP of NaN gives a LIPM of NaN.
    """
    out = np.empty((2, horizons.shape[0], 3))
    persistence, lipm = out[0], out[1]
    omega = np.sqrt(gravity / max(com[2], 0.05))
    for h in range(horizons.shape[0]):
        c, s = np.cosh(omega * horizons[h]), np.sinh(omega * horizons[h])
        for i in range(3):
            persistence[h, i] = com[i] + com_vel[i] * horizons[h]
            lipm[h, i] = zmp[i] + (com[i] - zmp[i]) * c + com_vel[i] / omega * s
        lipm[h, 2] = com[2] + 0.0 * zmp[0]
    return out


@compiled
def drop_impossible(ahead: Array, com: Array, com_vel: Array, horizons: Array, gravity: float, diverged: float) -> bool:
    """Write NaN over predictions that no robot on its feet gets to; whether there were any.

    It accelerates by less than gravity, so that in a time h it gets no farther than |p'| h + g h^2 / 2.

    Args:
        ahead: (k, 3) predictions [m] in the support sole, changed in place.
        com, com_vel: (3,) measured [m], [m/s].
        horizons: (k,) [s].
        gravity: [m/s^2].
        diverged: [m] by which a prediction may be off on top of that.
    """
    found = False
    for h in range(horizons.shape[0]):
        t = horizons[h]
        limit = diverged + np.sqrt(com_vel.dot(com_vel)) * t + 0.5 * gravity * t * t
        for i in range(3):
            if not abs(ahead[h, i] - com[i]) < limit:  # an axis each: a sum of squares could overflow
                ahead[h] = np.nan
                found = True
                break
    return found


class HorizonJudge:
    """Collects squared errors of each predictor at each horizon, per axis of the sole that predicted.

    Sums are over the samples where all predictors have a value, so that their errors are comparable.
    """

    def __init__(self, horizons: tuple[float, ...], rigid: bool = True) -> None:
        """Horizons in seconds; without `rigid` there is no reference, and that predictor is left out (NaN)."""
        self._needed = np.array([True, rigid, True, True])
        self.horizons = horizons
        n = len(horizons)
        self._ahead_ns = np.array([round(h * 1e9) for h in horizons], dtype=np.int64)
        self._targets = np.zeros((n, _CAPACITY), dtype=np.int64)
        self._poses = np.zeros((n, _CAPACITY, 4, 4))
        self._predicted = np.zeros((n, _CAPACITY, len(PREDICTORS), 3))
        self._first = np.zeros(n, dtype=np.int64)
        self._count = np.zeros(n, dtype=np.int64)
        self._sums = np.zeros((n, len(PREDICTORS), 3))
        self._judged = np.zeros((n, 3), dtype=np.int64)
        self._last_ns = 0
        self._last = np.full((2, 3), np.nan)  # measured and reference COM in odom at the last sample

    def restart(self) -> None:
        """Drop the pending predictions: the stream broke off."""
        self._count[:] = 0
        self._last[:] = np.nan

    def update(
        self,
        stamp_ns: int,
        T_odom_sole: Array,
        measured: Array,
        reference: Array,
        model: Array,
        persistence: Array,
        lipm: Array,
    ) -> None:
        """Judge what is due at this sample and take its predictions in.

        Args:
            stamp_ns: of the sample.
            T_odom_sole: (4, 4) pose of the support sole.
            measured, reference: (3,) COM now [m], in the sole frame; reference NaN if there is none.
            model, persistence, lipm: (n, 3) predictions [m] in the sole frame, a row a horizon; NaN where none.
        """
        _update(
            stamp_ns,
            T_odom_sole,
            measured,
            reference,
            model,
            persistence,
            lipm,
            self._ahead_ns,
            self._targets,
            self._poses,
            self._predicted,
            self._first,
            self._count,
            self._sums,
            self._judged,
            self._last_ns,
            self._last,
            self._needed,
        )
        self._last_ns = stamp_ns

    def rmse(self) -> dict[str, dict[str, Array]]:
        """RMSE (3,) [m] by horizon (as text, `0.1`) and predictor; NaN where nothing was judged."""
        with np.errstate(invalid="ignore", divide="ignore"):
            means = np.sqrt(self._sums / self._judged[:, None, :])
        return {f"{h:g}": dict(zip(PREDICTORS, means[i], strict=True)) for i, h in enumerate(self.horizons)}

    def skill(self) -> dict[str, Array]:
        """1 - RMSE of the model / RMSE of the best baseline, (3,) a horizon; NaN where nothing was judged."""
        skills = {}
        for h, errors in self.rmse().items():
            with np.errstate(invalid="ignore", divide="ignore"):
                best = np.fmin.reduce([errors[name] for name in BASELINES])
                skills[h] = 1.0 - errors["model"] / best
        return skills

    @property
    def judged(self) -> dict[str, Array]:
        """How many predictions were judged, (3,) a horizon."""
        return {f"{h:g}": self._judged[i].copy() for i, h in enumerate(self.horizons)}


@compiled
def _to_odom(T: Array, p: Array, out: Array) -> None:
    for i in range(3):
        out[i] = T[i, 0] * p[0] + T[i, 1] * p[1] + T[i, 2] * p[2] + T[i, 3]


@compiled
def _update(
    stamp_ns: int, T: Array, measured: Array, reference: Array, model: Array, persistence: Array, lipm: Array,
    ahead_ns: Ints, targets: Ints, poses: Array, predicted: Array, first: Ints, count: Ints, sums: Array,
    judged: Ints, last_ns: int, last: Array, needed: NDArray[np.bool_],
) -> None:  # fmt: skip
    now = np.empty((2, 3))
    _to_odom(T, measured, now[0])
    _to_odom(T, reference, now[1])
    capacity = targets.shape[1]
    errors = np.empty((4, 3))
    for h in range(targets.shape[0]):
        while count[h] > 0 and targets[h, first[h]] <= stamp_ns:
            slot = first[h]
            first[h] = (slot + 1) % capacity
            count[h] -= 1
            w = (targets[h, slot] - last_ns) / (stamp_ns - last_ns)
            values = predicted[h, slot]
            for i in range(3):
                values[1, i] = (1.0 - w) * last[1, i] + w * now[1, i]
            for k in range(4):
                for i in range(3):
                    e = 0.0
                    for j in range(3):  # into the axes of the sole that predicted
                        e += poses[h, slot, j, i] * (values[k, j] - ((1.0 - w) * last[0, j] + w * now[0, j]))
                    errors[k, i] = e
            for i in range(3):
                complete = True
                for k in range(4):
                    complete &= not (needed[k] and np.isnan(errors[k, i]))
                if not complete:
                    continue
                judged[h, i] += 1
                for k in range(4):
                    sums[h, k, i] += errors[k, i] ** 2
        if count[h] < capacity:
            slot = (first[h] + count[h]) % capacity
            count[h] += 1
            targets[h, slot] = stamp_ns + ahead_ns[h]
            for i in range(4):
                for j in range(4):
                    poses[h, slot, i, j] = T[i, j]
            _to_odom(T, model[h], predicted[h, slot, 0])
            _to_odom(T, persistence[h], predicted[h, slot, 2])
            _to_odom(T, lipm[h], predicted[h, slot, 3])
    for k in range(2):
        for i in range(3):
            last[k, i] = now[k, i]
