# SPDX-License-Identifier: BSD-3-Clause
"""Entry points of the executables. Nothing heavy is imported before Ctrl-C is taken care of."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from typing import Any

from .runtime.spin import run


def _find(module: str, kind: str) -> Callable[[], Callable[[], Any]]:
    return lambda: getattr(importlib.import_module(f"{__package__}.{module}"), kind)


def predictor() -> None:
    """`ros2 run coman_reduced_model predictor`."""
    sys.exit(run("predictor", _find("nodes.predictor", "PredictorNode")))


def trajectory() -> None:
    """`ros2 run coman_reduced_model trajectory`."""
    sys.exit(run("trajectory", _find("nodes.trajectory", "TrajectoryNode")))


def virtual_robot() -> None:
    """`ros2 run coman_reduced_model virtual_robot`."""
    sys.exit(run("virtual_robot", _find("nodes.virtual_robot", "VirtualRobotNode")))
