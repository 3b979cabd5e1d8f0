# SPDX-License-Identifier: BSD-3-Clause
"""How well recordings of clean robots determine the sizes of effects.

`python -m coman_reduced_model.judge.sizes OUT [FAMILY ...]` measures `recorded` of sizes.yaml on the clean cases of a
run, of all families or of these.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ..errors import ComanError
from ..processes import workers
from ..sim.worlds import World
from ..sim.worlds.world import world_from_yaml
from .families import BENT, FAMILIES, LINKS, SIZES, Family, link_mass, working_stretch
from .folder import RunFolder
from .rank import evidence_with, ranking
from .variability import true_deviations


def recorded_deviations(bags: Path, world: World) -> dict[str, list[float]]:
    """By family, how well the recordings of a clean robot determine its size: the posterior's standard deviation.

    Of each effect alone, at each of its places, when clean robots vary as they do in this world.

    Raises:
        ComanError: the bags cannot be used.
    """
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
        if where[1:] not in BENT:
            return None
        value *= working_stretch(where[1:], world.table) ** 2
    if name == "body_mass":
        if where and where[1:] not in LINKS:
            return None
        value *= link_mass(world.table, where)
    if (name == "soft_roll") != (where[1:] in ("HipLat", "AnkLat")) and family.effect == "joint_stiffness":
        return None
    return value / family.factor(world.table)


def _deviations_of_case(task: tuple[Path, str]) -> dict[str, list[float]]:
    bags, world = task
    try:
        return recorded_deviations(bags, world_from_yaml(world))
    except ComanError as error:
        print(f"{bags.name}: {error}", file=sys.stderr)
        return {}


def main(arguments: Sequence[str]) -> None:
    """Measure `recorded` of sizes.yaml on the clean cases of a run: the median over cases and places."""
    folder = RunFolder(Path(arguments[0]).absolute())
    tasks = []
    for path in sorted(folder.sealed.glob("*.json")):
        if path != folder.seeds and (answer := json.loads(path.read_text(encoding="utf-8")))["kind"] == "clean":
            tasks.append((folder.bags(path.stem), answer["world"]))
    found: dict[str, list[float]] = {}
    with workers(2) as pool:
        for sizes in pool.map(_deviations_of_case, tasks):
            for name, values in sizes.items():
                found.setdefault(name, []).extend(values)
    entries = yaml.safe_load(SIZES.read_text(encoding="utf-8"))
    for name, values in found.items():
        if len(arguments) > 1 and name not in arguments[1:]:
            continue
        entries[name]["recorded"] = float(f"{np.median(values):.3g}")
    head = "".join(line for line in SIZES.read_text(encoding="utf-8").splitlines(True) if line.startswith("#"))
    SIZES.write_text(head + yaml.safe_dump(entries, sort_keys=False, default_flow_style=None), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
