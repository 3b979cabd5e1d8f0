# SPDX-License-Identifier: BSD-3-Clause
"""The configuration: one table of parameters, read from a ROS 2 parameter file by nodes and command line alike.

The dataclasses of `sections.py` and `robot/configuration.py` *are* the table: each field carries its nominal, unit,
bounds and description. Its dotted name (`support.contact_on`) is the ROS parameter name. Effects bring their own
parameters, which appear as `effects.<effect>.where` and `effects.<effect>.<parameter>`.
"""

from __future__ import annotations

import dataclasses
import difflib
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...errors import ConfigError
from ..base.parameter import Parameter, Value
from ..effects.base import EffectConfig
from ..effects.catalogue import CATALOGUE
from ..robot.configuration import RobotConfig
from .sections import (
    OPTIONS,
    GaitConfig,
    ModelConfig,
    MonitorConfig,
    OutputConfig,
    PredictionConfig,
    StreamsConfig,
    SupportConfig,
    VirtualRobotConfig,
)

if TYPE_CHECKING:
    from ..robot.robot import Robot

LEGS = ("left", "right")
STANDARD, NOTHING = "standard", "none"  # in effects.active of version 0.1, beside the names of the options


def nominal_effects(names: Sequence[str]) -> tuple[EffectConfig, ...]:
    """Effects at their only place, the robot, with nominal values."""
    return tuple(
        EffectConfig(name, "", {p.name: float(p.nominal) for p in CATALOGUE[name].parameters})  # type: ignore[arg-type]
        for name in names
    )


FILES = ("robot.urdf", "monitor.baseline")  # keys that name files


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
    effects: tuple[EffectConfig, ...] = ()
    directory: Path = Path()  # of the file it came from: relative paths in it start there
    notes: tuple[str, ...] = field(default=(), compare=False)  # what was read of an older version, a line each

    @property
    def urdf(self) -> Path | None:
        """The file of `robot.urdf`; None: the configuration names none."""
        return self._file(self.robot.urdf)

    @property
    def baseline(self) -> Path | None:
        """The file of `monitor.baseline`; None: the configuration names none."""
        return self._file(self.monitor.baseline)

    def _file(self, name: str) -> Path | None:
        # Unlike Path.expanduser, this leaves a home that it does not find, and the file is not found.
        return self.directory / os.path.expanduser(name) if name else None  # noqa: PTH111

    @property
    def active(self) -> tuple[str, ...]:
        """`effects.active`: the names of the effects, each once."""
        return tuple(dict.fromkeys(effect.name for effect in self.effects))

    def uses(self, option: str) -> bool:
        """Whether the model has an option of `OPTIONS`; `auto` follows from the reference and the legs."""
        choice = getattr(self.model, option)
        if choice != "auto":
            return bool(choice == "with")
        return can_turn(self) if option == "trunk_rotation" else self.turning

    def with_urdf(self, path: str | Path | None) -> Config:
        """The same of the robot of a file, wherever it is used from; None: as it is."""
        return self if path is None else self.replaced({"robot.urdf": str(Path(path).absolute())})

    def with_joints_of(self, robot: Robot) -> Config:
        """The same with the joints of legs for which it names none, as the robot's chains have them."""
        legs = {
            side: dataclasses.replace(getattr(self.robot, side), joints=getattr(robot.config, side).joints)
            for side in LEGS
            if not getattr(self.robot, side).joints
        }
        return dataclasses.replace(self, robot=dataclasses.replace(self.robot, **legs)) if legs else self

    @property
    def turning(self) -> bool:
        """Whether the turning trunk replaces the paper's point mass."""
        return self.uses("trunk_rotation")

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
        changed = config_from_flat({**self.flat(), **changes}, source, self.directory)
        return dataclasses.replace(changed, notes=(*self.notes, *changed.notes))


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
        (),
        "",
        "what the robot or its sensors have beside the model, in any order",
        choices=tuple(CATALOGUE),
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
    values, notes = without_old_keys(values)
    values = _leave_joints_to_the_chain(values)
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

    config: Config = dataclasses.replace(build(Config(), ""), directory=directory, notes=notes)
    named: tuple[str, ...] = checked.get("effects.active", ())  # type: ignore[assignment]
    config = dataclasses.replace(config, effects=_effects(checked, dict.fromkeys(named), source))
    _check_consistency(config, source)
    return config


def _leave_joints_to_the_chain(values: Mapping[str, Any]) -> Mapping[str, Any]:
    """A leg that is described without its joints has those of its chain, not those of COMAN."""
    sides = {side for side in LEGS for key in values if key.startswith(f"robot.{side}.")}
    return {**{f"robot.{side}.joints": () for side in sides}, **values}


def without_old_keys(values: Mapping[str, Any]) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Keys of version 0.1 as those of today, and a line for each that was changed.

    Then the options of the model were entries of `effects.active`, `standard` was all of them where they can act, and
    `none` was the paper's model.
    """
    values, notes = dict(values), []
    named = values.get("effects.active")
    if isinstance(named, (list, tuple)):  # "" is how ROS dumps an empty list
        values["effects.active"] = named = [name for name in named if name != ""]
    else:
        named = []
    old = [name for name in named if name in (*OPTIONS, STANDARD, NOTHING)]
    if old:
        values["effects.active"] = [name for name in named if name not in old]
        for option in OPTIONS:
            chosen = "auto" if STANDARD in old else "with" if option in old else "without"
            values[f"model.{option}"] = chosen
        now = ", ".join(f"model.{option}: {values['model.' + option]}" for option in OPTIONS)
        notes.append(f"effects.active: {', '.join(old)}: options of the model have keys of their own now ({now})")
    for option in OPTIONS:
        values.pop(f"effects.{option}.where", None)
    friction = values.pop("effects.trunk_rotation.friction", None)
    if friction is not None:
        values["model.friction"] = friction[0] if isinstance(friction, (list, tuple)) and friction else friction
        notes.append("effects.trunk_rotation.friction: now model.friction")
    return values, tuple(notes)


def can_turn(config: Config) -> bool:
    """Whether the trunk can turn: it needs motor positions, and legs that are built alike."""
    legs = len(config.robot.left.stiffness), len(config.robot.right.stiffness)
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
            if leg.joints and count != len(leg.joints):
                raise ConfigError(
                    f"{source}: robot.{side}.{key}: {count} values for {len(leg.joints)} joints "
                    f"(robot.{side}.joints: {', '.join(leg.joints)})"
                )
        if len(leg.stiffness) != len(leg.damping):
            raise ConfigError(
                f"{source}: robot.{side}.stiffness: {len(leg.stiffness)} values, but {len(leg.damping)} of "
                f"robot.{side}.damping"
            )
        if len(set(leg.joints)) != len(leg.joints):
            raise ConfigError(f"{source}: robot.{side}.joints: a joint is named twice: {', '.join(leg.joints)}")
    if config.model.swing_momentum == "with" and not config.turning:
        raise ConfigError(f"{source}: model.swing_momentum: acts with model.trunk_rotation alone, which is off")
    if config.turning and config.prediction.reference != "motor":
        raise ConfigError(
            f"{source}: model.trunk_rotation: needs the motor side (prediction.reference: motor), "
            f"not {config.prediction.reference!r}"
        )
    counts = [len(leg.stiffness) for leg in (config.robot.left, config.robot.right)]
    if config.turning and counts[0] != counts[1]:
        raise ConfigError(
            f"{source}: model.trunk_rotation: needs legs of equally many joints, "
            f"not {counts[0]} and {counts[1]} (robot.left.stiffness)"
        )
    if config.support.contact_off >= config.support.contact_on:
        raise ConfigError(
            f"{source}: support.contact_off: {config.support.contact_off} must be below "
            f"support.contact_on = {config.support.contact_on}"
        )
