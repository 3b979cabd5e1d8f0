# SPDX-License-Identifier: BSD-3-Clause
"""The free run of the paper's model again and again with other coefficients, from terms that are collected once.

The terms of the model are linear in the eight coefficients of (20), (21). One pass of the predictor over the samples
collects what does not depend on them; a compiled loop then runs 15 s in some milliseconds, with the predictor's own
integrator, changes of phase and restarts. A test holds it to the predictor's own free run.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass

import numpy as np

from ..core.base.compiled import compiled
from ..core.base.types import Array, Booleans, Flags, Integers, Phase, Sample, SupportState
from ..core.config.schema import Config
from ..core.model.cartesian import Model, Terms
from ..core.model.integrator import Forcing, extrapolate, free_run_step, free_run_switch
from ..core.predictor import Predictor
from ..core.robot.robot import Posture
from ..errors import ConfigError

COEFFICIENTS = ("a1", "b1", "c1", "e1", "a2", "b2", "c2", "e2")  # of K_xx D_xx K_xz D_xz K_zz D_zz K_zx D_zx
_PAIRS = (
    ("a1", "a2"),
    ("b1", "b2"),
    ("c1", "c2"),
    ("e1", "e2"),
)  # one of each row: which, the row of the force says
_STOP, _GO, _RESTART = 0, 1, 2


@dataclass(frozen=True)
class FreeRun:
    """One bag, n samples; vectors in the frame of the support sole."""

    stamp: Integers  # (n,) [ns] since the first sample
    event: Integers  # (n,) what the predictor did: _STOP, _GO, _RESTART
    switched: Booleans  # (n,) whether the support changed at this sample
    began: Integers  # (n,) [ns] when it did
    R: Array  # (n, 3, 3) old sole to new sole
    moved: Array  # (n, 3)
    K: Array  # (n, 3, 3) with coefficients of 1
    D: Array  # (n, 3, 3)
    force: Array  # (n, 3) with coefficients of 0
    pull: Array  # (n, 8) force of each coefficient, in its row
    reference: Array  # (n, 6) COM and velocity
    measured: Array  # (n, 6)
    axes: Integers  # integrated coordinates
    mass: float
    diverged: float  # [m] distance from the measured COM at which it restarts, as `Predictor.DIVERGED`

    def run(self, coefficients: Array, given: int = -1, data: Array | None = None) -> Array:
        """COM and velocity (n, 6) of the free run; NaN where there is none.

        Args:
            coefficients: (8,) in the order of COEFFICIENTS.
            given: index of a coordinate that is taken from data instead of being simulated; -1: none.
            data: (n, 6) to take it from; default: the measurement.
        """
        axes = self.axes[self.axes != given]
        c = np.asarray(coefficients, dtype=float)
        known = self.measured if data is None else data
        return _run(
            c, given, axes, self.mass, self.diverged, self.stamp, self.event, self.switched, self.began, self.R,
            self.moved, self.K, self.D, self.force, self.pull, self.reference, self.measured, known,
        )  # fmt: skip


def compile_loop() -> None:
    """Compile the loop now: processes that start together would all do it."""
    stamps, one, zeros = np.arange(2), np.zeros((2, 6)), np.zeros((2, 3, 3))
    go = np.full(2, _GO)
    FreeRun(
        stamps, go, go > _GO, stamps, zeros, one[:, :3].copy(), zeros, zeros, one[:, :3].copy(), np.zeros((2, 8)),
        one, one, np.array([0, 2]), 1.0, Predictor.DIVERGED,
    ).run(np.ones(8))  # fmt: skip


def collect(samples: Sequence[Sample], robot: object, config: Config) -> FreeRun:
    """What the predictor's free run over samples is made of.

    Raises:
        ConfigError: the model has no coefficients (no reference, or the turning trunk).
    """
    if config.prediction.reference == "none":
        raise ConfigError("prediction.reference: none: the pendulum has no coefficients to tune")
    config = config.replaced({"prediction.horizons": (), **{f"model.{name}": 1.0 for name in COEFFICIENTS}})
    predictor = Predictor(robot, config)  # type: ignore[arg-type]
    if predictor.model.turning:
        raise ConfigError(
            "model.trunk_rotation: the turning trunk does not use the coefficients a1 to e2, the paper's model does "
            "(model.trunk_rotation: without)"
        )
    probes = [_probe(predictor, config, pair) for pair in ((), *_PAIRS)]
    taken: list[tuple[Terms, Array, list[Terms]]] = []
    own = predictor.model.terms

    def terms(posture: Posture, support: SupportState, *rest: object) -> Terms:
        made = own(posture, support, *rest)  # type: ignore[arg-type]
        taken.append((made, made.force.copy(), [probe.terms(posture, support, *rest) for probe in probes]))  # type: ignore[arg-type]
        return made

    predictor.model.terms = terms  # type: ignore[method-assign, assignment]
    n = len(samples)
    stamp, began = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64)
    event = np.zeros(n, dtype=np.int64)
    switched = np.zeros(n, dtype=np.bool_)
    R, moved = np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3))
    K, D, force, pull = np.zeros((n, 3, 3)), np.zeros((n, 3, 3)), np.zeros((n, 3)), np.zeros((n, 8))
    reference, measured = np.full((n, 6), np.nan), np.full((n, 6), np.nan)
    before: SupportState | None = None
    T_before = np.eye(4)
    for i, sample in enumerate(deepcopy(list(samples)) if config.effects else samples):
        taken.clear()
        p = predictor.update(sample)
        support = p.support
        stamp[i] = sample.stamp_ns - samples[0].stamp_ns
        if support.phase != Phase.FLIGHT:
            measured[i] = np.concatenate((p.measured_com, p.measured_com_vel))
        if taken:
            made, without, (zero, *pairs) = taken[-1]
            # A restart at a divergence depends on the coefficients: the loop finds those itself.
            event[i] = _RESTART if p.flags & (Flags.RESET | Flags.REJECTED_STATE) == Flags.RESET else _GO
            reference[i] = np.concatenate((p.reference_com, p.reference_com_vel))
            K[i], D[i] = made.K, made.D
            force[i] = zero.force + made.force - without  # what pushes is added after the terms are made
            for k, pair in enumerate(pairs):
                difference = pair.force - zero.force
                pull[i, k], pull[i, 4 + k] = difference[0], difference[2]
            if before is not None and (before.phase, before.support_foot) != (support.phase, support.support_foot):
                switched[i] = True
                late = support.foot_time if support.phase == before.phase else support.phase_time
                began[i] = stamp[i] - round(late * 1e9)
                new = p.T_odom_sole
                R[i] = new[:3, :3].T @ T_before[:3, :3]
                moved[i] = new[:3, :3].T @ (T_before[:3, 3] - new[:3, 3])
        before, T_before = support, p.T_odom_sole
    return FreeRun(
        stamp, event, switched, began, R, moved, K, D, force, pull, reference, measured,
        predictor.model.axes, predictor.model.mass, predictor.DIVERGED,
    )  # fmt: skip


def _probe(predictor: Predictor, config: Config, ones: tuple[str, ...]) -> Model:
    values = {f"model.{name}": 1.0 if name in ones else 0.0 for name in COEFFICIENTS}
    return Model(predictor.robot, config.replaced(values), predictor.effects)


@compiled
def _run(
    c: Array, given: int, axes: Integers, mass: float, diverged: float, stamp: Integers, event: Integers,
    switched: Booleans, began: Integers, R: Array, moved: Array, K_all: Array, D_all: Array, force: Array, pull: Array,
    reference: Array, measured: Array, data: Array,
) -> Array:  # fmt: skip
    n = stamp.shape[0]
    M = np.eye(3) * mass
    out = np.full((n, 6), np.nan)
    K, D, F = np.empty((n, 3, 3)), np.empty((n, 3, 3)), np.empty((n, 3))
    following = np.array([a for a in range(3) if a not in axes])
    running = False
    first = 0  # first sample of the past of this phase
    state, state_ns = np.zeros(6), 0
    for i in range(n):
        if event[i] == 0:
            running = False
            continue
        for row in range(3):
            F[i, row] = force[i, row]
            for column in range(3):
                K[i, row, column], D[i, row, column] = K_all[i, row, column], D_all[i, row, column]
        for k in range(8):
            row = 0 if k < 4 else 2
            column = row if k % 4 < 2 else 2 - row
            if k % 2 == 0:
                K[i, row, column] *= c[k]
            else:
                D[i, row, column] *= c[k]
            F[i, row] += c[k] * pull[i, k]
        if given >= 0:
            for row in range(3):
                F[i, row] -= K[i, row, given] * data[i, given] + D[i, row, given] * data[i, 3 + given]
                K[i, row, given], D[i, row, given] = 0.0, 0.0
        forcing = Forcing(K[i], D[i], F[i], reference[i, :3], reference[i, 3:])
        if running and switched[i]:
            last = i - 1
            while last > first and stamp[last] > began[i]:
                last -= 1
            old = Forcing(K[last], D[last], F[last], reference[last, :3], reference[last, 3:])
            dt = max(0, began[i] - stamp[last]) * 1e-9
            state_ns = max(stamp[last], began[i])
            state = free_run_switch(out[last], M, axes, following, old, dt, R[i], moved[i])
            first = i
        restart = not running or event[i] == 2
        if not restart:
            dt = (stamp[i] - state_ns) * 1e-9
            if switched[i]:
                start = extrapolate(forcing, -dt)
            else:
                start = Forcing(K[i - 1], D[i - 1], F[i - 1], reference[i - 1, :3], reference[i - 1, 3:])
            state = free_run_step(state, M, axes, following, start, forcing, dt)
            error = 0.0
            for a in range(3):
                if a == given:
                    state[a], state[3 + a] = data[i, a], data[i, 3 + a]
                error += (state[a] - measured[i, a]) ** 2
            restart = not np.sqrt(error) < diverged
        if restart:
            state = measured[i].copy()
            first = i
        running, state_ns = True, stamp[i]
        out[i] = state
    return out
