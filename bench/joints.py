# SPDX-License-Identifier: BSD-3-Clause
"""How the time of an update grows with the number of joints.

    python bench/joints.py [PICTURE]              # a picture of the table, as PNG

The robot of config/coman.yaml with chains of joints on its trunk (two arms, as it were), 12 to 40 joints in all, on the
samples of a walk; the added joints swing. CPU time of all updates over their number, the least of three runs. The last
row is the exponent of a power law through all points.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from coman_reduced_model.bag.session import Session
from coman_reduced_model.core.base.types import Array, Sample
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.predictor import Predictor
from coman_reduced_model.core.robot.robot import Robot
from coman_reduced_model.resources import bag_path

JOINTS = (12, 16, 22, 30, 40)
SAMPLES = 600
VARIANTS = {
    "the paper's model, no horizons": {"model.trunk_rotation": "without", "prediction.horizons": []},
    "default model, no horizons": {"prediction.horizons": []},
    "default model, horizons": {},
}


def with_arms(urdf: str, joints: int) -> str:
    """The robot with that many joints more, in two chains."""
    links = []
    for i in range(joints):
        parent = "base_link" if i < 2 else f"arm_{i - 2}"
        links.append(
            f'<link name="arm_{i}"><inertial><origin xyz="0 0 -0.03"/><mass value="0.15"/>'
            '<inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/></inertial></link>'
            f'<joint name="ArmJoint{i}" type="revolute"><parent link="{parent}"/><child link="arm_{i}"/>'
            f'<origin xyz="0 {(0.1, -0.1)[i % 2] if i < 2 else 0} {0.2 if i < 2 else -0.06}"/>'
            f'<axis xyz="{"0 1 0" if i % 4 < 2 else "1 0 0"}"/>'
            '<limit lower="-2" upper="2" effort="50" velocity="10"/></joint>'
        )
    return urdf.replace("</robot>", "".join(links) + "</robot>")


def moved(samples: list[Sample], before: Robot, robot: Robot) -> list[Sample]:
    """The same samples for a robot with more joints, which swing."""
    at = [robot.joint_names.index(name) for name in before.joint_names]

    def filled(values: Array | None, added: float) -> Array | None:
        if values is None:
            return None
        out = np.full(len(robot.joint_names), added)
        out[at] = values
        return out

    made = []
    for sample in samples:
        t = sample.stamp_ns * 1e-9 % 1000.0
        q, qd = 0.1 * np.sin(3.0 * t), 0.3 * np.cos(3.0 * t)
        changed = {"q": q, "qd": qd, "tau": 0.0, "motor_q": q, "motor_qd": qd}
        made.append(replace(sample, **{key: filled(getattr(sample, key), added) for key, added in changed.items()}))
    return made


def cost(robot: Robot, config: Config, samples: list[Sample]) -> float:
    """CPU time of an update [s]."""
    predictor = Predictor(robot, config)
    predictor.update(samples[0])
    start = time.process_time()
    for sample in samples[1:]:
        predictor.update(sample)
    return (time.process_time() - start) / (len(samples) - 1)


def main() -> None:
    with Session(bag_path("test1")) as session:
        plain, samples = session.robot, list(session.samples())[:SAMPLES]
    times = np.full((len(VARIANTS), len(JOINTS)), np.inf)
    for j, joints in [*enumerate(JOINTS)] * 3:  # in turn: the machine may be busy at one time or another
        robot = Robot(with_arms(plain.urdf, joints - 12), plain.config)
        here = moved(samples, plain, robot)
        for i, changes in enumerate(VARIANTS.values()):
            times[i, j] = min(times[i, j], cost(robot, Config().replaced(changes), here))
    table = Table("joints", *(f"{name} [us]" for name in VARIANTS))
    for joints, column in zip(JOINTS, times.T, strict=True):
        table.add_row(str(joints), *(f"{each * 1e6:.0f}" for each in column))
    exponents = [np.polyfit(np.log(JOINTS), np.log(row), 1)[0] for row in times]
    table.add_row("exponent", *(f"{each:.2f}" for each in exponents))
    Console(width=120, markup=False).print(table)
    if len(sys.argv) > 1:
        draw(Path(sys.argv[1]), times, exponents)


def draw(target: Path, times: Array, exponents: list[float]) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axis = plt.subplots(figsize=(7.0, 4.0), layout="constrained")
    colors = ("#0072b2", "#d55e00", "#1a1c21")
    for name, row, exponent, color in zip(VARIANTS, times, exponents, colors, strict=True):
        axis.loglog(JOINTS, row * 1e6, "o-", color=color, label=f"{name}: exponent {exponent:.2f}")
    axis.set_xticks(JOINTS, [str(each) for each in JOINTS])
    axis.set_xticks([], minor=True)
    axis.set_xlabel("joints of the robot")
    axis.set_ylabel("CPU time of an update [us]")
    axis.grid(which="both", color="#d9dce3", linewidth=0.6)
    axis.legend(fontsize="small")
    figure.savefig(target, dpi=110, metadata={"Software": None})


if __name__ == "__main__":
    main()
