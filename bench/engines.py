# SPDX-License-Identifier: BSD-3-Clause
"""The two physics engines of the virtual robot side by side: where they must agree, and where they may differ.

    python bench/engines.py            # some two minutes; needs the extra `drake`

Must agree: free fall, energy in the air without dampers, weight on the floor, COM by Pinocchio (limits on these are in
test/sim/test_engines.py). May differ: how far soles sink and creep, how high the force goes at a landing, how high the
robot rebounds, so the walk. Speed is simulated over CPU time.
"""

from __future__ import annotations

import time

import numpy as np
import pinocchio as pin
from rich.console import Console
from rich.table import Table

from coman_reduced_model.core.gait.gait import plan_walk
from coman_reduced_model.sim.contact import Floor
from coman_reduced_model.sim.describe import urdf
from coman_reduced_model.sim.disturbances import parse
from coman_reduced_model.sim.engines import ENGINES
from coman_reduced_model.sim.motion import plan_motion
from coman_reduced_model.sim.record import robot_gait
from coman_reduced_model.sim.robot_table import COMAN, RobotTable, with_upper_body
from coman_reduced_model.sim.sensors import SensorOptions
from coman_reduced_model.sim.virtual_robot import Truth, VirtualRobot

G, WALK_S = 9.81, 6.0


def main() -> None:
    """Measure and print."""
    measured = {engine: figures(engine) for engine in ENGINES}
    table = Table("", *ENGINES)
    for name in measured[ENGINES[0]]:
        table.add_row(name, *(measured[engine][name] for engine in ENGINES))
    console = Console(width=120, markup=False)
    console.print(table)
    one, other = (walked(engine, COMAN) for engine in ENGINES)
    difference = np.array([truth.com for truth in one]) - np.array([truth.com for truth in other])
    rms = 1e3 * np.sqrt(np.mean(difference**2, axis=0))
    console.print(
        f"the same walk (test1, {WALK_S:g} s): COM differs by {rms[0]:.2f}, {rms[1]:.2f}, {rms[2]:.2f} mm RMS"
    )


def figures(engine: str) -> dict[str, str]:
    """All figures of an engine."""
    walk = walked(engine, COMAN)
    fall, energy = in_the_air(engine)
    standing, (bounce, sink, blow) = stood(engine), dropped(engine)
    weight, borne = COMAN.mass * G, (standing.left_wrench + standing.right_wrench)[2]
    vertical = np.array([truth.right_wrench[2] for truth in walk])
    return {
        "free fall of 0.3 s: error of the COM [mm]": f"{1e3 * fall:.2f}",
        "energy in the air, dampers at 1 %, change in 0.2 s": f"{100 * energy:+.1f} % of the kinetic energy",
        "standing: force of the ground over weight": f"{borne / weight:.5f}",
        "COM against Pinocchio's [m]": f"{max(com_error(truth) for truth in walk[::40]):.1e}",
        "standing: soles sink by [mm]": f"{-1e3 * (standing.T_left[2, 3] + standing.T_right[2, 3]) / 2.0:.3f}",
        "a bearing sole creeps in a step by, median [mm]": f"{1e3 * creep(walk):.2f}",
        "largest vertical force of a foot over weight": f"{vertical.max() / weight:.2f}",
        "dropped from 2 cm: first rebound [mm]; with dampers at 1 %": f"{bounce:.2f}; {dropped(engine, 0.01)[0]:.2f}",
        "dropped from 2 cm: soles sink by [mm]; force over weight": f"{sink:.2f}; {blow:.2f}",
        "speed, x real time: 12 joints": f"{speed(engine, COMAN):.2f}",
        "speed: 24 joints": f"{speed(engine, with_upper_body(COMAN)):.2f}",
        "speed: 12 joints on tiles": f"{speed(engine, COMAN, Floor(tile_height=0.002)):.2f}",
    }


def walked(engine: str, table: RobotTable) -> list[Truth]:
    """Truths of a walk with the first gait of the paper."""
    robot = VirtualRobot(table, SensorOptions.exact(), engine=engine)
    robot.reset(plan_motion(table, plan_walk(robot_gait(table, "test1", WALK_S)))[0])
    return steps(robot, WALK_S)


def steps(robot: VirtualRobot, seconds: float) -> list[Truth]:
    truths = []
    for _ in range(round(seconds / robot.period)):
        robot.step()
        assert robot.truth is not None
        truths.append(robot.truth)
    return truths


def stood(engine: str) -> Truth:
    robot = VirtualRobot(COMAN, SensorOptions.exact(), engine=engine)
    robot.reset(plan_motion(COMAN, plan_walk(robot_gait(COMAN, "stand")))[0], settle_s=2.0)
    return steps(robot, 0.1)[-1]


def in_the_air(engine: str) -> tuple[float, float]:
    """Error of the COM's parabola [m], and the change of energy over the kinetic energy at first."""
    robot = VirtualRobot(COMAN, SensorOptions.exact(), [parse("joint_damping:scale=0.01")], engine=engine)
    robot.reset(plan_motion(COMAN, plan_walk(robot_gait(COMAN, "stand")))[0], settle_s=0.3)
    robot.data.qpos[2] += 2.0
    robot.data.qvel[:6] = [0.4, -0.2, 1.0, 0.5, -0.8, 0.3]
    robot._engine.reset(robot.data)  # noqa: SLF001
    model = pin.buildModelFromXML(urdf(COMAN), pin.JointModelFreeFlyer())
    data = model.createData()
    order = np.array([model.joints[model.getJointId(name)].idx_v for name in COMAN.joint_names])

    def energies() -> tuple[float, float]:
        q, v = np.zeros(model.nq), np.zeros(model.nv)
        q[:3], q[3:7], q[order + 1] = robot.data.qpos[:3], robot.data.qpos[[4, 5, 6, 3]], robot.data.qpos[7:]
        v[:3] = pin.Quaternion(q[3:7]).toRotationMatrix().T @ robot.data.qvel[:3]
        v[3:6], v[order] = robot.data.qvel[3:6], robot.data.qvel[6:]
        bent = robot.motion(np.array([robot.t]))[0][0] - q[order + 1]
        kinetic = pin.computeKineticEnergy(model, data, q, v)
        return kinetic, kinetic + pin.computePotentialEnergy(model, data, q) + 0.5 * float(robot.stiffness @ bent**2)

    kinetic, before = energies()
    truths = steps(robot, 0.2)
    change = (energies()[1] - before) / kinetic
    truths += steps(robot, 0.1)
    t = np.array([truth.t for truth in truths]) - truths[0].t
    com = np.array([truth.com for truth in truths])
    line = com + np.outer(0.5 * G * t**2, [0.0, 0.0, 1.0])
    fit = np.polynomial.polynomial.polyfit(t, line, 1)
    return float(np.abs(line - fit[0] - np.outer(t, fit[1])).max()), change


def dropped(engine: str, dampers: float = 1.0) -> tuple[float, float, float]:
    """Of a robot that is dropped from 2 cm: rebound of its soles and deepest sink [mm], largest force over weight."""
    weaker = [parse(f"joint_damping:scale={dampers}")]
    robot = VirtualRobot(COMAN, SensorOptions.exact(), weaker, engine=engine)
    robot.reset(plan_motion(COMAN, plan_walk(robot_gait(COMAN, "stand")))[0], settle_s=2.0)
    robot.data.qpos[2] += 0.02
    robot._engine.reset(robot.data)  # noqa: SLF001
    truths = steps(robot, 0.5)
    soles = 1e3 * np.array([min(truth.T_left[2, 3], truth.T_right[2, 3]) for truth in truths])
    force = np.array([(truth.left_wrench + truth.right_wrench)[2] for truth in truths])
    landed = int(np.argmax(force > 0.0))
    flights = np.flatnonzero(force[landed:] <= 0.0)
    flight = soles[landed + flights[0] :] if len(flights) else np.zeros(1)
    return float(flight.max()), float(-soles.min()), float(force.max() / (COMAN.mass * G))


def com_error(truth: Truth) -> float:
    """Distance of the COM from the one that Pinocchio computes of base and joints [m]."""
    model = pin.buildModelFromXML(urdf(COMAN), pin.JointModelFreeFlyer())
    order = [model.joints[model.getJointId(name)].idx_q for name in COMAN.joint_names]
    q = np.zeros(model.nq)
    q[:3], q[3:7], q[order] = truth.base_position, truth.base_orientation, truth.q
    return float(np.abs(pin.centerOfMass(model, model.createData(), q) - truth.com).max())


def creep(walk: list[Truth]) -> float:
    """Median over steps of how far a sole moves while it bears most of the weight [m]."""
    found = []
    for side in ("left", "right"):
        bears = np.array([getattr(truth, f"{side}_wrench")[2] for truth in walk]) > 0.9 * COMAN.mass * G
        soles = np.array([getattr(truth, f"T_{side}")[:2, 3] for truth in walk])
        edges = np.flatnonzero(np.diff(np.concatenate([[0], bears.astype(int), [0]])))
        for begin, end in zip(edges[::2], edges[1::2], strict=True):
            if end - begin > 30:
                found.append(np.linalg.norm(soles[begin:end] - soles[begin], axis=1).max())
    return float(np.median(found))


def speed(engine: str, table: RobotTable, floor: Floor | None = None) -> float:
    """Simulated over CPU time, sensors included."""
    robot = VirtualRobot(table, engine=engine, floor=floor)
    robot.reset(plan_motion(table, plan_walk(robot_gait(table, "test1")))[0], settle_s=0.5)
    began = time.process_time()
    steps(robot, 2.0)
    return 2.0 / (time.process_time() - began)


if __name__ == "__main__":
    main()
