# SPDX-License-Identifier: BSD-3-Clause
"""The reduced models beside a full-order simulation of the same robot: cost of 5 ms, and the COM error each reaches.

    python bench/model_vs_mujoco.py [GAIT]        # a shipped walk, default test1

All are driven by the motor positions in the bag, sample by sample and in turn in one process, so that the ratios hold
on any machine; times are CPU time. The models are reset at each touchdown (`coman predict`); MuJoCo starts once, where
the plan says that the robot stands, and knows the very springs, masses and ground of the robot that made the bag: its
error is what sensor noise and an open-loop walk leave. COM in the support sole against the measured one.
"""

from __future__ import annotations

import sys
import time
from typing import NamedTuple

import mujoco
import numpy as np
from rich.console import Console
from rich.table import Table

from coman_reduced_model.core.base.types import Foot
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.gait.gait import plan_walk
from coman_reduced_model.core.predictor import Predictor
from coman_reduced_model.resources import bag_path
from coman_reduced_model.sim.motion import plan_motion
from coman_reduced_model.sim.record import robot_gait
from coman_reduced_model.sim.robot_table import COMAN
from coman_reduced_model.sim.virtual_robot import VirtualRobot
from coman_reduced_model.tuning.recording import JoinedBag, read_recording

MODELS = {"the paper's model": "without", "the turning trunk": "with"}


class Replay:
    """The motors of a bag, as a motion of the virtual robot."""

    def __init__(self, recording: JoinedBag, robot: VirtualRobot, gait: str) -> None:
        samples = [s for s in recording.samples if s.motor_q is not None and s.motor_qd is not None]
        self._t = np.array([s.stamp_ns - robot.start_ns for s in samples]) * 1e-9
        order = [recording.robot.joint_names.index(name) for name in robot.table.joint_names]
        self._q = np.array([s.motor_q for s in samples])[:, order]
        self._qd = np.array([s.motor_qd for s in samples])[:, order]
        self.start = plan_motion(COMAN, plan_walk(robot_gait(COMAN, gait)))[0].start

    def __call__(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        q, qd = (np.stack([np.interp(t, self._t, joint) for joint in part.T], axis=1) for part in (self._q, self._qd))
        return q, qd


class Compared(NamedTuple):
    """A walk by all models: errors (n, 3) [m] of the COM, CPU time of each step [s], and the simulation."""

    errors: dict[str, list[np.ndarray]]
    seconds: dict[str, list[float]]
    physics: mujoco.MjModel


def compared(gait: str) -> Compared:
    """Errors and costs on a shipped walk."""
    plain = Config().replaced({"prediction.horizons": []})
    recording = read_recording(bag_path(gait), plain)
    models = {n: Predictor(recording.robot, plain.replaced({"model.trunk_rotation": e})) for n, e in MODELS.items()}
    for model in models.values():  # compiled, caches warm
        for sample in list(recording.copies())[:400]:
            model.update(sample)
        model.reset()
    simulation = VirtualRobot()
    motion = Replay(recording, simulation, gait)
    simulation.reset(motion)
    physics, data = simulation.model, simulation.data
    dt, lead, sites = physics.opt.timestep, simulation.damping / simulation.stiffness, {1: "l_sole", 2: "r_sole"}

    seconds: dict[str, list[float]] = {name: [] for name in (*models, "MuJoCo")}
    errors: dict[str, list[np.ndarray]] = {name: [] for name in ("rigid robot", *models, "MuJoCo")}
    steps = 0
    for sample in recording.copies():
        for name, model in models.items():
            begin = time.process_time()
            made = model.update(sample)
            seconds[name].append(time.process_time() - begin)
            errors[name].append(made.residual)
        due = round((sample.stamp_ns - simulation.start_ns) * 1e-9 / dt)
        q, qd = motion(np.arange(steps, due) * dt)
        begin = time.process_time()
        for row in q + lead * qd:
            data.ctrl[:] = row
            mujoco.mj_step(physics, data)
        if due > steps:
            seconds["MuJoCo"].append((time.process_time() - begin) / (due - steps))
        steps = max(due, steps)
        if made.support.support_foot == Foot.NONE:
            continue
        mujoco.mj_kinematics(physics, data)
        mujoco.mj_comPos(physics, data)
        sole = data.site(sites[made.support.support_foot])
        com = (data.subtree_com[0] - sole.xpos) @ sole.xmat.reshape(3, 3)
        errors["MuJoCo"].append(made.measured_com - com)
        errors["rigid robot"].append(made.measured_com - made.reference_com)
    return Compared(errors, seconds, physics)


def main() -> None:
    gait = sys.argv[1] if len(sys.argv) > 1 else "test1"
    errors, seconds, physics = compared(gait)
    dt = physics.opt.timestep
    cost = {name: float(np.median(values)) for name, values in seconds.items()}
    one, full = cost["MuJoCo"], cost["MuJoCo"] * 0.005 / dt
    cost["MuJoCo"] = full
    title = f"{gait}; MuJoCo {mujoco.__version__}: {physics.nv} freedoms, step {dt * 1e3:g} ms, {one * 1e6:.0f} us each"
    table = Table("", "5 ms cost [us]", "of MuJoCo's", "RMS error x, y, z [mm]", title=title)
    for name, values in errors.items():
        rms = np.sqrt(np.nanmean(np.square(values), axis=0)) * 1e3
        paid = (f"{cost[name] * 1e6:.0f}", f"{cost[name] / full:.2f}") if name in cost else ("", "")
        table.add_row(name, *paid, ", ".join(f"{axis:.2f}" for axis in rms))
    Console(width=120, markup=False).print(table)


if __name__ == "__main__":
    main()
