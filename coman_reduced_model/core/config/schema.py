# SPDX-License-Identifier: BSD-3-Clause
"""The configuration: one table of parameters, read from a ROS 2 parameter file by nodes and command line alike.

The dataclasses of `sections.py` and `robot/configuration.py` *are* the table: each field carries its nominal, unit,
bounds and description. Its dotted name (`support.contact_on`) is the ROS parameter name. Effects bring their own
parameters, which appear as `effects.<effect>.where` and `effects.<effect>.<parameter>`.
"""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from ...errors import ConfigError
from ..base.parameter import Parameter, Value
from ..effects.base import EffectConfig
from ..effects.catalogue import CATALOGUE
from ..robot.configuration import RobotConfig
from .sections import (
    GaitConfig,
    ModelConfig,
    MonitorConfig,
    OutputConfig,
    PredictionConfig,
    StreamsConfig,
    SupportConfig,
    VirtualRobotConfig,
)

# What the paper's point mass lacks on any robot with springs, by the ablation of `coman validate`.
STANDARD_EFFECTS = ("gravity_stiffness", "trunk_rotation", "swing_momentum", "lateral_compliance")
STANDARD, NOTHING = "standard", "none"  # as entries of effects.active


def nominal_effects(names: Sequence[str]) -> tuple[EffectConfig, ...]:
    """Effects at their only place, the robot, with nominal values."""
    return tuple(
        EffectConfig(name, "", {p.name: float(p.nominal) for p in CATALOGUE[name].parameters})  # type: ignore[arg-type]
        for name in names
    )


@dataclass(frozen=True)
class Config:
    """Everything a robot and its predictor are configured by. Immutable; `replaced` gives a changed copy."""

    robot: RobotConfig = field(default_factory=RobotConfig)
    streams: StreamsConfig = field(default_factory=StreamsConfig)
    support: SupportConfig = field(default_factory=SupportConfig)
    model: ModelConfig = field(default_factory=ModelConfig)
    prediction: PredictionConfig = field(default_factory=PredictionConfig)
    output: OutputConfig = field(default_factory=OutputConfig)
    monitor: MonitorConfig = field(default_factory=MonitorConfig)
    gait: GaitConfig = field(default_factory=GaitConfig)
    virtual_robot: VirtualRobotConfig = field(default_factory=VirtualRobotConfig)
    effects: tuple[EffectConfig, ...] = field(default_factory=lambda: nominal_effects(STANDARD_EFFECTS))
    standard: bool = True  # the standard effects are among them if they can act: nobody named them one by one
    directory: Path = Path()  # of the file it came from: relative paths in it start there

    @property
    def active(self) -> tuple[str, ...]:
        """`effects.active` as it was given, not what it means."""
        names = tuple(dict.fromkeys(effect.name for effect in self.effects))
        if not self.standard:
            return names
        if not takes_standard(self):
            return (STANDARD, *names)
        others = tuple(name for name in names if name not in STANDARD_EFFECTS)
        return (STANDARD, *others) if len(names) - len(others) == len(STANDARD_EFFECTS) else names

    @property
    def turning(self) -> bool:
        """Whether `trunk_rotation` replaces the paper's model."""
        return any(effect.name == "trunk_rotation" for effect in self.effects)

    def flat(self) -> dict[str, Value]:
        """All values by dotted name, effects included."""
        values = dict(_flatten(self))
        names: dict[str, list[EffectConfig]] = {}
        for effect in self.effects:
            names.setdefault(effect.name, []).append(effect)
        values["effects.active"] = tuple(names)
        for name, instances in names.items():
            values[f"effects.{name}.where"] = tuple(instance.where for instance in instances)
            for key in instances[0].values:
                values[f"effects.{name}.{key}"] = tuple(instance.values[key] for instance in instances)
        return values

    def replaced(self, changes: Mapping[str, Any], source: str = "parameters") -> Config:
        """A copy with the dotted keys changed, validated as a file is.

        Raises:
            ConfigError: unknown key, wrong type, out of range, or inconsistent with the rest.
        """
        flat = {**self.flat(), "effects.active": self.active}  # what `standard` means is decided anew
        return config_from_flat({**flat, **changes}, source, self.directory)


def _flatten(section: Any, prefix: str = "") -> list[tuple[str, Value]]:
    values: list[tuple[str, Value]] = []
    for entry in dataclasses.fields(section):
        value = getattr(section, entry.name)
        if "parameter" in entry.metadata:
            values.append((prefix + entry.name, value))
        elif dataclasses.is_dataclass(value):
            values += _flatten(value, f"{prefix}{entry.name}.")
    return values


@cache
def parameter_table() -> dict[str, Parameter]:
    """Every parameter by its dotted name, effects included."""
    table: dict[str, Parameter] = {}

    def collect(section: Any, prefix: str) -> None:
        for entry in dataclasses.fields(section):
            value = getattr(section, entry.name)
            name = prefix + entry.name
            if "parameter" in entry.metadata:
                table[name] = dataclasses.replace(entry.metadata["parameter"], name=name, nominal=value)
            elif dataclasses.is_dataclass(value):
                collect(value, name + ".")

    collect(Config(), "")
    table["effects.active"] = Parameter(
        "effects.active",
        "strs",
        (STANDARD,),
        "",
        f"effects added to the paper's model, in any order; {STANDARD}: {', '.join(STANDARD_EFFECTS)} if the reference "
        f"is the motor side; {NOTHING}: no effect",
        choices=(STANDARD, NOTHING, *CATALOGUE),
    )
    for name, effect in CATALOGUE.items():
        where = f"effects.{name}.where"
        table[where] = Parameter(where, "strs", (), "", f"where {name} acts: {effect.place}; one entry an instance")
        for parameter in effect.parameters:
            key = f"effects.{name}.{parameter.name}"
            nominal = (float(parameter.nominal),)  # type: ignore[arg-type]
            table[key] = dataclasses.replace(parameter, name=key, kind="floats", nominal=nominal)
    return table


def config_from_flat(values: Mapping[str, Any], source: str, directory: Path = Path()) -> Config:
    """A validated configuration from dotted keys; keys not given are nominal.

    Raises:
        ConfigError: says the source, the key, the value and what is allowed.
    """
    table = parameter_table()
    checked: dict[str, Value] = {}
    for key, value in values.items():
        if key not in table:
            hint = difflib.get_close_matches(key, table, 1)
            raise ConfigError(f"{source}: {key}: unknown key{f'; did you mean {hint[0]!r}?' if hint else ''}")
        checked[key] = table[key].check(value, source)

    def build(section: Any, prefix: str) -> Any:
        changes = {}
        for entry in dataclasses.fields(section):
            name = prefix + entry.name
            current = getattr(section, entry.name)
            if "parameter" in entry.metadata:
                changes[entry.name] = checked.get(name, current)
            elif dataclasses.is_dataclass(current):
                changes[entry.name] = build(current, name + ".")
        return dataclasses.replace(section, **changes)

    config: Config = dataclasses.replace(build(Config(), ""), directory=directory)
    named: tuple[str, ...] = checked.get("effects.active", (STANDARD,))  # type: ignore[assignment]
    if NOTHING in named and len(named) > 1:
        raise ConfigError(f"{source}: effects.active: {NOTHING!r} stands alone, not with {', '.join(named)}")
    standard = STANDARD in named
    names = STANDARD_EFFECTS if standard and takes_standard(config) else ()
    active = dict.fromkeys((*names, *(name for name in named if name in CATALOGUE)))
    config = dataclasses.replace(config, standard=standard, effects=_effects(checked, active, source))
    _check_consistency(config, source)
    return config


def takes_standard(config: Config) -> bool:
    """Whether the standard effects can act: they need motor positions, and legs that are built alike."""
    legs = len(config.robot.left.joints), len(config.robot.right.joints)
    return config.prediction.reference == "motor" and legs[0] == legs[1]


def _effects(checked: Mapping[str, Value], active: Iterable[str], source: str) -> tuple[EffectConfig, ...]:
    effects: list[EffectConfig] = []
    for name in active:
        where: tuple[str, ...] = checked.get(f"effects.{name}.where", ()) or ("",)  # type: ignore[assignment]
        values: dict[str, tuple[float, ...]] = {}
        for parameter in CATALOGUE[name].parameters:
            key = f"effects.{name}.{parameter.name}"
            given: tuple[float, ...] = checked.get(key, (float(parameter.nominal),))  # type: ignore[assignment, arg-type]
            if len(given) not in (1, len(where)):
                raise ConfigError(
                    f"{source}: {key}: {len(given)} values for {len(where)} places (effects.{name}.where)"
                )
            values[parameter.name] = given * len(where) if len(given) == 1 else given
        for index, place in enumerate(where):
            CATALOGUE[name].check_place(place, f"{source}: effects.{name}.where")
            effects.append(EffectConfig(name, place, {key: given[index] for key, given in values.items()}))
    return tuple(effects)


def _check_consistency(config: Config, source: str) -> None:
    for side, leg in (("left", config.robot.left), ("right", config.robot.right)):
        for key in ("stiffness", "damping"):
            count = len(getattr(leg, key))
            if count != len(leg.joints):
                raise ConfigError(
                    f"{source}: robot.{side}.{key}: {count} values for {len(leg.joints)} joints (robot.{side}.joints)"
                )
        if len(set(leg.joints)) != len(leg.joints):
            raise ConfigError(f"{source}: robot.{side}.joints: a joint is named twice: {', '.join(leg.joints)}")
    active = {effect.name for effect in config.effects}
    for name in sorted(active):
        for needed in CATALOGUE[name].needs:
            if needed not in active:
                raise ConfigError(f"{source}: effects.active: {name} acts with {needed} alone, which is not active")
    if config.turning and config.prediction.reference != "motor":
        raise ConfigError(
            f"{source}: effects.active: trunk_rotation needs the motor side (prediction.reference: motor), "
            f"not {config.prediction.reference!r}"
        )
    if config.turning and len(config.robot.left.joints) != len(config.robot.right.joints):
        raise ConfigError(
            f"{source}: effects.active: trunk_rotation needs legs of equally many joints, "
            f"not {len(config.robot.left.joints)} and {len(config.robot.right.joints)} (robot.left.joints)"
        )
    if config.support.contact_off >= config.support.contact_on:
        raise ConfigError(
            f"{source}: support.contact_off: {config.support.contact_off} must be below "
            f"support.contact_on = {config.support.contact_on}"
        )
