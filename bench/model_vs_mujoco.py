# SPDX-License-Identifier: BSD-3-Clause
"""One step of the reduced model beside one step of the full-body simulation of the same robot.

    python bench/model_vs_mujoco.py

Both stand on two legs under the same springs; one core, interleaved in one run, so that the ratio holds on any machine.
A model step is kinematics, stiffness and integration (`Posture.update`, `Model.terms`, `step`) for 5 ms, and once more
the integration alone; a MuJoCo step is `mj_step` at the simulator's own step, and as many as 5 ms take.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import mujoco
import numpy as np
from rich.console import Console
from rich.table import Table

from coman_reduced_model.core.config import Config
from coman_reduced_model.core.integrator import step
from coman_reduced_model.core.model import Model
from coman_reduced_model.core.robot import Robot
from coman_reduced_model.core.types import Foot, Phase, SupportState
from coman_reduced_model.resources import config_path
from coman_reduced_model.sim.virtual_robot import VirtualRobot

DT = 0.005
ROUNDS = 3000


def main() -> None:
    robot = Robot(config_path("coman.urdf").read_text(), Config().robot)
    model, posture = Model(robot, Config()), robot.posture()
    bend = {"HipSag": -0.3, "KneeSag": 0.6, "AnkSag": -0.3}
    q = np.array([bend.get(name[1:], 0.0) for name in robot.joint_names])
    still = np.zeros(len(q))
    posture.update(q, still)
    reference = posture.com_in_sole(Foot.LEFT)
    state = np.concatenate(reference)
    support = SupportState(Phase.DOUBLE, Foot.LEFT, 0.5)

    def terms():
        posture.update(q, still)
        return model.terms(posture, support, {Foot.LEFT: posture.com_in_sole(Foot.LEFT)}, False)

    found = terms()
    moment = (found.K, found.D, found.force, *reference)

    def integrate():
        step(state, found.M, found.axes, moment, moment, DT)

    def whole():
        now = terms()
        here = (now.K, now.D, now.force, *reference)
        step(state, now.M, now.axes, here, here, DT)

    simulation = VirtualRobot()
    physics, data = simulation.model, simulation.data
    order = [physics.joint(name).qposadr[0] for name in robot.joint_names]
    data.qpos[order] = q
    mujoco.mj_kinematics(physics, data)
    data.qpos[2] -= data.site("l_sole").xpos[2]
    for actuator in range(physics.nu):
        data.ctrl[actuator] = data.qpos[physics.jnt_qposadr[physics.actuator_trnid[actuator, 0]]]
    for _ in range(round(0.5 / physics.opt.timestep)):  # until the feet carry the robot
        mujoco.mj_step(physics, data)
    start = data.qpos.copy(), data.qvel.copy()

    def simulate():
        mujoco.mj_step(physics, data)

    candidates: dict[str, Callable[[], object]] = {
        "reduced model, integration alone": integrate,
        "reduced model, one sample": whole,
        "MuJoCo, one step": simulate,
    }
    seconds = {name: np.empty(ROUNDS) for name in candidates}
    for i in range(-50, ROUNDS):
        if i % 50 == 0:  # before it falls
            data.qpos[:], data.qvel[:] = start
        for name, call in candidates.items():
            begin = time.perf_counter()
            call()
            if i >= 0:
                seconds[name][i] = time.perf_counter() - begin
    contacts = data.ncon

    per_step = float(np.median(seconds["MuJoCo, one step"]))
    per_sample = per_step * DT / physics.opt.timestep
    table = Table("", "median [us]", "p99 [us]", "of one MuJoCo step", f"of MuJoCo's {DT * 1e3:g} ms")
    for name, values in seconds.items():
        median, p99 = np.percentile(values, [50, 99])
        table.add_row(
            name, f"{median * 1e6:.1f}", f"{p99 * 1e6:.1f}", f"{median / per_step:.2f}", f"{median / per_sample:.3f}"
        )
    size = f"{physics.nv} freedoms, {contacts} contacts, step {physics.opt.timestep * 1e3:g} ms"
    table.title = f"MuJoCo {mujoco.__version__}: {size}"
    Console(width=120).print(table)


if __name__ == "__main__":
    main()
