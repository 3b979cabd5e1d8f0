# SPDX-License-Identifier: BSD-3-Clause
"""Tuning any parameters of any model: the predictor itself runs over the samples, in two processes.

For models without the paper's coefficients, such as the turning trunk: ratios of the joint springs (`joint_stiffness`,
`joint_damping`: the soft joints of each leg), parameters of effects, and numbers of the model section (`friction`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from ..core.base.types import Array
from ..core.config.schema import Config, parameter_table
from ..core.effects.base import Effect
from ..core.effects.catalogue import CATALOGUE
from ..core.evaluation.run import Run, run_of
from ..errors import ConfigError
from ..processes import workers
from ..progress import Progress
from .recording import JoinedBag
from .tune import Errors, Tuned, _known, _steps_of, describe, judged, steps_in

JOINTS = ("joint_stiffness", "joint_damping")
_SOFT = 3.0  # joints up to this many times as stiff as the softest of their leg
_STEP = 0.02  # of a parameter, relative: wider than the noise of restarts, narrow against what matters
_WIDE = 1.0  # bounds that are further apart say nothing of what is usual
_RATIO = (0.3, 3.0)  # bounds of joint ratios


@dataclass(frozen=True)
class Knob:
    """One number to be fitted: where it is in the configuration, as a ratio or as it is."""

    name: str
    key: str
    index: int  # in a list; -1: no list
    ratio: bool
    start: float
    low: float
    high: float


def knobs(config: Config, names: Sequence[str]) -> list[Knob]:
    """The numbers that names stand for.

    Raises:
        ConfigError: a name stands for nothing in this configuration; says what is allowed.
    """
    flat, table = config.flat(), parameter_table()
    found: list[Knob] = []
    for name in names:
        if name in JOINTS:
            found += _joint_knobs(config, name)
            continue
        keys = [key for key in (name, f"model.{name}") if isinstance(flat.get(key), float)]
        keys += [
            key for key in flat if key.startswith("effects.") and key.endswith(f".{name}") and key[-6:] != ".where"
        ]
        if not keys:
            active = [
                k.split(".", 1)[1]
                for k in flat
                if k.startswith("effects.") and k.count(".") == 2 and k[-6:] != ".where"
            ]
            raise ConfigError(
                f"--parameters: {name!r} is no number of this configuration (allowed: {', '.join([*JOINTS, *active])}, "
                "or a key such as model.share_x_before)"
            )
        for key in keys:
            effect = CATALOGUE.get(key.split(".")[1]) if key.startswith("effects.") else None
            if effect is not None and effect.late is not Effect.late:
                raise ConfigError(f"--parameters: {key}: changes when samples are joined, which is not tuned")
            low, high = table[key].low, table[key].high
            values = flat[key] if isinstance(flat[key], tuple) else (flat[key],)
            for index, value in enumerate(values):  # type: ignore[arg-type]
                where = index if isinstance(flat[key], tuple) else -1
                place = f"[{index}]" if len(values) > 1 else ""  # type: ignore[arg-type]
                found.append(Knob(f"{name}{place}", key, where, False, float(value), low, high))  # type: ignore[arg-type]
    if not found:
        raise ConfigError(f"--parameters: {', '.join(names)}: nothing to fit: the legs have none that is above 0")
    return found


def _joint_knobs(config: Config, name: str) -> list[Knob]:
    found = []
    kind = name.removeprefix("joint_")
    for side, leg in (("left", config.robot.left), ("right", config.robot.right)):
        softest = min(leg.stiffness)
        for index, joint in enumerate(leg.joints):
            if leg.stiffness[index] <= _SOFT * softest and getattr(leg, kind)[index] > 0.0:
                found.append(Knob(f"{name}({joint})", f"robot.{side}.{kind}", index, True, 1.0, *_RATIO))
    return found


def changed(config: Config, knobs: Sequence[Knob], values: Sequence[float] | Array) -> Config:
    """The configuration with the knobs set."""
    flat: dict[str, Any] = config.flat()
    changes: dict[str, Any] = {}
    for knob, value in zip(knobs, values, strict=True):
        old = changes.get(knob.key, flat[knob.key])
        if knob.index < 0:
            changes[knob.key] = float(value)
            continue
        new = list(old)
        new[knob.index] = float(f"{flat[knob.key][knob.index] * value if knob.ratio else value:.6g}")
        changes[knob.key] = new
    return config.replaced(changes, "tuned")


# What each worker process keeps between its tasks.
_work: tuple[Sequence[JoinedBag], Config, Sequence[Knob], Sequence[Array], tuple[int, ...]]


def _begin(*work: Any) -> None:
    global _work
    _work = work


def _runs(values: Array) -> list[Run]:
    """The model with these values over each bag."""
    recordings, config, chosen, _, _ = _work
    trial = changed(config, chosen, values)
    return [run_of(recording.predict(trial)) for recording in recordings]


def _residual(values: Array) -> Array:
    """Measured minus predicted [mm], axis after axis and bag after bag."""
    recordings, config, chosen, windows, axes = _work
    trial = changed(config, chosen, values)
    parts = []
    for recording, use in zip(recordings, windows, strict=True):
        error = np.array([p.residual for p in recording.predict(trial)])
        parts += [_known(error[use, axis]) * 1e3 for axis in axes]
    return np.concatenate(parts)


def tune_parameters(
    recordings: Sequence[JoinedBag],
    config: Config,
    names: Sequence[str],
    steps_only: bool = False,
    processes: int = 2,
    progress: Progress | None = None,
) -> Tuned:
    """Fit named parameters on x and z (and y, where the model predicts it) together.

    Arguments and errors as in `tune_coefficients`.
    """
    config = config.replaced({"prediction.horizons": (), "prediction.adapt": False})
    chosen = knobs(config, names)
    windows = judged(recordings, steps_only)
    lateral = config.uses("lateral_compliance")
    axes = (0, 1, 2) if lateral else (0, 2)
    low, high = np.array([k.low for k in chosen]), np.array([k.high for k in chosen])
    start = np.clip([k.start for k in chosen], low, high)
    scale = 0.1 * np.where(high - low < _WIDE, high - low, 1.0)  # of parameters that may be 0
    report = progress or (lambda fraction, words: None)
    done = 0
    with workers(processes, _begin, (recordings, config, chosen, windows, axes)) as pool:
        known: dict[bytes, Array] = {}

        def evaluate(points: Sequence[Array]) -> list[Array]:
            nonlocal done
            new = [p for p in points if p.tobytes() not in known]
            known.update(zip([p.tobytes() for p in new], pool.map(_residual, new), strict=True))
            done += len(new)
            report(1.0 - 0.93 ** (done / (1 + len(chosen))), f"{done} runs of the model")
            return [known[p.tobytes()] for p in points]

        def jacobian(x: Array) -> Array:
            steps = _STEP * np.maximum(np.abs(x), scale)
            steps = np.where(x + steps > high, -steps, steps)
            base, *moved = evaluate([x, *(x + h for h in np.diag(steps))])
            return np.column_stack([(m - base) / h for m, h in zip(moved, steps, strict=True)])

        found = least_squares(
            lambda x: evaluate([x])[0], start, jacobian, bounds=(low, high), x_scale=np.maximum(np.abs(start), scale),
            xtol=3e-3, ftol=1e-3, max_nfev=8,
        )  # fmt: skip
        runs = list(pool.map(_runs, (start, found.x)))
    groups = np.concatenate(
        [np.full(use.sum(), len(axes) * i + k) for i, use in enumerate(windows) for k in range(len(axes))]
    )
    steps = steps_in(recordings, windows)
    lags = max(1, int(sum(use.sum() for use in windows) / max(steps, 1)))
    parameters, condition = describe(
        [k.name for k in chosen], start, found.x, found.jac, found.fun, groups, lags, np.array([low, high]), steps
    )
    tuned = changed(config, chosen, found.x)
    before, after = (_errors(recordings, [run.residual for run in part]) for part in runs)
    return Tuned(
        tuned,
        parameters,
        before,
        after,
        _errors(recordings, [run.deflection for run in runs[0]]),
        condition,
        [f"{', '.join(names)}: {found.nfev} iterations"],
    )


def _errors(recordings: Sequence[JoinedBag], residuals: Sequence[Array]) -> Errors:
    def mse(windows: Sequence[Array]) -> dict[str, float]:
        together = np.concatenate([r[use] for r, use in zip(residuals, windows, strict=True)])
        together = together[np.isfinite(together).all(axis=1)]
        means = np.mean(together**2, axis=0) if len(together) else np.full(3, np.nan)
        return dict(zip("xyz", means.tolist(), strict=True))

    return Errors(mse([_steps_of(r) for r in recordings]), mse(judged(recordings, False)))
