# SPDX-License-Identifier: BSD-3-Clause
"""The parameter table as ROS 2 parameters: declared with descriptors, validated exactly as a file is."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from ...core.base.parameter import Parameter
from ...core.config.files import load_config
from ...core.config.schema import Config, config_from_flat, parameter_table
from ...errors import ConfigError
from ...topics import DESCRIPTION

_TYPES = {"floats": RosParameter.Type.DOUBLE_ARRAY, "strs": RosParameter.Type.STRING_ARRAY}


def check_files(argv: list[str], name: str) -> None:
    """Check the parameter files of a command line before ROS reads them: the same one line as `coman` gives.

    Raises:
        ConfigError: says file, key, value and what is allowed.
    """
    for path in _files(argv):
        load_config(path, _node_name(argv, name), (DESCRIPTION,))


def _files(argv: list[str]) -> list[Path]:
    return [Path(argv[i + 1]) for i, word in enumerate(argv[:-1]) if word == "--params-file"]


def _node_name(argv: list[str], name: str) -> str:
    for word in argv:
        if word.startswith(("__node:=", f"{name}:__node:=")):
            name = word.partition(":=")[2]
    return name


def descriptor(parameter: Parameter) -> ParameterDescriptor:
    """Description with unit, bounds, and whether it may change while the node runs."""
    result = ParameterDescriptor(
        description=parameter.description + (f" [{parameter.unit}]" if parameter.unit not in ("", "1") else ""),
        additional_constraints=parameter.allowed(),
        read_only=not parameter.runtime,
    )
    bounded = math.isfinite(parameter.low) and math.isfinite(parameter.high)
    if bounded and parameter.kind == "float":
        result.floating_point_range = [FloatingPointRange(from_value=parameter.low, to_value=parameter.high)]
    elif bounded and parameter.kind == "int":
        result.integer_range = [IntegerRange(from_value=int(parameter.low), to_value=int(parameter.high), step=1)]
    return result


def declare(node: Node, on_change: Callable[[Config], None] | None = None) -> Config:
    """Declare the whole table on a node and validate what it was started with.

    The node must have been made with `automatically_declare_parameters_from_overrides=True`: only so are unknown keys
    seen, which ROS would ignore.

    Args:
        node: the node.
        on_change: called with the new configuration when parameters that may change at run time have changed.

    Raises:
        ConfigError: says key, value and what is allowed.
    """
    table = parameter_table()
    all_given: dict[str, Any] = dict(node.get_parameters_by_prefix(""))  # to parameters, whatever its annotation says
    given = {
        name: parameter.value for name, parameter in all_given.items() if name != DESCRIPTION and not is_ros_own(name)
    }
    config = config_from_flat(given, "parameters", _directory(given.get("robot.urdf")))
    for note in config.notes:
        node.get_logger().warning(note)
    for name in given:
        node.undeclare_parameter(name)
    values = config.flat()
    for name, parameter in table.items():
        value: Any = values.get(name, parameter.nominal)
        if isinstance(value, tuple) and not value:  # no value from which ROS could infer the type
            value = [""] if parameter.kind == "strs" else None
        node.declare_parameter(
            name,
            _TYPES[parameter.kind] if value is None else list(value) if isinstance(value, tuple) else value,
            descriptor(parameter),
            ignore_override=True,
        )
    if not node.has_parameter(DESCRIPTION):
        node.declare_parameter(DESCRIPTION, "", ParameterDescriptor(description="the URDF itself, as text"))
    node.add_on_set_parameters_callback(_Changes(config, on_change).check)
    return config


def is_ros_own(name: str) -> bool:
    """Parameters that every ROS 2 node has."""
    return name in ("use_sim_time", "start_type_description_service") or name.startswith("qos_overrides.")


def _directory(urdf: Any) -> Path:
    """Where a relative robot.urdf starts: at the file that says it, otherwise where the node was started."""
    for path in reversed(_files(sys.argv)):
        if urdf and (path.parent / str(urdf)).is_file():
            return path.parent
    return Path()


class _Changes:
    """Applies changes at run time; ROS itself refuses those of read-only parameters and of other types."""

    def __init__(self, config: Config, on_change: Callable[[Config], None] | None) -> None:
        self._config = config
        self._on_change = on_change

    def check(self, parameters: list[RosParameter]) -> SetParametersResult:
        changes = {p.name: p.value for p in parameters if p.name in parameter_table()}
        try:
            config = self._config.replaced(changes)
        except ConfigError as error:
            return SetParametersResult(successful=False, reason=str(error))
        if changes and config != self._config:
            self._config = config
            if self._on_change is not None:
                self._on_change(config)
        return SetParametersResult(successful=True)
