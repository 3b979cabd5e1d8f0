# SPDX-License-Identifier: BSD-3-Clause
"""Learns from clean cases how much nominal robots vary, what is usual, and how far each law is to be trusted.

All depend on each other: a law that is trusted too far makes robots seem to vary that do not, and the other way round.
They are learnt in turn, ROUNDS times.
"""

from __future__ import annotations

import pickle
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from ..core.base.nominal import Nominal
from ..core.base.types import Array
from ..core.config.files import load_config
from ..core.effects.unknown import FOOT_SENSORS, ROBOT, Unknown
from ..diagnose.data.reading import read_bags
from ..diagnose.inference.case import Case, examine, repeats_of, with_known
from ..diagnose.inference.check import Checked, check_recordings
from ..diagnose.inference.effects import with_structure
from ..diagnose.inference.prior import Kind
from ..diagnose.inference.trust import ByLaw, agreement, learn_trust
from ..diagnose.inference.variability import adapted, learn_widths, means_of, widths_of_robot
from ..diagnose.physics.hypotheses import unknowns
from ..errors import ComanError, ConfigError
from ..output import write_file
from .cases import BAGS
from .seeds import commit

ROUNDS = 3


def learn_variability(clean: Sequence[tuple[Path, Path]], nominal: Nominal, pool: Executor) -> Nominal:
    """The same record with new `widths` (among them what is usual), `trust` and `repeats`.

    Args:
        clean: of each clean case, its bags, and a file in which what takes long to compute is kept.
        nominal: its data sheets are where learning begins; its other figures are kept.
        pool: processes that work at it.

    Raises:
        ConfigError: there is no clean case with two recordings.
    """
    read = pool.map(partial(linear_evidence, nominal=nominal), *zip(*clean, strict=True))
    kept = [(path, each) for (_, path), each in zip(clean, read, strict=True) if each and len(each[0]) > 1]
    if not kept:
        raise ConfigError("no clean case with two recordings or more: widths cannot be learnt (--keep-widths)")
    files, found = [path for path, _ in kept], [each for _, each in kept]
    laws = sorted({part.law for recordings, _ in found for each in recordings for part in each.parts})
    known = sheets = replace(nominal, widths=nominal.sheets, precise={})
    of_robots: list[tuple[Kind, dict[str, float]]] = [((), dict(sheets.widths))] * len(found)
    usual = {name: value for name, value in nominal.widths.items() if name.endswith(".usual")}
    for _ in range(ROUNDS):
        tasks = [(file, widths, usual) for file, (_, widths) in zip(files, of_robots, strict=True)]
        trust = learn_trust(laws, partial(_agreements, pool, tasks))
        evidences = [[each.evidence(trust) for each in _about(recordings, usual)] for recordings, _ in found]
        known = learn_widths(evidences, sheets)
        of_robots = [widths_of_robot(robot, known) for robot in evidences]
        usual |= {name: max(usual[name] + more, 0.0) for name, more in means_of(evidences, known).items()}
    precise = {part: sum(part in kind for kind, _ in of_robots) for part in (ROBOT, FOOT_SENSORS)}
    source = {**nominal.source, "widths": {"commit": commit(), "robots": len(found), "precise": precise}}
    return replace(
        nominal, source=source, widths={**known.widths, **usual}, precise=known.precise, trust=trust,
        repeats=learn_repeats([each for _, each in found]),
    )  # fmt: skip


def _agreements(
    pool: Executor, tasks: Sequence[tuple[Any, ...]], trust: Mapping[str, float]
) -> Iterator[tuple[float, dict[str, float]]]:
    """Of all robots."""
    return pool.map(partial(_agreement, trust=trust), *zip(*tasks, strict=True), chunksize=4)


def _agreement(
    stored: Path, widths: Mapping[str, float], usual: Mapping[str, float], trust: Mapping[str, float]
) -> tuple[float, dict[str, float]]:
    """`agreement` of the robot of a file that `linear_evidence` wrote."""
    return agreement(_about(_read(stored)[0], usual), widths, trust)


@cache
def _read(stored: Path) -> tuple[list[ByLaw], dict[str, float]]:
    """What `linear_evidence` wrote; a process keeps it, as handing it on takes longer than computing with it."""
    found: tuple[list[ByLaw], dict[str, float]] = pickle.loads(stored.read_bytes())
    return found


def _about(recordings: Sequence[ByLaw], usual: Mapping[str, float]) -> list[ByLaw]:
    """Recordings about what is usual."""
    return [each.about(_beyond(each.unknowns, usual)) for each in recordings]


def _beyond(known: Sequence[Unknown], usual: Mapping[str, float]) -> Array:
    """(P,) by how much more is usual of each parameter than was taken for it when the recordings were read."""
    return np.array([
        usual[each.widths["usual"]] * each.relative - each.usual if "usual" in each.widths else 0.0 for each in known
    ])  # fmt: skip


def checked_case(bags: Path, nominal: Nominal, whole: bool = False) -> Checked:
    """The recordings of a case; `whole`: no recording is divided where another cannot be used.

    Raises:
        ComanError: they cannot be used.
    """
    config = with_structure(load_config(bags / "robot.yaml"))
    readings = read_bags([bags / bag for bag in BAGS], config, None, None, lambda done, what: None)
    return check_recordings(readings, 1, config, [], whole=whole, nominal=nominal)


def linear_evidence(bags: Path, stored: Path, nominal: Nominal) -> tuple[list[ByLaw], dict[str, float]] | None:
    """Evidence of each recording of a clean case, linear about nominal, and its `repeats`; kept in a file."""
    if not stored.is_file():
        try:
            checked = checked_case(bags, nominal, whole=True)
        except ComanError:
            return None
        recordings = [*checked.train, *checked.select, *checked.confirm]
        known = unknowns(recordings[0][0], recordings[0][1], nominal)
        cases = [examine(each, known, np.zeros(len(known)), nominal=nominal) for each in recordings]
        light = [replace(unknown, change=None, widths=dict(unknown.widths)) for unknown in known]  # type: ignore[arg-type]
        evidence = [replace(ByLaw.of(case), unknowns=light) for case in cases]
        write_file(stored, pickle.dumps((evidence, repeats(cases, nominal))))
    return _read(stored)


def repeats(cases: Sequence[Case], nominal: Nominal) -> dict[str, float]:
    """By law, what repeats with each stride although all that varies on nominal robots is fitted."""
    known = adapted([case.evidence for case in cases], nominal)
    return repeats_of([with_known(case, known) for case in cases])


def learn_repeats(robots: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Of the `repeats` of clean robots, the median by law."""
    laws = sorted({law for each in robots for law in each})
    medians = {law: float(np.median([each[law] for each in robots if law in each])) for law in laws}
    return {law: value for law, value in medians.items() if value > 0.0}
