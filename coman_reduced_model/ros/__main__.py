# SPDX-License-Identifier: BSD-3-Clause
"""`python -m coman_reduced_model.ros predictor --ros-args ...`: a node of this very environment, wherever installed."""

from __future__ import annotations

import sys

from . import main

if __name__ == "__main__":
    nodes = {"predictor": main.predictor, "trajectory": main.trajectory, "virtual_robot": main.virtual_robot}
    if len(sys.argv) < 2 or sys.argv[1] not in nodes:
        sys.exit(f"usage: python -m {__package__} {{{'|'.join(nodes)}}} [--ros-args ...]")
    nodes[sys.argv.pop(1)]()
