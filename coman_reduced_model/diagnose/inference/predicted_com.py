# SPDX-License-Identifier: BSD-3-Clause
"""What effects do to the predicted COM: the laws find an effect, and it goes into the model if this is no worse."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from ...bag.session import Session
from ...core.base.types import Array, Flags, Foot, Integers, Phase
from ...core.config.schema import Config
from ...core.effects.base import EffectConfig
from ...core.effects.catalogue import CATALOGUE, Effect, build_effects
from ...core.evaluation.statistics import AXES, by_axis
from ...core.robot.robot import Robot
from ...processes import workers
from ...topics import TopicNames
from ..data.streams import longest_run, rising

CONFIDENCE = 0.95


@dataclass(frozen=True)
class FreeRun:
    """The free run of one model over one bag, n samples; COM [m] in the frame of the support sole, NaN if not known.

    Attributes:
        stamps: (n,) [ns], rising: of a bag that starts again, those of the longest run.
        foot, phase: (n,) support foot and phase.
        run: (n,) number of the free run that a sample belongs to: one begins at each reset.
        measured, predicted: (n, 3).
        q: (n, nj) link positions [rad], as effects correct them.
        robot, loads: as the URDF has it, and the effects that change its masses.
    """

    stamps: Integers
    foot: Integers
    phase: Integers
    run: Integers
    measured: Array
    predicted: Array
    q: Array
    robot: Robot
    loads: tuple[EffectConfig, ...]


@dataclass(frozen=True)
class Errors:
    """Measured minus predicted COM without and with some effects, at the n samples where both are known.

    Attributes:
        times: (n,) [s] since the first; step: (n,) number of the step, from touchdown to touchdown.
        before, after: (n, 3) [m].
    """

    times: Array
    step: Integers
    before: Array
    after: Array


@dataclass(frozen=True)
class Change:
    """What effects make of the error of the predicted COM, by axis (3,).

    Attributes:
        before, after: root mean square [m]; NaN where no COM was predicted.
        low, high: 95 % interval of the change of the mean squared error [m^2]; infinite for less than two steps.
        steps: number of steps that were compared.
    """

    before: Array
    after: Array
    low: Array
    high: Array
    steps: int

    @property
    def worse(self) -> bool:
        """Whether an axis is worse beyond chance."""
        return bool((self.low > 0.0).any())

    def __str__(self) -> str:
        """The error before and after, along the axes that are worse."""
        sizes = zip(AXES, 1e3 * self.before, 1e3 * self.after, self.low > 0.0, strict=True)
        named = [f"{axis} {old:.3f} to {new:.3f}" for axis, old, new, worse in sizes if worse or not self.worse]
        return ", ".join(named) + " mm"

    def plain(self) -> dict[str, Any]:
        """For diagnosis.json."""
        return {
            "before": by_axis(self.before),
            "after": by_axis(self.after),
            "change": by_axis(np.column_stack([self.low, self.high])),
            "steps": self.steps,
        }


def free_run(
    path: str | Path, config: Config, urdf: str | Path | None = None, names: TopicNames | None = None
) -> FreeRun:
    """Predict a bag. A prediction that diverged is not known, the error until then counts."""
    quick = dataclasses.replace(
        config,
        prediction=dataclasses.replace(config.prediction, horizons=()),
        monitor=dataclasses.replace(config.monitor, enabled=False),
        model=dataclasses.replace(config.model, slope="level"),  # a slope is an effect to be found
    )
    rows: list[tuple[float, ...]] = []
    positions: list[Array] = []
    with Session(path, quick, urdf=urdf, names=names) as session:
        robot, pipeline = session.robot, session.pipeline
        for batch in session.batches():
            for p in pipeline.predict(batch):
                support = p.support
                row = (p.stamp_ns, support.support_foot, support.phase, p.flags, *p.measured_com, *p.predicted_com)
                rows.append(row)
            positions += [sample.q for sample in batch]  # as effects have corrected them while predicting
    stamps = np.array([row[0] for row in rows], dtype=np.int64)
    begin, end, _ = longest_run(stamps, config.streams.restart_gap)  # what is diagnosed
    later = begin + np.flatnonzero(rising(stamps[begin:end]))
    values = np.array([row[1:] for row in rows], dtype=float).reshape(-1, 9)[later]
    foot, phase, flags = values[:, :3].T.astype(int)
    measured, predicted = values[:, 3:6], values[:, 6:]
    predicted[(flags & Flags.REJECTED_STATE) != 0] = np.nan
    run, q = np.cumsum((flags & Flags.RESET) != 0), np.array(positions).reshape(len(rows), -1)[later]
    loads = tuple(effect for effect in config.effects if CATALOGUE[effect.name].load is not Effect.load)
    return FreeRun(stamps[later], foot, phase, run, measured, predicted, q, robot, loads)


def errors(before: FreeRun, after: FreeRun) -> Errors:
    """Of two models of one bag, both against the sensors as the model after corrects them, and at its stamps.

    The COM is that of each model's own masses: the point that it predicts. Where the stamps of the models differ, the
    prediction before is interpolated within its free run; where they take different feet for the support, frames
    differ and nothing is compared.
    """
    i = np.searchsorted(before.stamps, after.stamps, side="right") - 1  # the last that is not later
    j = np.searchsorted(before.stamps, after.stamps)  # the first that is not earlier; the same one if the stamps agree
    inside = np.flatnonzero((i >= 0) & (j < len(before.stamps)))
    i, j = i[inside], j[inside]
    apart = np.maximum(before.stamps[j] - before.stamps[i], 1)
    weight = ((after.stamps[inside] - before.stamps[i]) / apart)[:, None]
    predicted = before.predicted[i] + weight * (before.predicted[j] - before.predicted[i])
    measured = after.measured if before.loads == after.loads else _measured(after, before.loads)
    old, new = measured[inside] - predicted, after.measured[inside] - after.predicted[inside]
    foot = before.foot[i]
    same = (before.run[i] == before.run[j]) & (foot == before.foot[j]) & (foot == after.foot[inside])
    good = np.flatnonzero(same & np.isfinite(old).all(axis=1) & np.isfinite(new).all(axis=1))
    stamps = after.stamps[inside][good]
    since = np.asarray((stamps - stamps[:1]) * 1e-9 if len(stamps) else np.zeros(0), dtype=float)
    return Errors(since, _steps(after.phase)[inside][good], old[good], new[good])


def _measured(run: FreeRun, loads: tuple[EffectConfig, ...]) -> Array:
    """(n, 3) The COM of a run as it is measured of a robot with other loads."""
    posture, still = build_effects(loads, run.robot)[1].posture(), np.zeros(run.q.shape[1])
    out = np.full_like(run.measured, np.nan)
    for k in np.flatnonzero(run.foot != Foot.NONE):
        posture.update(run.q[k], still)
        out[k] = posture.com_in_sole(run.foot[k])[0]
    return out


def _steps(phase: Integers) -> Integers:
    """(n,) number of the step: one ends where a single support does."""
    single = np.isin(phase[:-1], (Phase.LEFT, Phase.RIGHT))
    return np.cumsum(np.append(0, single & (np.diff(phase) != 0))[: len(phase)])


def change(bags: Sequence[Errors]) -> Change:
    """What two models differ in, over some bags."""
    differences = [each.after**2 - each.before**2 for each in bags]
    means = [
        difference[each.step == step].mean(axis=0)
        for each, difference in zip(bags, differences, strict=True)
        for step in np.unique(each.step)
    ]
    low, high = interval(np.array(means).reshape(-1, 3))
    return Change(rms([each.before for each in bags]), rms([each.after for each in bags]), low, high, len(means))


def interval(values: Array) -> tuple[Array, Array]:
    """95 % interval (k,), (k,) of the mean of n independent values (n, k), of which no variance is known."""
    n = len(values)
    if n < 2:
        unknown = np.full(values.shape[1], np.inf)
        return -unknown, unknown
    half = stats.t.ppf(0.5 + 0.5 * CONFIDENCE, n - 1) * values.std(axis=0, ddof=1) / np.sqrt(n)
    mean = values.mean(axis=0)
    return mean - half, mean + half


def rms(bags: Sequence[Array]) -> Array:
    """(3,) Root mean square of errors (n, 3) of some bags, which count alike; NaN where there are none."""
    squares = [np.mean(each**2, axis=0) for each in bags if len(each)]
    return np.sqrt(np.mean(squares, axis=0)) if squares else np.full(3, np.nan)


def admitted(
    count: int, runs: Callable[[tuple[int, ...]], Sequence[FreeRun]]
) -> tuple[tuple[int, ...], dict[int, Change]]:
    """Which effects go into the model: those that worsen the predicted COM are left out one by one, the worst first.

    An effect is judged by the model with all that are left against the same without it, and all together against none.

    Args:
        count: of the effects.
        runs: by effects, the free runs of a model with these over the bags that judge them.

    Returns:
        The effects that stay; of each effect, what it changes beside the others that were left when it was last judged.
    """
    runs = cache(runs)

    def compared(without: tuple[int, ...], with_them: tuple[int, ...]) -> Change:
        return change([errors(*both) for both in zip(runs(without), runs(with_them), strict=True)])

    kept = tuple(range(count))
    changes: dict[int, Change] = {}
    while kept:
        changes |= {i: compared(tuple(k for k in kept if k != i), kept) for i in kept}
        worse = [i for i in kept if changes[i].worse] or (list(kept) if compared((), kept).worse else [])
        if not worse:
            break
        worst = max(worse, key=lambda i: float(np.sum(changes[i].after ** 2 - changes[i].before ** 2)))
        kept = tuple(i for i in kept if i != worst)
    return kept, changes


class FreeRuns:
    """Free runs of models that differ in their effects, each made once; every other one in another process."""

    def __init__(
        self,
        helper: Executor,
        urdf: str | Path | None = None,
        names: TopicNames | None = None,
        predict: Callable[..., FreeRun] = free_run,
    ) -> None:
        """Take the executor of the other process, and a function as `free_run`."""
        self._helper, self._urdf, self._names, self._predict = helper, urdf, names, predict
        self._known: dict[tuple[str, str], FreeRun | Future[FreeRun]] = {}

    def start(self, paths: Sequence[str | Path], config: Config) -> None:
        """Begin to predict the bags in the other process."""
        for path in paths:
            key = str(path), repr(config.effects)
            if key not in self._known:
                self._known[key] = self._helper.submit(self._predict, path, config, self._urdf, self._names)

    def of(self, paths: Sequence[str | Path], config: Config) -> list[FreeRun]:
        """By bag."""
        effects = repr(config.effects)
        missing = [path for path in paths if (str(path), effects) not in self._known]
        self.start(missing[1::2], config)
        for path in missing[::2]:
            self._known[str(path), effects] = self._predict(path, config, self._urdf, self._names)
        made = [self._known[str(path), effects] for path in paths]
        return [each.result() if isinstance(each, Future) else each for each in made]


@contextmanager
def free_runs_in_helper(urdf: str | Path | None, names: TopicNames | None) -> Iterator[FreeRuns]:
    """Free runs with a helper process; an exception, Ctrl-C among them, ends it."""
    with workers(1, method="spawn") as helper:
        yield FreeRuns(helper, urdf, names)


class _Here(Executor):
    """Calls at once, in this process."""

    def submit(self, call: Callable[..., Any], /, *arguments: Any, **named: Any) -> Future[Any]:
        done: Future[Any] = Future()
        done.set_result(call(*arguments, **named))
        return done


@contextmanager
def free_runs_here(urdf: str | Path | None, names: TopicNames | None) -> Iterator[FreeRuns]:
    """Free runs without a second process: for a worker beside others that keep the cores busy."""
    yield FreeRuns(_Here(), urdf, names)
