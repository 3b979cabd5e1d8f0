# SPDX-License-Identifier: BSD-3-Clause
"""Does each effect do what it is for? Robots in which it is hidden, predicted without it and with its true figures.

    python bench/effects.py [EFFECT...]       # default: all; about half a minute each

Every robot walks test 1 with default sensors and one effect of medium strength in its physics or its sensors. Errors
are RMS, `without > with` the effect in the configuration; the truth is the simulator's:

    free run    predicted against measured COM, mm, x y z, by the turning trunk and by the paper's point mass
    truth       predicted (turning trunk) against true COM, mm
    measured    measured against true COM, mm
    share       share of the load on the left foot, by the wrenches, against the true one, percent
    odometry    COM in odom against the world along x, mm
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from coman_reduced_model.bag.session import Session
from coman_reduced_model.core.base.types import Flags, Foot
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.sim.disturbances import Disturbance, parse
from coman_reduced_model.sim.record import load_truth, plan_recording, record, robot_gait
from coman_reduced_model.sim.robot_table import COMAN
from coman_reduced_model.sim.sensors import SensorOptions

CASES = (
    "encoder_bias:where=LKneeSag,bias=0.012",
    "encoder_delay:delay=0.015",
    "wrench_delay:delay=0.015",
    "wrench_scale:where=left,scale=1.07",
    "wrench_bias:where=right,fz=12",
    "payload:mass=0.7,x=0.04,y=-0.03,z=0.12",
    "com_offset:x=0.012",
    "joint_stiffness:where=LKneeSag,scale=0.8",
    "joint_stiffness:scale=1.2",
    "joint_stiffness:where=LHipLat,scale=0.5",
    "joint_damping:where=LKneeSag,scale=2.5",
    "joint_damping:scale=0.4",
    "spring_nonlinearity:where=LKneeSag,cubic=70",
    "spring_nonlinearity:where=RKneeSag,cubic=-40",
    "backlash:where=LKneeSag,width=0.0122",
    "backlash:where=RHipLat,width=0.0122",
    "joint_friction:where=LKneeSag,coulomb=1.5",
    "ground_compliance:vertical=5e-6,rotational=2.5e-4",
    "ground_slope:pitch=0.0175",
    "ground_slope:roll=0.0175",
    "external_force:x=4",
    "external_force:y=4",
    "foot_slip:where=left,distance=0.006",
    "touchdown_impact:impulse=0.7",
    # Motor states that echo the command: what the motors make of it is not measured.
    "motor_lag:time_constant=0.015",
    "transport_delay:delay=0.015",
    "motor_compliance:compliance=0.0005",
)
COMMANDED = ("motor_lag", "transport_delay", "motor_compliance")
MODELS = {
    "trunk": Config(),
    "paper": Config().replaced({"model.trunk_rotation": "without"}),
}


def with_effect(base: Config, hidden: Disturbance) -> Config:
    """The configuration with the hidden effect as it is."""
    described = hidden.to_dict()
    active = [*base.flat()["effects.active"], described["name"]]  # type: ignore[misc]
    values = {f"effects.{described['name']}.{key}": [value] for key, value in described["parameters"].items()}
    return base.replaced(
        {"effects.active": active, f"effects.{described['name']}.where": [described["where"]], **values}
    )


def errors(path: Path, config: Config) -> dict[str, np.ndarray]:
    """RMS errors of one prediction of a bag, by column."""
    config = config.replaced({"prediction.horizons": []})
    truth = load_truth(path.with_name(f"{path.name}.truth.npz"))
    with Session(path, config) as session:
        results = list(session.predictions())
    good = [p for p in results if np.isfinite(p.residual).all() and not p.flags & Flags.STALE_WRENCH]
    stamps, at = truth["stamp_ns"], np.array([p.stamp_ns for p in good])

    def true(values: np.ndarray) -> np.ndarray:
        flat = values.reshape(len(values), -1)
        found = [np.interp(at - stamps[0], stamps - stamps[0], column) for column in flat.T]
        return np.array(found).T.reshape(-1, *values.shape[1:])

    com, T_left, T_right = (true(truth[name]) for name in ("com", "T_left", "T_right"))
    loads = true(np.stack([truth["left_wrench"][:, 2], truth["right_wrench"][:, 2]], axis=1))
    left = np.array([p.support.support_foot == Foot.LEFT for p in good])
    T = np.where(left[:, None, None], T_left, T_right)
    # The sole as the predictor takes it: flat on the floor.
    yaw = np.arctan2(T[:, 1, 0], T[:, 0, 0])
    c, s, r = np.cos(yaw), np.sin(yaw), com - T[:, :3, 3]
    true_com = np.stack([c * r[:, 0] + s * r[:, 1], -s * r[:, 0] + c * r[:, 1], r[:, 2]], axis=1)
    measured = np.array([p.measured_com for p in good])
    predicted = np.array([p.predicted_com for p in good])
    share = np.array([p.support.left_share for p in good]) - loads[:, 0] / loads.sum(axis=1)
    odom = np.array([(p.T_odom_sole[:3, :3] @ p.measured_com + p.T_odom_sole[:3, 3])[0] for p in good])
    odom -= com[:, 0]

    def rms(values: np.ndarray) -> np.ndarray:
        return np.sqrt(np.nanmean(np.square(values), axis=0))

    return {
        "free run": 1e3 * rms(measured - predicted),
        "truth": 1e3 * rms(true_com - predicted),
        "measured": 1e3 * rms(true_com - measured),
        "share": 1e2 * rms(share)[None],
        "odometry": 1e3 * rms(odom - odom[0])[None],
    }


def shown(before: np.ndarray, after: np.ndarray) -> str:
    """`1.20 > 0.80` for each axis; green where it fell by a tenth, red where it rose by one, dim where it is small."""
    parts = []
    for a, b in zip(before, after, strict=True):
        colour = "green" if b < 0.9 * a else "red" if b > 1.1 * a else "dim"
        parts.append(f"[{colour}]{a:.2f} > {b:.2f}[/{colour}]")
    return "\n".join(parts)


def main() -> None:
    """Record, predict twice, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("effects", nargs="*", help="names; default: all")
    parser.add_argument("--seconds", type=float, default=9.0, help="of walking")
    parser.add_argument("--gait", default="test1")
    arguments = parser.parse_args()
    console = Console(width=140)
    table = Table(title=f"hidden effects, {arguments.gait}: RMS errors without > with the effect", show_lines=True)
    for column in ("hidden", "free run: trunk", "free run: paper", "truth", "measured", "share %", "odometry"):
        table.add_column(column)
    walk = robot_gait(COMAN, arguments.gait, arguments.seconds)
    planned = plan_recording(walk, COMAN)
    with tempfile.TemporaryDirectory() as folder:
        for index, text in enumerate(CASES):
            name = text.partition(":")[0]
            if arguments.effects and name not in arguments.effects:
                continue
            hidden = parse(text)
            sensors = SensorOptions(motor_source="commanded" if name in COMMANDED else "measured")
            bag = Path(folder) / str(index)
            fallen = record(walk, bag, COMAN, sensors, [hidden], seed=1, planned=planned).fallen_s
            found = {
                model: [errors(bag, base), errors(bag, with_effect(base, hidden))] for model, base in MODELS.items()
            }
            trunk = found["trunk"]
            rest = [shown(trunk[0][column], trunk[1][column]) for column in ("truth", "measured", "share", "odometry")]
            runs = [shown(*(each["free run"] for each in found[model])) for model in MODELS]
            fell = f"\nfell at {fallen:.1f} s" if fallen is not None else ""
            table.add_row(text.replace(":", "\n").replace(",", "\n") + fell, *runs, *rest)
            console.print(f"{text}: free run, trunk {' '.join(runs[0].split(chr(10)))}", highlight=False)
    console.print(table)


if __name__ == "__main__":
    main()
