# SPDX-License-Identifier: BSD-3-Clause
"""Learns the section `monitor` of config/nominal.yaml from the clean robots of runs of the judge.

    coman judge --seeds 0:120 --out RUN --no-oracle
    python -m coman_reduced_model.judge.learn_monitor RUN... --out config/nominal.yaml --jobs 2

Everything else in the file stays. To be run again whenever laws or channels of the monitor change.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import yaml

from ..core.base.nominal import Nominal, load_nominal
from ..core.config.files import load_config
from ..diagnose.monitor_rows import Walk, rows_of_population, watch
from ..errors import BagError, ComanError
from ..output import write_file
from ..processes import workers
from .by_kind import kinds_of
from .cases import BAGS
from .learn import cases_of, header
from .seeds import commit


def watched(bag: Path, config: Path) -> Walk | None:
    """What the monitor sees in a recording; None: it cannot follow it."""
    try:
        return watch(bag, load_config(config))
    except ComanError:
        return None


def learn_monitor(runs: Sequence[Path], nominal: Nominal, jobs: int, without: Sequence[str] = ()) -> Nominal:
    """The record with what the channels of the monitor are like on the clean robots of these runs.

    Args:
        runs: folders of `coman judge`.
        nominal: everything but the section `monitor` is kept; of that, what no robot shows.
        jobs: processes.
        without: kinds of worlds to leave out.

    Raises:
        BagError: no clean robot can be followed.
    """
    cases = {
        run / "bags" / name: answer
        for run in runs
        for name, answer in cases_of(run).items()
        if answer["kind"] == "clean" and not set(without) & set(answer["worlds"].values())
    }
    bags = [case / bag for case in cases for bag in BAGS]
    configs = [bag.parent / "robot.yaml" for bag in bags]
    with workers(jobs) as pool:
        walks = {bag: walk for bag, walk in zip(bags, pool.map(watched, bags, configs), strict=True) if walk}
    if not walks:
        raise BagError(f"no clean robot that can be followed in {', '.join(map(str, runs))}")
    answers = [cases[case] for case in {bag.parent for bag in walks}]
    seeds = sorted({int(answer["seed"]) for answer in answers})
    source = {"commit": commit(), "robots": len(seeds), "walks": len(walks), "seeds": [seeds[0], seeds[-1]],
              "kinds": kinds_of(answers)}  # fmt: skip
    rows = rows_of_population(list(walks.values()), nominal.monitor)
    return replace(nominal, source={**nominal.source, "monitor": source}, monitor=rows)


def main() -> None:
    """See the top of this file."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--without", nargs="*", default=(), metavar="KIND", help="kinds of worlds to leave out")
    asked = parser.parse_args()
    nominal = learn_monitor([run.absolute() for run in asked.runs], load_nominal(), asked.jobs, asked.without)
    write_file(asked.out, header() + yaml.safe_dump(nominal.plain(), sort_keys=False, width=120))


if __name__ == "__main__":
    main()
