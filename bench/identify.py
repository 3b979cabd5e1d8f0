# SPDX-License-Identifier: BSD-3-Clause
"""How well `coman identify` finds the springs of virtual robots that are not as their data sheets say.

    python bench/identify.py [ROBOT:SEED ...]      # default: coman:1 tall:2 small:3; some minutes

Default sensors, springs and dampers scattered by up to 16 %. Experiments: one load bag and four decay bags. Walks: one
of each gait of the paper. Errors against the simulator's constants, and how many true values lie within the intervals
(95 % would, if noise were all that is wrong: what gains of sensors do wrong is in no interval).
"""

from __future__ import annotations

import sys
import tempfile
from collections import defaultdict
from pathlib import Path

import numpy as np
from markdown import table

from coman_reduced_model.core.config.files import load_config
from coman_reduced_model.resources import config_path
from coman_reduced_model.sim.disturbances import Scatter
from coman_reduced_model.sim.experiments import SOFT, record_experiment
from coman_reduced_model.sim.record import load_truth, record
from coman_reduced_model.topics import TopicNames
from coman_reduced_model.tuning.identify import identify
from coman_reduced_model.tuning.recording import motor_side, read_all
from coman_reduced_model.tuning.validate import virtual_case


def recorded(folder: Path, robot: str, seed: int) -> dict[str, list[Path]]:
    """Bags by what was done."""
    hidden = [Scatter(seed, spring=0.08, mass=0.0, com=0.0)]
    bags: dict[str, list[Path]] = {"experiments": [], "walks": []}
    for number, joint in enumerate(("", *SOFT)):
        bags["experiments"].append(folder / (joint or "load"))
        kind = "decay" if joint else "load"
        record_experiment(kind, bags["experiments"][-1], joint, robot, disturbances=hidden, seed=100 * seed + number)
    for number, gait in enumerate(("test1", "test2")):
        bags["walks"].append(folder / gait)
        record(gait, folder / gait, robot, disturbances=hidden, seed=100 * seed + 50 + number)
    return bags


def main() -> None:
    errors: dict[tuple[str, str, str], list[float]] = defaultdict(list)
    held: dict[tuple[str, str, str], list[bool]] = defaultdict(list)
    for name in sys.argv[1:] or ["coman:1", "tall:2", "small:3"]:
        robot, _, seed = name.partition(":")
        config = virtual_case(robot, load_config(config_path())).config
        with tempfile.TemporaryDirectory() as folder:
            for what, bags in recorded(Path(folder), robot, int(seed or 1)).items():
                joints = identify(read_all(bags, motor_side(config), TopicNames(), None, None), config)
                truth = load_truth(bags[0].with_name(f"{bags[0].name}.truth.npz"))
                for joint in joints:
                    index = list(truth["joint_names"]).index(joint.name)
                    for kind in ("stiffness", "damping"):
                        key = what, kind, "soft joints" if joint.name in SOFT else "stiff joints"
                        if found := getattr(joint, kind):
                            true = float(truth[kind][index])
                            errors[key].append(100.0 * (found.value / true - 1.0))
                            held[key].append(found.low <= true <= found.high)
    print(table(
        ["by", "of", "", "found", "mean error [%]", "RMS error [%]", "largest [%]", "within the interval"],
        [
            [*key, str(len(each)), f"{np.mean(each):+.1f}", f"{np.sqrt(np.mean(np.square(each))):.1f}",
             f"{max(map(abs, each)):.1f}", f"{sum(held[key])}"]
            for key, each in errors.items()
        ],
    ))  # fmt: skip


if __name__ == "__main__":
    main()
