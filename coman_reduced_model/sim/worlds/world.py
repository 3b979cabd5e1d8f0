# SPDX-License-Identifier: BSD-3-Clause
"""The record of a world: plain values that can be printed, stored as YAML beside the bags, and set by hand."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, get_type_hints

import yaml

from ...errors import ConfigError
from ..contact import Contact, Floor
from ..controller import Controller
from ..engines import ENGINES
from ..robot_table import ROBOTS, RobotTable, UpperBody, with_upper_body
from ..sensors import SensorOptions
from ..upper_motion import UpperMotion


@dataclass(frozen=True)
class World:
    """A virtual robot, its surroundings, its sensors and its gait; the defaults are the plain virtual robot.

    Raises:
        ConfigError: an engine or a robot that does not exist.
    """

    kinds: dict[str, str] = field(default_factory=dict)  # by axis, the kind that was drawn; only for reports
    seed: int = 0  # of the tolerances of the robot and of its imperfections
    robot: str = "coman"
    engine: str = "mujoco"
    contact: Contact = Contact()
    floor: Floor = Floor()
    controller: Controller = Controller()
    upper_body: bool = False  # a waist, arms and a head
    upper_joints: UpperBody = UpperBody()
    upper: UpperMotion = UpperMotion()
    imu_turn: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [rad] roll, pitch, yaw of the IMU in base_link
    gait: str = "test1"
    gait_changes: dict[str, float] = field(default_factory=dict)
    duration_s: float = 13.0
    sensors: SensorOptions = SensorOptions()
    reference: bool = True  # com/reference is published
    tolerances: bool = True  # springs, dampers and masses are off by some per cent
    imperfections: float = 0.0  # amount of `Imperfections`; 0: none

    def __post_init__(self) -> None:
        for name, allowed in (("engine", ENGINES), ("robot", tuple(ROBOTS))):
            if getattr(self, name) not in allowed:
                raise ConfigError(f"world: {name} = {getattr(self, name)!r}: allowed: {', '.join(allowed)}")

    @property
    def table(self) -> RobotTable:
        """Geometry, masses and springs of the robot, as its data sheet states them."""
        table = ROBOTS[self.robot]
        table = with_upper_body(table, self.upper_joints) if self.upper_body else table
        return replace(table, imu_turn=self.imu_turn)


def world_yaml(world: World) -> str:
    """The world as YAML: whatever differs from the defaults."""
    return yaml.safe_dump(_differences(world), sort_keys=False, default_flow_style=None, width=100)


def read_world(path: str | Path) -> World:
    """The world of a YAML file; what the file leaves out is as in the plain virtual robot.

    Raises:
        ConfigError: the file cannot be read, or a key or a value is not allowed.
    """
    try:
        return world_from_yaml(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from None
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None


def world_from_yaml(text: str) -> World:
    """The world of a YAML text.

    Raises:
        ConfigError: no YAML, or a key or a value is not allowed.
    """
    try:
        values = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ConfigError(f"no YAML: {' '.join(str(error).split())}") from None
    world: World = _build(World, values or {}, "world")
    return world


def _differences(record: Any) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for f in fields(record):
        value = getattr(record, f.name)
        if value == _default(f):
            continue
        if is_dataclass(value):
            out[f.name] = _differences(value)
        else:
            out[f.name] = list(value) if isinstance(value, tuple) else value
    return out


def _default(f: Field[Any]) -> Any:
    return f.default_factory() if f.default_factory is not MISSING else f.default


def _build(kind: type[Any], values: Any, where: str) -> Any:
    """A record from a mapping of some of its fields."""
    if not isinstance(values, Mapping):
        raise ConfigError(f"{where} = {values!r}: allowed: a mapping")
    types, known = get_type_hints(kind), {f.name: f for f in fields(kind)}
    out = {}
    for key, value in values.items():
        if key not in known:
            raise ConfigError(f"{where}.{key}: unknown key (allowed: {', '.join(known)})")
        default = _default(known[key])
        if is_dataclass(types[key]):
            out[key] = _build(types[key], value, f"{where}.{key}")
        else:
            out[key] = _like(default, value, f"{where}.{key}")
    return kind(**out)


def _like(default: Any, value: Any, where: str) -> Any:
    """A value of the type of the default.

    Raises:
        ConfigError: it is of another type.
    """
    if isinstance(default, bool) or isinstance(value, bool):
        fits = isinstance(default, bool) and isinstance(value, bool)
    elif isinstance(default, float):
        fits = isinstance(value, (int, float))
    elif isinstance(default, tuple):
        fits = isinstance(value, (list, tuple)) and len(value) == len(default)
        fits = fits and all(isinstance(each, (int, float)) for each in value)
    else:
        fits = isinstance(value, type(default))
    if not fits:
        raise ConfigError(f"{where} = {value!r}: allowed: a value such as {default!r}")
    return tuple(map(float, value)) if isinstance(default, tuple) else type(default)(value)
