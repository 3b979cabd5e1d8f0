# SPDX-License-Identifier: BSD-3-Clause
"""No import circle between modules, and no import upward between rooms, wherever in a file the import stands."""

from __future__ import annotations

import ast
import graphlib
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1] / "coman_reduced_model"
NAME = PACKAGE.name

# From the bottom to the top. A module belongs to the innermost room that its name begins with, and may import from its
# own room and from those before it.
ROOMS = """
    errors resources progress output processes schemas
    core.base core.robot core.effects core.config core.streams core.measured core.model core.gait
    core.feedforward core.model.trunk core.monitor core.observer core.evaluation core.predictor core.pipeline core
    messages topics policies bag warm_up offline check export
    sim tuning report
    diagnose.data diagnose.physics diagnose.inference diagnose.result diagnose.report diagnose.workflow diagnose
    judge
    archive
    ros.interface ros.runtime ros.nodes ros.tools ros
    cli
    api __init__
""".split()

MODULES = {
    ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__"): path
    for path in sorted(PACKAGE.rglob("*.py"))
}


def imported(text: str, package: str) -> set[str]:
    """Modules of the package that a text of a module in `package` imports: at its top, in functions, for types only."""
    found = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            names = [whole if (whole := f"{base}.{alias.name}") in MODULES else base for alias in node.names]
        else:
            continue
        found.update(name for name in names if name.split(".")[0] == NAME)
    return found


ARROWS = {
    module: imported(path.read_text(encoding="utf-8"), module if path.stem == "__init__" else module.rpartition(".")[0])
    for module, path in MODULES.items()
}


def room_of(module: str) -> int:
    """Index in ROOMS."""
    inner = module.removeprefix(NAME).removeprefix(".") or "__init__"
    return max((i for i, room in enumerate(ROOMS) if f"{inner}.".startswith(f"{room}.")), key=lambda i: len(ROOMS[i]))


def test_imports_are_found_wherever_they_stand():
    text = """
from ..errors import ComanError
if TYPE_CHECKING:
    from .base.types import Array
def late():
    import coman_reduced_model.cli.main
    from . import pipeline
    import numpy
"""
    found = imported(text, f"{NAME}.core")
    assert found == {f"{NAME}.{each}" for each in ("errors", "core.base.types", "cli.main", "core.pipeline")}


def test_what_is_imported_exists():
    assert not [f"{a} imports {b}" for a, each in ARROWS.items() for b in each if b not in MODULES]


def test_no_module_imports_itself_by_way_of_others():
    graphlib.TopologicalSorter(ARROWS).prepare()  # a CycleError names the modules of the circle


def test_no_room_imports_one_above():
    upward = [f"{a} imports {b}" for a, each in sorted(ARROWS.items()) for b in each if room_of(b) > room_of(a)]
    assert not upward, "\n".join(upward)
