# SPDX-License-Identifier: BSD-3-Clause
"""What the channels of the monitor are like on nominal robots: the section `monitor` of a file of nominal variability.

Of a population a row for each law, of one robot a row for each channel; what a robot's own recordings say is shrunk to
what the population's say.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import digamma, polygamma

from ..bag.session import Session
from ..core.base.types import Array
from ..core.config.schema import Config
from ..core.monitor.channels import KINDS, LEFT, RIGHT, STANDING, Row
from ..core.monitor.levels import LEAST_SCATTER, degrees_of_freedom
from ..errors import BagError
from ..topics import TopicNames
from .inference.variability import spread

LAG = 3  # phases of a kind over which a level that moves is told from noise
LEAST_PHASES = 3  # of a kind in a recording
LEAST_WALKS = 2  # of a robot, that show a channel
# Share of nominal robots whose values may be beyond as many standard deviations as of normal ones.
BEYOND, DEVIATIONS = 0.005, 2.807
PLAUSIBLE = 2.0  # standard deviations over nominal robots, by which one robot's usual value is taken over at most
OWN = 0.2  # of how much nominal robots differ, by which values of one robot are taken to scatter at first
SINGLE = (LEFT, RIGHT)  # kinds of phases


@dataclass(frozen=True)
class Walk:
    """What the monitor saw in one recording of a nominal robot.

    Attributes:
        names: of the n channels.
        rows, nominal: as in `Laws`.
        phases: kind, values (n,) in units of the rows, NaN where not known, which of them are to be zero, and the load
            (n,) of springs [rad].
    """

    names: tuple[str, ...]
    rows: tuple[str, ...]
    nominal: Mapping[str, Row]
    phases: Sequence[tuple[int, Array, NDArray[np.bool_], Array]]

    def values(self, kind: int, only_zero: bool = False) -> Array:
        """Of the phases of a kind (phases, n); NaN where they are not to be zero, if asked for."""
        found = [
            np.where(zero | (not only_zero), values, np.nan) for each, values, zero, _ in self.phases if each == kind
        ]
        return np.array(found).reshape(-1, len(self.names))


@dataclass(frozen=True)
class Noise:
    """Of one channel in one kind of phase of one walk.

    Attributes:
        walk, kind: indices.
        squares: sum of squared differences of successive values, halved.
        count: of these differences.
        lagged: the same over `LAG` phases, the mean; NaN: not known.
    """

    walk: int
    kind: int
    squares: float
    count: int
    lagged: float

    @property
    def freedom(self) -> float:
        """Independent squares that the sum is worth: successive differences have a value in common."""
        return 2.0 * self.count**2 / (3.0 * self.count - 1.0)

    @property
    def variance(self) -> float:
        return self.squares / self.count

    @property
    def log(self) -> float:
        """Unbiased logarithm of the variance."""
        half = 0.5 * self.freedom
        return float(np.log(self.variance) - digamma(half) + np.log(half))


class Mean(NamedTuple):
    """Mean value of one channel, and load, over the phases of a kind of one walk."""

    value: float
    load: float


def watch(bag: str | Path, config: Config, urdf: str | Path | None = None, names: TopicNames | None = None) -> Walk:
    """Run the monitor over a recording of a nominal robot.

    Raises:
        ComanError: the recording, the robot or the configuration cannot be used.
    """
    changes = {"prediction.horizons": [], "monitor.enabled": True, "monitor.baseline": ""}
    with Session(bag, config.replaced(changes), urdf=urdf, names=names) as session:
        monitor = session.pipeline.monitor
        assert monitor is not None
        monitor.kept = []
        for _ in session.predictions():
            pass
        laws = monitor.laws
        phases = [(kind, values / laws.scale, zero, load) for kind, values, zero, load in monitor.kept]
        return Walk(laws.names, laws.rows, laws.nominal, phases)


def rows_of_population(walks: Sequence[Walk], table: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """A row for each law, by one or more recordings of each of many robots."""
    noises, means = _noises(walks), _means(walks)
    return {name: _row_of_law(dict(row), noises.get(name, []), means.get(name, [])) for name, row in table.items()}


def _row_of_law(row: dict[str, Any], noises: Sequence[Noise], means: Sequence[Mean]) -> dict[str, Any]:
    if noises:
        logs, single = np.array([each.log for each in noises]), np.array([each.kind in SINGLE for each in noises])
        for key, these in (("single", single), ("double", ~single)):
            row[key] = float(np.exp(0.5 * np.median(logs[these if these.any() else ~these])))
        usual = 2.0 * np.log(np.where(single, row["single"], row["double"]))
        row["by_robot"], row["by_channel"] = _scatter(noises, logs - usual)
        row["drift"] = _drift(noises)
    if row.get("robots") and means:
        sizes = np.abs([each.value for each in means])
        row["robots"] = float(max(np.sqrt(np.mean(sizes**2)), np.quantile(sizes, 1.0 - BEYOND) / DEVIATIONS))
    return row


def rows_of_robot(walks: Sequence[Walk], table: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """The population's rows, and one for each channel of a robot that two or more recordings of it show.

    Raises:
        BagError: the recordings show different channels.
    """
    names, rows = walks[0].names, dict(zip(walks[0].names, walks[0].rows, strict=True))
    if any(walk.names != names for walk in walks):
        raise BagError("the recordings are not of one robot: their joints differ")
    out = {name: dict(row) for name, row in table.items()}
    noises, means = _noises(walks, own=True), _means(walks, own=True)
    for name, each in noises.items():
        if len({noise.walk for noise in each}) >= LEAST_WALKS:
            row = walks[0].nominal[rows[name]]
            out[name] = _own_noise(row, each) | _own_values(row, means.get(name, []))
    return out


def _own_noise(row: Row, noises: Sequence[Noise]) -> dict[str, Any]:
    """Of one channel of a robot, shrunk to the population's."""
    free = float(degrees_of_freedom(np.array(row.by_channel)))
    found: dict[str, Any] = {"unit": row.unit}
    logs: dict[int, list[float]] = {}
    usual, known = {"single": row.single, "double": row.double}, {}
    for key in usual:
        these = [each for each in noises if (each.kind in SINGLE) == (key == "single")]
        known[key] = sum(each.freedom for each in these)
        squares = sum(each.freedom * each.variance for each in these)
        found[key] = float(np.sqrt((free * usual[key] ** 2 + squares) / (free + known[key])))
        for each in these:
            logs.setdefault(each.walk, []).append(0.5 * each.log - np.log(found[key]))
    if not all(known.values()):  # one kind of support was not seen: as much more or less than usual as in the other
        seen = "single" if known["single"] else "double"
        found |= {key: found[seen] * usual[key] / usual[seen] for key in usual}
    scatter = [float(np.mean(each)) for each in logs.values()]
    found["by_robot"] = max(float(np.sqrt(spread(np.array(scatter), 0.0, row.by_robot**2))), LEAST_SCATTER)
    found["by_channel"] = max(float(0.5 * np.sqrt(polygamma(1, 0.5 * (free + min(known.values()))))), LEAST_SCATTER)
    return found | {"drift": row.drift}


def _own_values(row: Row, means: Sequence[Mean]) -> dict[str, float]:
    """What is usual for one channel of a robot, and how much it varies; shrunk to the population's likewise."""
    if not (row.robots and means):
        return {"robots": row.robots, "by_load": row.by_load}
    values, loads = np.array(means).T
    load = float(loads.mean())
    A, prior = np.column_stack([np.ones(len(values)), loads - load]), np.array([row.robots, max(row.by_load, 1e-9)])
    # Deviations of one robot from its own line are less than those of robots from each other.
    shrink = np.diag(OWN * row.robots / prior)
    usual, slope = np.linalg.lstsq(np.vstack([A, shrink]), np.append(values, np.zeros(2)), rcond=None)[0]
    usual, slope = np.clip([usual, slope], -PLAUSIBLE * prior, PLAUSIBLE * prior)
    own = min(float(np.sqrt(spread(values - A @ (usual, slope), 0.0, row.robots**2))), row.robots)
    covariance = np.linalg.inv(A.T @ A / own**2 + np.diag(prior**-2.0))
    by_load = float(np.sqrt(covariance[1, 1])) if row.by_load else 0.0
    return {
        "robots": own, "by_load": by_load, "usual": float(usual), "usual_load": load, "usual_slope": float(slope),
    }  # fmt: skip


def _noises(walks: Sequence[Walk], own: bool = False) -> dict[str, list[Noise]]:
    """By row, or by channel if of one robot's own."""
    out: dict[str, list[Noise]] = {}
    for w, walk in enumerate(walks):
        for kind in range(len(KINDS)):
            values = walk.values(kind)
            if kind == STANDING or len(values) < LEAST_PHASES:
                continue
            steps, lagged = np.diff(values, axis=0) ** 2, (values[LAG:] - values[:-LAG]) ** 2
            counts = np.isfinite(steps).sum(axis=0)
            for i in np.flatnonzero(np.nansum(steps, axis=0)):  # what never changes says nothing of noise
                far = lagged[:, i][np.isfinite(lagged[:, i])]
                over = 0.5 * float(far.mean()) if len(far) else np.nan
                found = Noise(w, kind, 0.5 * float(np.nansum(steps[:, i])), int(counts[i]), over)
                out.setdefault((walk.names if own else walk.rows)[i], []).append(found)
    return out


def _means(walks: Sequence[Walk], own: bool = False) -> dict[str, list[Mean]]:
    """Likewise."""
    out: dict[str, list[Mean]] = {}
    for walk in walks:
        for kind in range(len(KINDS)):
            values = walk.values(kind, only_zero=True)
            if not len(values):
                continue
            loads = np.mean([load for each, *_, load in walk.phases if each == kind], axis=0)
            for i in np.flatnonzero(np.isfinite(values).any(axis=0)):
                mean = Mean(float(np.nanmean(values[:, i])), float(loads[i]))
                out.setdefault((walk.names if own else walk.rows)[i], []).append(mean)
    return out


def _scatter(noises: Sequence[Noise], logs: Array) -> tuple[float, float]:
    """Standard deviations of the logarithm of the noise, from robot to robot and from channel to channel."""
    walk, sampling = np.array([each.walk for each in noises]), _sampling(noises)
    _, group = np.unique(walk, return_inverse=True)
    means = np.bincount(group, logs) / np.bincount(group)
    freedom = max(len(logs) - len(means), 1)
    within = max(float(np.sum((logs - means[group]) ** 2)) / freedom - sampling, 0.0)
    between = max(float(np.var(logs)) - within - sampling, 0.0)
    return max(0.5 * float(np.sqrt(between)), LEAST_SCATTER), max(0.5 * float(np.sqrt(within)), LEAST_SCATTER)


def _sampling(noises: Sequence[Noise]) -> float:
    """Mean variance of the logarithms by the small numbers of phases."""
    return float(np.mean([polygamma(1, 0.5 * each.freedom) for each in noises]))


def _drift(noises: Sequence[Noise]) -> float:
    """Standard deviation by which a level moves from phase to phase, as a share of that of the noise, at most 1."""
    ratios = [each.lagged / each.variance for each in noises if each.squares > 0.0]
    ratio = float(np.nanmedian(ratios)) if np.isfinite(ratios).any() else 1.0
    return float(np.sqrt(np.clip(2.0 * (ratio - 1.0) / max(LAG - ratio, 1e-9), 0.0, 1.0)))
