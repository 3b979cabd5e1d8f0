# SPDX-License-Identifier: BSD-3-Clause
"""How much healthy robots of a world vary, and how well their recordings determine the size of an effect.

python -m coman_reduced_model.judge.variability OUT      # of a run with clean cases: measures sizes.yaml
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ..errors import ComanError
from ..sim.disturbances import imperfections as made
from ..sim.disturbances.masses import Scatter
from ..sim.worlds import World
from .families import FAMILIES, SIZES, Family, working_stretch

EVEN = 1.0 / np.sqrt(12.0)  # standard deviation of an even distribution over its width


def true_deviations(world: World) -> dict[str, float]:
    """Standard deviations over healthy robots of this world, by the names of core/effects/widths.py.

    What is not named keeps the width of the diagnosis. Sensors' zeros are those of the sensors of this world.
    """
    scatter, a, s = Scatter(), world.imperfections, world.sensors
    noise = {
        "joint_stiffness.scale.spread": scatter.spring,
        "joint_damping.scale.spread": scatter.spring,
        "mass.spread": scatter.mass,
        "com.spread": scatter.com,
        "torque_zero.spread": max(s.torque_bias, 1e-3),
        "wrench_scale.scale.spread": float(np.hypot(a * made.WRENCH_GAIN, s.wrench_gain)) + 1e-4,
        "imu.spread": s.tilt_bias,
        **_zeros(s),
    }
    if a == 0.0:
        return noise
    return noise | {
        "encoder_bias.bias.spread": float(np.hypot(a * made.ENCODER_ZERO, a * made.ECCENTRICITY / 2.0)),
        "backlash.width.slack": a * made.PLAY * 0.65,
        "joint_friction.coulomb.spread": a * made.FRICTION * 0.65,
        "transport_delay.delay.spread": a * (made.DELAY + made.LINK_LATE) * EVEN,
        "motor_lag.time_constant.slack": a * made.LAG * EVEN,
        "wrench_delay.delay.spread": a * made.WRENCH_LATE * EVEN,
        "encoder_delay.delay.spread": a * made.LINK_LATE * EVEN,
        "ground_slope.spread": a * made.SLOPE,
    }


def _zeros(sensors: Any) -> dict[str, float]:
    """Deviations of the zeros of the foot sensors."""
    out = {}
    for k, axis in enumerate("xyz"):
        force = np.hypot(sensors.force_bias[k], 2.0 * sensors.wrench_zero * EVEN)
        moment = np.hypot(sensors.moment_bias[k], 0.1 * sensors.wrench_zero * EVEN)
        out |= {f"zero_f{axis}.spread": float(force), f"zero_t{axis}.spread": float(moment)}
    return out


def recorded_deviations(bags: Path, world: World) -> dict[str, list[float]]:
    """By family, how well the recordings of a clean robot determine its size: the posterior's standard deviation.

    Of each effect alone, at each of its places, when healthy robots vary as they do in this world.

    Raises:
        ComanError: the bags cannot be used.
    """
    from .rank import evidence_with, ranking

    found: dict[str, list[float]] = {}
    for row in ranking(evidence_with(bags, true_deviations(world))):
        for name, family in FAMILIES.items():
            if family.effect == row["name"] and family.parameter in row["parameters"]:
                size = _size(name, family, row, world)
                if size is not None:
                    found.setdefault(name, []).append(size)
    return found


def _size(name: str, family: Family, row: Mapping[str, Any], world: World) -> float | None:
    """The deviation in units of the size, for COMAN; None: not at a place of this family."""
    where, value = row["where"], float(row["parameters"][family.parameter]["deviation"])
    if name in ("hardening", "softening"):
        if where[1:] not in ("KneeSag", "AnkSag"):
            return None
        value *= working_stretch(where[1:], world.table) ** 2
    if (name == "soft_roll") != (where[1:] in ("HipLat", "AnkLat")) and family.effect == "joint_stiffness":
        return None
    return value / family.factor(world.table)


def _deviations_of_case(task: tuple[Path, str]) -> dict[str, list[float]]:
    from ..sim.worlds.world import world_from_yaml

    bags, world = task
    try:
        return recorded_deviations(bags, world_from_yaml(world))
    except ComanError as error:
        print(f"{bags.name}: {error}", file=sys.stderr)
        return {}


def main(arguments: Sequence[str]) -> None:
    """Measure `recorded` of sizes.yaml on the clean cases of a run: the median over cases and places."""
    import json

    from .run import RunFolder

    folder = RunFolder(Path(arguments[0]).absolute())
    answers = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(folder.sealed.glob("*.json"))
               if path.name != "seeds.json"]  # fmt: skip
    names = [path.stem for path in sorted(folder.sealed.glob("*.json")) if path.name != "seeds.json"]
    tasks = [(folder.bags(n), a["world"]) for n, a in zip(names, answers, strict=True) if a["kind"] == "clean"]
    found: dict[str, list[float]] = {}
    with ProcessPoolExecutor(2) as pool:
        for sizes in pool.map(_deviations_of_case, tasks):
            for name, values in sizes.items():
                found.setdefault(name, []).extend(values)
    entries = yaml.safe_load(SIZES.read_text(encoding="utf-8"))
    for name, values in found.items():
        entries[name]["recorded"] = float(f"{np.median(values):.3g}")
    head = "".join(line for line in SIZES.read_text(encoding="utf-8").splitlines(True) if line.startswith("#"))
    SIZES.write_text(head + yaml.safe_dump(entries, sort_keys=False, default_flow_style=None), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
