# SPDX-License-Identifier: BSD-3-Clause
"""Configurations as ROS 2 parameter files: read and write."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from ...errors import ConfigError
from ...output import check_file, write_file
from ...resources import config_path
from .schema import FILES, Config, config_from_flat, parameter_table

NODES = ("predictor", "trajectory", "virtual_robot")
QOS = {  # what ROS 2 allows, by policy
    "reliability": ("reliable", "best_effort", "system_default", "best_available"),
    "durability": ("volatile", "transient_local", "system_default", "best_available"),
    "history": ("keep_last", "keep_all", "system_default"),
}


class _PlainLoader(yaml.SafeLoader):
    """Values alone: no tags that make objects, and no aliases, by which a short file could fill the memory."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        """A node that is no alias."""
        if self.check_event(yaml.AliasEvent):
            mark = self.peek_event().start_mark
            raise yaml.composer.ComposerError(None, None, "aliases (*) are not allowed", mark)
        return super().compose_node(parent, index)


def load_config(path: str | Path | None = None, node: str = "predictor") -> Config:
    """Read a ROS 2 parameter file: the sections `/**` and that of the node, if any, which goes first.

    Sections of other packages' nodes, which have none of these parameters, are not looked at, nor are parameters that
    every ROS 2 node has, and `robot_description`, which nodes take.

    Args:
        path: of the file; default: the shipped coman.yaml.
        node: whose section counts.

    Raises:
        ConfigError: the file cannot be read or a value in it is not allowed.

    Example:
        >>> import coman_reduced_model as coman
        >>> config = coman.load_config(coman.config_path("coman_paper")).replaced({"prediction.horizons": [0.2]})
        >>> config.prediction.horizons, config.model.trunk_rotation
        ((0.2,), 'without')
        >>> path = coman.save_config(config, "mine.yaml")
        >>> coman.load_config(path).flat() == config.flat()
        True
    """
    path = Path(config_path() if path is None else path)
    of_all, own = read_sections(path, node)
    return config_from_flat({**of_all, **own}, str(path), path.parent)


def read_sections(path: Path, node: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Parameters of a file by dotted name: of all nodes, and of this one.

    Raises:
        ConfigError: the file cannot be read, or is none of parameters.
    """
    try:
        document = yaml.load(path.read_text(encoding="utf-8"), _PlainLoader)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: is not a text file") from None
    except (RecursionError, ValueError) as error:  # nested too deeply; dates and numbers that are none
        raise ConfigError(f"{path}: is not YAML of a configuration: {error}") from None
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f" in line {mark.line + 1}" if mark else ""
        raise ConfigError(f"{path}: is not YAML{where}: {getattr(error, 'problem', error)}") from None
    if not isinstance(document, dict) or not document:
        raise ConfigError(f"{path}: wanted a ROS 2 parameter file: '/**:' with 'ros__parameters:' below it")
    namespaces: dict[str, str] = {}  # and a section of each
    of_all: dict[str, Any] = {}
    own: dict[str, Any] = {}  # whatever their order
    for section, body in document.items():
        if not isinstance(body, dict) or not isinstance(body.get("ros__parameters"), dict):
            raise ConfigError(f"{path}: {section}: wanted 'ros__parameters:' below a node's name or '/**'")
        flat = _flat_yaml(body["ros__parameters"])
        name = str(section).rsplit("/", 1)[-1]
        if name in ("**", "*", *NODES):
            for key, value in flat.items():
                check_qos(f"{path}: {key}", value)
        flat = {key: value for key, value in flat.items() if key != "robot_description" and not is_ros_own(key)}
        if name in ("**", "*", node):
            if (namespace := str(section).rpartition("/")[0].strip("/")) and "*" not in namespace:
                namespaces[namespace] = str(section)
            (own if name == node else of_all).update(flat)
        elif name in NODES or set(flat).intersection(parameter_table()):
            # Meant for another node: checked all the same, so that a mistake is found now and not there.
            config_from_flat(flat, f"{path}: {section}")
    if len(namespaces) > 1:
        raise ConfigError(
            f"{path}: {' and '.join(namespaces.values())} are of two robots: each needs a file of its own"
        )
    return of_all, own


def is_ros_own(key: str) -> bool:
    """Parameters that every ROS 2 node has."""
    return key in ("use_sim_time", "start_type_description_service") or key.startswith("qos_overrides.")


def check_qos(key: str, value: Any) -> None:
    """Check an override of a quality of service, by the name of its parameter; others pass.

    Raises:
        ConfigError: ROS 2 has no such value.
    """
    policy = key.rpartition(".")[2]
    if "qos_overrides./" not in key:
        return
    if policy == "depth" and not (isinstance(value, int) and not isinstance(value, bool) and value >= 0):
        raise ConfigError(f"{key}: {value!r} is not allowed (allowed: a whole number)")
    if policy in QOS and not (isinstance(value, str) and value.lower() in QOS[policy]):
        raise ConfigError(f"{key}: {value!r} is not allowed (allowed: {', '.join(QOS[policy])})")


def _flat_yaml(tree: Mapping[Any, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in tree.items():
        name = f"{prefix}{key}"
        if isinstance(value, dict):
            flat.update(_flat_yaml(value, name + "."))
        else:
            flat[name] = value
    return flat


def config_to_yaml(config: Config, comment: str = "") -> str:
    """The configuration as a ROS 2 parameter file, each value with its description and unit."""
    table = parameter_table()
    lines = [f"# {line}" for line in comment.splitlines()]
    lines += ["/**:", "  ros__parameters:"]
    for key, value in config.flat().items():
        if value == () and (table[key].nominal == () or key.endswith(".joints")):  # as it is where nothing is said
            continue
        parameter = table[key]
        plain = (list(value) or [""]) if isinstance(value, tuple) else value  # ROS files have no empty lists
        # Quoted where a text holds line breaks and the like: one line a key.
        quotes = None if str(value).isprintable() and "\\" not in str(value) else '"'
        text = yaml.safe_dump(plain, default_flow_style=True, default_style=quotes, width=10**6)
        text = text.removesuffix("...\n").strip("\n")
        unit = f" [{parameter.unit}]" if parameter.unit not in ("", "1") else ""
        lines.append(f"    {key}: {text}  # {parameter.description}{unit}")
    return "\n".join(lines) + "\n"


def save_config(
    config: Config, path: str | Path, comment: str = "", force: bool = False, folder: str | Path | None = None
) -> Path:
    """Write a configuration as a parameter file, whole or not at all; files that it names are found from there as well.

    Args:
        config: to be written.
        path: of the file.
        comment: its first lines.
        force: replace a file that exists.
        folder: where the file will be read from; default: its own.

    Raises:
        OutputError: it exists (without `force`), or cannot be written.
    """
    path = check_file(path, force)
    for key, file in zip(FILES, (config.urdf, config.baseline), strict=True):
        if file is not None:
            config = config.replaced({key: os.path.relpath(file, folder or path.parent)})
    write_file(path, config_to_yaml(config, comment))
    return path
