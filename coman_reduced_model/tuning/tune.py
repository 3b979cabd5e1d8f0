# SPDX-License-Identifier: BSD-3-Clause
"""The paper's tuning: eight coefficients of (20), (21) in four stages, each by least squares on the mean squared error.

(i) decoupled: z from data into the x equation fits a1, b1; x from data into the z equation fits a2, b2; (ii) one-way:
simulated x into the z equation fits c2, e2; (iii) two-way: both simulated, fits c1, e1 (on x and z, for x acts on z).
Each stage believes the coefficients that are not its own; a last one, which the paper does not have, fits all together.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import least_squares

from ..core.base.types import Array
from ..core.config.schema import Config, parameter_table
from ..core.evaluation.run import run_of
from ..errors import BagError, ConfigError
from ..progress import Progress
from .free_run import COEFFICIENTS, FreeRun, collect
from .recording import JoinedBag
from .statistics import hac_covariance, quantile

_CORRELATED = 0.98
_NOT_DETERMINED = 1.0  # an interval wider than this share of the value to either side says nothing of it


@dataclass(frozen=True)
class Fitted:
    """One parameter after the fit."""

    name: str
    before: float
    value: float
    low: float  # interval, nominally of 95 %
    high: float
    notes: tuple[str, ...] = ()  # at a bound, not identifiable, ...


@dataclass(frozen=True)
class Errors:
    """Mean squared error (24) per axis [m^2]."""

    steps: dict[str, float]  # over three consecutive steps of each bag
    all: dict[str, float]


@dataclass(frozen=True)
class Tuned:
    """What tuning made of a configuration."""

    config: Config
    parameters: list[Fitted]
    before: Errors
    after: Errors
    rigid: Errors
    condition: float  # of the scaled Jacobian: how nearly some parameters do the same
    stages: list[str] = field(default_factory=list)  # what each stage did, in words


def tune_coefficients(
    recordings: Sequence[JoinedBag],
    config: Config,
    steps_only: bool = False,
    together: bool = True,
    progress: Progress | None = None,
) -> Tuned:
    """The four stages, from the coefficients of the configuration.

    Args:
        recordings: bags of one robot.
        config: whose model is tuned.
        steps_only: fit over three consecutive steps of each bag, as in the paper; else over everything.
        together: end with all coefficients together; else with the paper's stages.
        progress: called now and then.

    Raises:
        BagError: a bag holds no free run, or no three steps in a row where these are wanted.
        ConfigError: the model has no coefficients.
    """
    report = progress or (lambda fraction, words: None)
    runs = []
    for number, recording in enumerate(recordings):
        report(0.5 * number / len(recordings), f"collecting the terms of {recording.bag.name}")
        runs.append(collect(recording.samples, recording.robot, config))
    windows = judged(recordings, steps_only)
    table = parameter_table()
    bounds = np.array([(table[f"model.{name}"].low, table[f"model.{name}"].high) for name in COEFFICIENTS]).T
    start = np.array([getattr(config.model, name) for name in COEFFICIENTS])
    c = start.copy()
    words: list[str] = []

    def stage(names: str, axes: tuple[int, ...], simulate: Callable[[FreeRun, Array, int], Array], title: str) -> None:
        """Fit some coefficients on the errors along some axes, in place."""
        which = [COEFFICIENTS.index(name) for name in names.split()]

        def residual(values: Array) -> Array:
            trial = c.copy()
            trial[which] = values
            return np.concatenate(
                [
                    _known(run.measured[use] - simulate(run, trial, i)[use])[:, axes].ravel() * 1e3
                    for i, (run, use) in enumerate(zip(runs, windows, strict=True))
                ]
            )

        first = np.clip(c[which], bounds[0, which] + 1e-6, bounds[1, which] - 1e-6)
        report(0.5 + 0.08 * len(words), title)
        found = least_squares(residual, first, bounds=bounds[:, which], x_scale=1.0, xtol=1e-4, ftol=1e-4, max_nfev=30)
        before = float(np.mean(residual(c[which]) ** 2))
        c[which] = found.x
        values = ", ".join(f"{name} = {value:.3f}" for name, value in zip(names.split(), found.x, strict=True))
        words.append(f"{title}: {values}; MSE {before:.3g} -> {float(np.mean(found.fun**2)):.3g} mm^2")

    stage("a1 b1", (0,), lambda run, trial, i: run.run(trial, given=2), "x alone, z from data")
    stage("a2 b2", (2,), lambda run, trial, i: run.run(trial, given=0), "z alone, x from data")
    alone = [np.where(np.isfinite(x := run.run(c, given=2)), x, run.measured) for run in runs]
    stage("c2 e2", (2,), lambda run, trial, i: run.run(trial, given=0, data=alone[i]), "z with the simulated x")
    stage("c1 e1", (0, 2), lambda run, trial, i: run.run(trial), "both simulated")
    if together:
        stage(" ".join(COEFFICIENTS), (0, 2), lambda run, trial, i: run.run(trial), "all together")
    report(0.95, "intervals")

    def both(values: Array) -> Array:
        return np.concatenate(
            [
                _known(run.measured[use, axis] - run.run(values)[use, axis]) * 1e3
                for run, use in zip(runs, windows, strict=True)
                for axis in (0, 2)
            ]
        )

    groups = np.concatenate([np.full(use.sum(), 2 * i + k) for i, use in enumerate(windows) for k in range(2)])
    steps = steps_in(recordings, windows)
    J = np.column_stack([(both(c + h) - both(c - h)) / 2e-4 for h in 1e-4 * np.eye(8)])
    lags = max(1, int(sum(use.sum() for use in windows) / max(steps, 1)))
    parameters, condition = describe(COEFFICIENTS, start, c, J, both(c), groups, lags, bounds, steps)
    tuned = config.replaced(
        {f"model.{name}": float(f"{value:.6g}") for name, value in zip(COEFFICIENTS, c, strict=True)}
    )
    whole = judged(recordings, False)
    three = [_steps_of(recording) for recording in recordings]

    def errors(made: Sequence[Array]) -> Errors:
        return Errors(*(_mse(runs, made, use) for use in (three, whole)))

    return Tuned(
        tuned,
        parameters,
        errors([run.run(start) for run in runs]),
        errors([run.run(c) for run in runs]),
        errors([run.reference for run in runs]),
        condition,
        words,
    )


def chosen(config: Config, names: str) -> list[str]:
    """The parameters that a text with commas names; empty: the paper's coefficients.

    Raises:
        ConfigError: coefficients for a model without them.
    """
    wanted = [name.strip() for name in names.split(",") if name.strip()]
    if not wanted:
        return ["joint_stiffness"] if config.turning else []
    used = [name for name in wanted if name in ("coefficients", *COEFFICIENTS) or name.startswith("share_")]
    if config.turning and used:
        raise ConfigError(
            f"--parameters: {used[0]}: the turning trunk (model.trunk_rotation) does not use the paper's "
            "coefficients (allowed: joint_stiffness, joint_damping, parameters of effects); with --set "
            "model.trunk_rotation=without it is the paper's model"
        )
    if "coefficients" in wanted and len(wanted) > 1:
        raise ConfigError(
            "--parameters: coefficients are fitted alone, in the paper's stages; or name single ones, as a1"
        )
    return [] if wanted == ["coefficients"] else wanted


def steps_in(recordings: Sequence[JoinedBag], windows: Sequence[Array]) -> int:
    """How many complete steps are among the samples (n,) of each recording that count, for the most part."""
    pairs = zip(recordings, windows, strict=True)
    return sum(
        use[step.first : step.last].mean() > 0.5
        for recording, use in pairs
        for step in run_of(recording.predictions).steps()
    )


def judged(recordings: Sequence[JoinedBag], steps_only: bool) -> list[Array]:
    """Which samples (n,) count: where the free run of the untuned model exists; or those of three steps in a row.

    In the frame of the support leg the swing of a leg never counts: while it swings, the other one's frame is used.

    Raises:
        BagError: there are none.
    """
    found = []
    for recording in recordings:
        known = np.array(
            [np.isfinite(p.predicted_com[0]) and np.isfinite(p.measured_com[0]) for p in recording.predictions]
        )
        if not known.any():
            raise BagError(f"{recording.bag}: no free run: neither reference nor support was found")
        if steps_only:
            use = _steps_of(recording)
            if not (known & use).any():
                raise BagError(f"{recording.bag}: no three steps in a row to tune on; leave out --steps")
            known &= use
        found.append(known)
    return found


def _steps_of(recording: JoinedBag) -> Array:
    use = np.zeros(len(recording.predictions), dtype=bool)
    rows = run_of(recording.predictions).consecutive_steps()
    if rows is not None:
        use[rows[0] : rows[1]] = True
    return use


def describe(
    names: Sequence[str],
    before: Array,
    values: Array,
    J: Array,
    residual: Array,
    groups: Array,
    lags: int,
    bounds: Array,
    independent: float,
) -> tuple[list[Fitted], float]:
    """Intervals of fitted parameters, and what is to be said of them; the condition of the scaled Jacobian.

    Args:
        names: (p,).
        before, values: (p,) at the start and fitted.
        J: (n, p) of the residual (n,).
        groups, lags: see `hac_covariance`.
        bounds: (2, p).
        independent: how many independent stretches there are, for Student's quantile.
    """
    size = np.linalg.norm(J, axis=0)
    covariance = hac_covariance(J / np.where(size > 0.0, size, 1.0), residual, lags, groups)
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = covariance / np.outer(sigma, sigma)
        singular = np.linalg.svd(J / np.where(size > 0.0, size, 1.0), compute_uv=False)
        half = quantile(independent - len(names)) * sigma / size
        condition = float(singular[0] / singular[-1])
    found = []
    for i, name in enumerate(names):
        notes = []
        width = half[i] if size[i] > 0.0 else np.inf
        if not np.isfinite(width) or width > _NOT_DETERMINED * max(abs(values[i]), 1e-9):
            notes.append("not identifiable")
        span = bounds[1, i] - bounds[0, i]
        for bound in bounds[:, i]:
            if np.isfinite(bound) and abs(values[i] - bound) < 1e-4 * (span if np.isfinite(span) else 1.0):
                notes.append(f"at its bound {bound:g}")
        notes += [
            f"does nearly what {names[j]} does ({correlation[i, j]:+.2f})"
            for j in range(len(names))
            if j != i and abs(correlation[i, j]) > _CORRELATED
        ]
        low, high = values[i] - width, values[i] + width
        found.append(Fitted(name, float(before[i]), float(values[i]), float(low), float(high), tuple(notes)))
    return found, condition


def _known(values: Array) -> Array:
    """Residuals with zero where a run that diverged has none."""
    return np.nan_to_num(values, nan=0.0)


def _mse(runs: Sequence[FreeRun], made: Sequence[Array], windows: Sequence[Array]) -> dict[str, float]:
    errors = [(run.measured - p)[use] for run, p, use in zip(runs, made, windows, strict=True)]
    together = np.concatenate(errors)
    together = together[np.isfinite(together).all(axis=1)]
    if not len(together):
        return dict.fromkeys("xyz", float("nan"))
    return dict(zip("xyz", np.mean(together[:, :3] ** 2, axis=0).tolist(), strict=True))
