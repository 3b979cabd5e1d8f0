# SPDX-License-Identifier: BSD-3-Clause
"""What nominal robots are like, as data: how much they vary, what the laws leave on them, and when an effect is named.

The shipped file describes a population of robots (config/nominal.yaml); `coman baseline` writes one for a single robot.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from math import inf, isfinite
from pathlib import Path
from typing import Any

import yaml

from ...errors import ConfigError
from ...resources import config_path

OTHER_ROBOT = 0.01  # of its mass, by which the robot of a baseline may differ
SECTIONS = (
    "source", "widths", "precise", "sheets", "most", "limits", "floor", "sensors", "repeats", "trust", "leftover",
    "decision", "interval_factor", "with_baseline", "parameters", "monitor",
)  # fmt: skip


@dataclass(frozen=True)
class Nominal:
    """How nominal robots differ.

    Attributes:
        widths: by name of a parameter's kind and of the width (`joint_stiffness.scale.spread`): standard deviations.
        precise: by the same names, widths of robots on which all of a part, the foot sensors or all else, is precise.
        sheets: by the same names, by data sheets and what is common: where learning begins, and what it shrinks to.
        most: by the same names, what physics allows at most.
        source: where the figures come from; `kinds`: by axis, the kinds of worlds (sim/worlds) that they were learnt
            on, all but those of `monitor`, which has its own.
        limits: by name, figures chosen by hand: what counts as sure, unlike or seen, as the file says.
        floor: by law, what the best of sensors leaves of its residuals [rad, Nm, N, m, Ns]: quieter ones do not count.
        sensors: the least noise that any sensor is taken to have: `force` in weights, `moment` in weights times the
            length of a foot, `count` of an encoder [rad], `tilt` of a direction [1], `com` of the measured COM [m].
        repeats: by law, what it leaves on nominal robots that repeats with each stride, in the median. In weights for
            N, weights times m for Nm, mass times m/s for Ns, else SI.
        trust: by law and kind of support, the share of its information that counts (diagnose/inference/trust.py).
        leftover: by law and kind of support (`spring|single`), median, and standard deviation of the logarithm, of what
            the laws leave on nominal robots [noise floors].
        decision: weights of the features by which an effect is named, and `alarm`, the probability of `none` up to
            which something is said to be missing (diagnose/inference/decide.py).
        interval_factor: by effect, by which a 95 % interval of the fit is longer; `all`: of any other.
        with_baseline: `decision` and `interval_factor` where a robot's own baseline is known.
        parameters: of one robot, by name of a parameter (`mass@LHipYaw`): what is usual for it, and the spread.
        monitor: by law, see core/monitor/channels.py.
    """

    widths: Mapping[str, float]
    precise: Mapping[str, float] = field(default_factory=dict)
    sheets: Mapping[str, float] = field(default_factory=dict)
    most: Mapping[str, float] = field(default_factory=dict)
    source: Mapping[str, Any] = field(default_factory=dict)
    limits: Mapping[str, float] = field(default_factory=dict)
    floor: Mapping[str, float] = field(default_factory=dict)
    sensors: Mapping[str, float] = field(default_factory=dict)
    repeats: Mapping[str, float] = field(default_factory=dict)
    trust: Mapping[str, float] = field(default_factory=dict)
    leftover: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    decision: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    interval_factor: Mapping[str, float] = field(default_factory=lambda: {"all": 1.0})
    with_baseline: Mapping[str, Any] = field(default_factory=dict)
    parameters: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    monitor: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def width(self, of: str = "", *kinds: str, times: float = 1.0, per: float = 1.0, **names: str) -> dict[str, Any]:
        """Widths for an `Unknown`, with the names by which they were taken.

        Args:
            of: a name in `widths` without its kind.
            kinds: spread, reach, usual: all that it is to have.
            times, per: what those that are relative are multiplied, and divided, by.
            names: by kind, the whole name of a width that is called otherwise.
        """
        used = {kind: f"{of}.{kind}" for kind in kinds} | names
        values = {kind: self.widths[name] * times / per for kind, name in used.items()}
        if (precise := self.precise.get(used.get("spread", ""))) is not None:
            values["precise"] = precise * times / per
        return values | {"widths": used, "relative": times / per}

    def factor_of(self, effect: str) -> float:
        """By which intervals of an effect are longer."""
        return self.interval_factor.get(effect, self.interval_factor["all"])

    def plain(self) -> dict[str, Any]:
        """As a file has it."""
        return {name: _plain(getattr(self, name)) for name in SECTIONS if getattr(self, name)}


def of_another_robot(nominal: Nominal, mass: float) -> list[str]:
    """That a baseline was learnt from a robot of another mass than this one's [kg], by its description."""
    learnt = nominal.source.get("mass_kg")
    if not isinstance(learnt, float) or abs(learnt - mass) <= OTHER_ROBOT * mass:
        return []
    name = nominal.source.get("robot", "a robot")
    return [f"the baseline is of {name} of {learnt:.4g} kg, this robot has {mass:.4g} kg: is it of another one?"]


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, tuple | list):
        return [_plain(each) for each in value]
    return float(f"{value:.4g}") if isinstance(value, float) else value


def load_nominal(path: str | Path = "") -> Nominal:
    """Read a file; default: the shipped population. A file of one robot is complete in itself, but for `monitor`.

    What it lacks, as an earlier version did not know it, is that of the population.

    Raises:
        ConfigError: it cannot be read, or is no such file.
    """
    population = _population()
    if not path:
        return population
    nominal = _read(path)  # each time: a baseline may be learnt again while a node runs
    if nominal.widths.get("external_force.reach", 0.0) > 1.0:  # in weights
        raise ConfigError(f"{path}: of an earlier version, with widths in N and Nm: learn it again (coman baseline)")
    if unknown := set(nominal.limits) - set(population.limits):
        raise ConfigError(
            f"{path}: limits: {', '.join(sorted(unknown))}: unknown; known: {', '.join(population.limits)}"
        )
    names = ("widths", "limits", "floor", "sensors", "trust", "repeats", "leftover", "most")
    both = {name: {**getattr(population, name), **getattr(nominal, name)} for name in names}
    nominal = replace(nominal, **both)
    if _known(nominal.decision):
        return nominal
    usual = {"decision": population.decision, "interval_factor": population.interval_factor}
    return replace(nominal, **(population.with_baseline or usual))


def _row(row: Mapping[str, Any]) -> dict[str, Any]:
    """A row of `monitor`: a unit, and numbers that are above 0 if they are noise."""
    if "unit" not in row:
        raise ValueError("a row of 'monitor' without 'unit'")
    if "by_robot" in row and not {"single", "double"} <= set(row):  # of earlier versions: not looked at
        raise ValueError("a row of 'monitor' without its noise ('single', 'double')")
    numbers = {key: float(value) for key, value in row.items() if key != "unit"}
    for key, value in numbers.items():
        if not (isfinite(value) and (value > 0.0 or key not in ("single", "double"))):
            raise ValueError(f"{key}: {value}")
    return {"unit": str(row["unit"]), **numbers}


def _factors(document: Mapping[str, Any]) -> dict[str, float]:
    """Factors on intervals, from 1 on; a file of an earlier version has one for all effects."""
    found = document.get("interval_factor") or 1.0
    factors = {"all": 1.0} | {k: float(v) for k, v in (found if isinstance(found, Mapping) else {"all": found}).items()}
    for name, value in factors.items():
        if not 1.0 <= value < inf:
            raise ValueError(f"interval_factor of {name}: {value}, not from 1 on")
    return factors


def _decision(document: Mapping[str, Any]) -> dict[str, dict[str, float]]:
    """Weights; an alarm is a probability."""
    found = {
        name: {key: float(value) for key, value in weights.items()}
        for name, weights in (document.get("decision") or {}).items()
    }
    for weights in found.values():
        if "alarm" in weights:
            _share("alarm", weights["alarm"])
    return found


def _with_baseline(document: Mapping[str, Any]) -> dict[str, Any]:
    """What replaces fields of a record; nothing, if there is none, or that of an earlier version."""
    decision = _decision(document)
    return {"decision": decision, "interval_factor": _factors(document)} if _known(decision) else {}


def _known(decision: Mapping[str, Mapping[str, float]]) -> bool:
    """Whether weights are of features that this version knows."""
    wanted = {"one", "evidence", "ways", "unknown"}
    return {"selected", "alone"} <= set(decision) and all(wanted <= set(weights) for weights in decision.values())


def _share(name: str, value: Any) -> float:
    """A value above 0 and up to 1."""
    if not 0.0 < float(value) <= 1.0:
        raise ValueError(f"{name}: {value}, not above 0 and up to 1")
    return float(value)


@cache
def _population() -> Nominal:
    return _read(config_path("nominal"))


def _finite(values: Mapping[str, Any] | None) -> dict[str, float]:
    """Numbers by name."""
    found = {name: float(value) for name, value in (values or {}).items()}
    for name, value in found.items():
        if not isfinite(value):
            raise ValueError(f"{name}: {value}")
    return found


def _limits(values: Mapping[str, Any] | None) -> dict[str, float]:
    """Numbers above 0 by name."""
    found = _finite(values)
    for name, value in found.items():
        if value <= 0.0:
            raise ValueError(f"limits: {name}: {value}, not above 0")
    return found


def _pairs(values: Mapping[str, Any] | None) -> dict[str, tuple[float, float]]:
    """The same of two numbers each."""
    pairs = {name: (a, b) for name, (a, b) in (values or {}).items()}
    first, second = (_finite({name: pair[k] for name, pair in pairs.items()}) for k in (0, 1))
    return {name: (first[name], second[name]) for name in pairs}


def _read(path: str | Path) -> Nominal:
    try:
        document = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (UnicodeDecodeError, yaml.YAMLError):
        raise ConfigError(f"{path}: is not YAML") from None
    if not isinstance(document, dict) or not isinstance(document.get("widths"), dict):
        raise ConfigError(f"{path}: wanted a file of nominal variability, with 'widths:' (coman baseline writes one)")
    if unknown := set(document) - set(SECTIONS):
        raise ConfigError(f"{path}: {', '.join(sorted(unknown))}: unknown; known: {', '.join(SECTIONS)}")
    try:
        return Nominal(
            widths=_finite(document["widths"]),
            precise=_finite(document.get("precise")),
            sheets=_finite(document.get("sheets")),
            most=_finite(document.get("most")),
            limits=_limits(document.get("limits")),
            floor=_finite(document.get("floor")),
            sensors=_finite(document.get("sensors")),
            source=dict(document.get("source") or {}),
            repeats=_finite(document.get("repeats")),
            trust={name: _share(f"trust of {name}", value) for name, value in (document.get("trust") or {}).items()},
            leftover=_pairs(document.get("leftover")),
            decision=_decision(document),
            interval_factor=_factors(document),
            with_baseline=_with_baseline(document.get("with_baseline") or {}),
            parameters=_pairs(document.get("parameters")),
            monitor={name: _row(row) for name, row in (document.get("monitor") or {}).items()},
        )
    except (TypeError, ValueError, AttributeError, OverflowError) as error:
        raise ConfigError(f"{path}: a value of a wrong kind: {error}") from None
