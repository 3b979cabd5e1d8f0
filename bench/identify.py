# SPDX-License-Identifier: BSD-3-Clause
"""How well `coman identify` finds the springs of virtual robots that are not as their data sheets say.

    .venv/bin/python bench/identify.py [ROBOT:SEED ...]      default: coman:1; a robot takes some minutes

For each robot: one load bag and four decay bags with default sensors, springs and dampers scattered by up to 16 %.
Prints errors against the simulator's constants, and how many true values the intervals hold.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

from coman_reduced_model.core.config.files import load_config
from coman_reduced_model.resources import config_path
from coman_reduced_model.sim.disturbances import Scatter
from coman_reduced_model.sim.experiments import SOFT, record_experiment
from coman_reduced_model.sim.record import load_truth
from coman_reduced_model.topics import TopicNames
from coman_reduced_model.tuning.identify import identify
from coman_reduced_model.tuning.recording import motor_side, read_all
from coman_reduced_model.tuning.validate import virtual_case


def main() -> None:
    held: dict[str, list[bool]] = {"stiffness": [], "damping": []}
    errors: dict[str, list[float]] = {"stiffness": [], "damping": []}
    for name in sys.argv[1:] or ["coman:1"]:
        robot, _, seed = name.partition(":")
        hidden = [Scatter(int(seed or 1), spring=0.08, mass=0.0, com=0.0)]
        config = virtual_case(robot, load_config(config_path())).config
        with tempfile.TemporaryDirectory() as folder:
            bags = []
            for number, joint in enumerate(("", *SOFT)):
                bags.append(Path(folder) / (joint or "load"))
                kind = "decay" if joint else "load"
                record_experiment(kind, bags[-1], joint, robot, disturbances=hidden, seed=100 * int(seed or 1) + number)
            joints = identify(read_all(bags, motor_side(config), TopicNames(), None, None), config)
            truth = load_truth(bags[0].with_name("load.truth.npz"))
        for joint in joints:
            index = list(truth["joint_names"]).index(joint.name)
            for kind in held:
                found = getattr(joint, kind)
                if found is None:
                    continue
                true = float(truth[kind][index])
                errors[kind].append(found.value / true - 1.0)
                held[kind].append(found.low <= true <= found.high)
                error = 100.0 * errors[kind][-1]
                shown = f"{true:8.2f} {found.value:8.2f} [{found.low:.2f}, {found.high:.2f}] {error:+.1f} %"
                outside = "" if held[kind][-1] else "  outside"
                print(f"{name} {joint.name:9s} {kind:9s} {shown}{outside}", flush=True)
    for kind, values in errors.items():
        size = 100.0 * np.abs(values)
        print(f"{kind}: largest error {size.max():.1f} %, median {np.median(size):.1f} %; in the interval "
              f"{sum(held[kind])} of {len(values)}")  # fmt: skip


if __name__ == "__main__":
    main()
