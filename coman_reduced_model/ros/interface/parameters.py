# SPDX-License-Identifier: BSD-3-Clause
"""A node's part of the parameter table as ROS 2 parameters: with descriptors, validated exactly as a file is."""

from __future__ import annotations

import difflib
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from ...core.base.parameter import Parameter
from ...core.config.files import check_qos, is_ros_own, read_sections
from ...core.config.schema import Config, config_from_flat, parameter_table
from ...errors import ComanError, ConfigError
from ...topics import DESCRIPTION

_TYPES = {"floats": RosParameter.Type.DOUBLE_ARRAY, "strs": RosParameter.Type.STRING_ARRAY}


class ConfiguredNode(Node):
    """A node with parameters of the table, see `declare`."""

    def __init__(self, name: str) -> None:
        # Only so are unknown keys of a file seen, which ROS would ignore, and those set later refused in clear words.
        super().__init__(name, automatically_declare_parameters_from_overrides=True, allow_undeclared_parameters=True)


@dataclass(frozen=True)
class Own:
    """What a node takes from the table, as beginnings of names.

    Attributes:
        names: of the parameters that it declares.
        changing: of those that may change while it runs, if the table lets them.
    """

    names: tuple[str, ...]
    changing: tuple[str, ...]


def check_files(argv: list[str], name: str) -> None:
    """Check the parameter files of a command line, together, before ROS reads them: the same line as `coman` gives.

    Raises:
        ConfigError: says file, key, value and what is allowed.
    """
    of_all: dict[str, Any] = {}
    own: dict[str, Any] = {}
    for path in (files := _files(argv)):
        every, mine = read_sections(path, _node_name(argv, name))
        of_all |= every
        own |= mine
    if files:
        config_from_flat({**of_all, **own}, " and ".join(map(str, files)), files[-1].parent)


def _files(argv: list[str]) -> list[Path]:
    return [Path(argv[i + 1]) for i, word in enumerate(argv[:-1]) if word == "--params-file"]


def _node_name(argv: list[str], name: str) -> str:
    for word in argv:
        if word.startswith(("__node:=", f"{name}:__node:=")):
            name = word.partition(":=")[2]
    return name


def descriptor(parameter: Parameter, changing: bool) -> ParameterDescriptor:
    """Description with unit, bounds, and whether it may change while the node runs."""
    result = ParameterDescriptor(
        description=parameter.description + (f" [{parameter.unit}]" if parameter.unit not in ("", "1") else ""),
        additional_constraints=parameter.allowed(),
        read_only=not changing,
    )
    bounded = math.isfinite(parameter.low) and math.isfinite(parameter.high)
    if bounded and parameter.kind == "float":
        result.floating_point_range = [FloatingPointRange(from_value=parameter.low, to_value=parameter.high)]
    elif bounded and parameter.kind == "int":
        result.integer_range = [IntegerRange(from_value=int(parameter.low), to_value=int(parameter.high), step=1)]
    return result


def declare(node: ConfiguredNode, own: Own, on_change: Callable[[Config], None]) -> Config:
    """Declare a node's own part of the table, and validate all that it was started with.

    Args:
        node: just made.
        own: its part.
        on_change: takes a new configuration over when parameters have changed at run time, or raises ConfigError having
            changed nothing.

    Raises:
        ConfigError: says key, value and what is allowed.
    """
    all_given: dict[str, Any] = dict(node.get_parameters_by_prefix(""))  # to parameters, whatever its annotation says
    for name, parameter in all_given.items():
        check_qos(name, parameter.value)
    given = {name: parameter.value for name, parameter in all_given.items() if not is_ros_own(name)}
    description = str(given.pop(DESCRIPTION, ""))
    config = config_from_flat(given, "parameters", _directory(given.get("robot.urdf"), given.get("monitor.baseline")))
    for note in config.notes:
        node.get_logger().warning(note)
    for name in (*given, DESCRIPTION):
        if node.has_parameter(name):
            node.undeclare_parameter(name)
    table = parameter_table()
    for name, stated in config.flat().items():
        parameter, value = table[name], cast(Any, stated)
        if not name.startswith(own.names):
            continue
        if isinstance(value, tuple) and not value:  # no value from which ROS could infer the type
            value = [""] if parameter.kind == "strs" else None
        node.declare_parameter(
            name,
            _TYPES[parameter.kind] if value is None else list(value) if isinstance(value, tuple) else value,
            descriptor(parameter, parameter.runtime and name.startswith(own.changing)),
            ignore_override=True,
        )
    if DESCRIPTION.startswith(own.names):
        about = ParameterDescriptor(description="the URDF itself, as text", read_only=True)
        node.declare_parameter(DESCRIPTION, description, about, ignore_override=True)
    node.add_on_set_parameters_callback(_Changes(node, config, on_change).check)
    return config


def _directory(*names: Any) -> Path:
    """Where relative names of files start: at the file that says them, otherwise where the node was started."""
    relative = [Path(str(name)) for name in names if name and not Path(str(name)).is_absolute()]
    for path in reversed(_files(sys.argv)):
        if any((path.parent / name).is_file() for name in relative):
            return path.parent
    return Path()


class _Changes:
    """Applies changes at run time; ROS itself refuses those of read-only parameters and of other types."""

    def __init__(self, node: Node, config: Config, on_change: Callable[[Config], None]) -> None:
        self._node = node
        self._config = config
        self._on_change = on_change

    def check(self, parameters: list[RosParameter]) -> SetParametersResult:
        changes = {p.name: p.value for p in parameters if not is_ros_own(p.name)}
        try:
            for name in changes:
                self._check_name(name)
            config = self._config.replaced(changes)
            if config != self._config:
                self._on_change(config)
                self._config = config
        except ComanError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _check_name(self, name: str) -> None:
        """Only parameters that were declared are set.

        Raises:
            ConfigError: this one was not.
        """
        if self._node.has_parameter(name):
            return
        if name in parameter_table():
            raise ConfigError(f"{name}: the node {self._node.get_name()} has no use for it")
        hint = difflib.get_close_matches(name, list(self._node.get_parameters_by_prefix("")), 1)
        raise ConfigError(f"{name}: unknown key{f'; did you mean {hint[0]!r}?' if hint else ''}")
