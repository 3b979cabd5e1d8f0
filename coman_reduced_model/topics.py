# SPDX-License-Identifier: BSD-3-Clause
"""Topic names: relative ones, the namespace and the remappings that move them, as in ROS."""

from __future__ import annotations

import re
from collections.abc import Iterable

from .core.base.stream_names import IMU
from .errors import ConfigError
from .messages import (
    COM_DEFLECTION,
    COM_PREDICTION,
    EXTERNAL_WRENCH,
    INPUT_TYPES,
    ODOMETRY,
    POINT_STAMPED,
    STRING,
    SUPPORT_STATE,
    TRANSFORMS,
)

DESCRIPTION = "robot_description"
PREDICTION, DEFLECTION, SUPPORT, EXTERNAL = "com/prediction", "com/deflection", "com/support", "com/external_wrench"
PLANNED_DEFLECTION = "com/planned_deflection"
MEASURED, PREDICTED, REFERENCE_POINT = "com/measured", "com/predicted", "com/reference_point"
FOOT_ODOMETRY, TF, TF_STATIC = "foot_odometry", "/tf", "/tf_static"  # all nodes share the latter two

# Relative topic of each input stream, and type of each output topic.
INPUT_TOPICS = {stream: "imu/data" if stream == IMU else stream for stream in INPUT_TYPES}
OUTPUT_TYPES = {
    PREDICTION: COM_PREDICTION,
    DEFLECTION: COM_DEFLECTION,
    SUPPORT: SUPPORT_STATE,
    EXTERNAL: EXTERNAL_WRENCH,
    MEASURED: POINT_STAMPED,
    PREDICTED: POINT_STAMPED,
    REFERENCE_POINT: POINT_STAMPED,
    FOOT_ODOMETRY: ODOMETRY,
    TF: TRANSFORMS,
    TF_STATIC: TRANSFORMS,
    DESCRIPTION: STRING,
}
# What the predictor publishes: played from a bag beside a predictor, nobody can tell which is which.
OF_PREDICTOR = (
    *(topic for topic in OUTPUT_TYPES if topic not in (DESCRIPTION, TF_STATIC)), PLANNED_DEFLECTION, "com/markers",
)  # fmt: skip
_NAME = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")


class TopicNames:
    """Absolute names of relative ones."""

    def __init__(self, namespace: str = "", remaps: Iterable[str] = ()) -> None:
        """A namespace, and remappings such as `joint_states:=/arm/joint_states`.

        Raises:
            ConfigError: a name is not one.
        """
        stripped = namespace.strip("/")
        if stripped and not _NAME.fullmatch(stripped):
            raise ConfigError(f"--namespace: {namespace!r} is not a namespace of ROS")
        self._prefix = f"/{stripped}/" if stripped else "/"
        self._remaps: dict[str, str] = {}
        for remap in remaps:
            old, separator, new = remap.partition(":=")
            if not separator or not _NAME.fullmatch(old) or not _NAME.fullmatch(new):
                raise ConfigError(f"--remap: {remap!r} is not of the form OLD:=NEW with topic names")
            self._remaps[self._absolute(old)] = self._absolute(new)

    def _absolute(self, name: str) -> str:
        return name if name.startswith("/") else self._prefix + name

    def __call__(self, name: str) -> str:
        """The absolute name of a topic."""
        absolute = self._absolute(name)
        return self._remaps.get(absolute, absolute)
