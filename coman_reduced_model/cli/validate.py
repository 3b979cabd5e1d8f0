# SPDX-License-Identifier: BSD-3-Clause
"""`coman validate`."""

from __future__ import annotations

import json as json_module
import time
from pathlib import Path
from typing import Annotated, Any

import typer

from .common import (
    ConfigOption,
    ForceOption,
    JsonOption,
    NamespaceOption,
    RemapOption,
    SetOption,
    UrdfOption,
    print_json,
    print_table,
    progress,
    read_config,
)


def validate(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for report.html, validation.json, bags.")],
    bags: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[BAG...]", help="Tune on these; default: virtual robots, recorded now."),
    ] = None,
    holdout: Annotated[
        list[Path] | None, typer.Option("--holdout", metavar="BAG", help="With BAG: judge on this one; repeatable.")
    ] = None,
    robots: Annotated[
        str, typer.Option("--robots", metavar="NAMES", help="Virtual robots, with commas.")
    ] = "coman,tall,small",
    seed: Annotated[
        int | None,
        typer.Option(
            "--seed",
            metavar="N",
            min=0,
            help="Of the first recording; the others follow. Default: the next on which nothing was chosen or reported "
            "(judge/seeds.yaml).",
        ),
    ] = None,
    duration: Annotated[
        float | None, typer.Option("--duration", metavar="S", help="About how long each recorded walk is [s].")
    ] = None,
    processes: Annotated[int, typer.Option("--processes", metavar="N", help="Number of processes.")] = 2,
    quick: Annotated[
        bool, typer.Option("--quick", help="Only the paper's model and the whole one, on the paper's two gaits.")
    ] = False,
    untuned: Annotated[
        bool,
        typer.Option("--untuned", help="Virtual robots: compare the options only, which takes a third of the time."),
    ] = False,
    config: ConfigOption = None,
    changes: SetOption = None,
    urdf: UrdfOption = None,
    namespace: NamespaceOption = "",
    remap: RemapOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Tune on one gait, judge on others: options one by one and together, in one table and a report page."""
    settings = read_config(config, changes)
    from ..bag.reader import Bag
    from ..errors import ConfigError
    from ..judge.seeds import describe, fresh_range
    from ..output import OutputFolder, to_json
    from ..report.validation import validation_page
    from ..topics import TopicNames
    from ..tuning import validate as validation

    if bags and untuned:
        raise ConfigError("--untuned: only without BAG")
    of_bags = {"--urdf": urdf, "--namespace": namespace, "--remap": remap}
    if given := [option for option, value in of_bags.items() if value and not bags]:
        raise ConfigError(f"{given[0]}: only with BAG")
    if holdout and not bags:
        raise ConfigError("--holdout: name the bags to tune on as well")
    variants = validation.QUICK if quick else tuple(validation.VARIANTS)
    if bags:
        if not holdout:
            raise ConfigError("BAG: name bags to judge on with --holdout")
        if repeated := {bag.resolve() for bag in bags} & {bag.resolve() for bag in holdout}:
            raise ConfigError(f"--holdout: {min(repeated)} is also tuned on")
        named = {**{bag.name: bag for bag in bags}, **{bag.name: bag for bag in holdout}}
        if len(named) < len(bags) + len(holdout):
            raise ConfigError("BAG, --holdout: two bags have the same name")
        for bag in named.values():  # said before any work begins
            Bag(bag).close()
        cases = [
            validation.RobotCase(
                settings.robot.name, settings, named, names=TopicNames(namespace, remap or ()), urdf=urdf
            )
        ]
        train, judge = [bags[0].name], [bag.name for bag in holdout]
        if len(bags) > 1:
            raise ConfigError("BAG: tune on one bag here (coman tune takes several)")
    else:
        cases = [validation.virtual_case(name.strip(), settings) for name in robots.split(",")]
        train, judge = [] if untuned else ["test1", "test2"], list(validation.GAITS)[: 2 if quick else None]
    recordings = 0 if bags else len(cases) * (len(train) + len(judge))
    first = fresh_range("walks", recordings).start if seed is None else seed
    began = time.perf_counter()
    with OutputFolder(out, force) as folder:
        (folder / "bags").mkdir()
        with progress("validating") as report:
            done = validation.validate(
                cases,
                train,
                judge,
                folder / "bags",
                variants,
                first,
                duration,
                processes,
                lambda f, w: report(0.95 * f, w),
            )
            report(0.95, "drawing")
            result: dict[str, Any] = {
                "seed": first,
                "elapsed_s": time.perf_counter() - began,
                "summary": validation.summarise(done.scores),
                "scores": [vars(s) for s in done.scores],
            }
            (folder / "report.html").write_text(validation_page(done, cases, result, folder), encoding="utf-8")
        (folder / "validation.json").write_text(to_json(result) + "\n", encoding="utf-8")
    if json:
        print_json(json_module.loads(to_json(result)))
        return
    print_table(
        "Free run, RMS error [mm] over all walks; pitch [deg]; skill 0.2 s ahead",
        ["model", "walks", "x", "y", "z", "worst x", "worst z", "pitch", "skill x", "skill z"],
        validation.rows(result["summary"]),
    )
    if recordings:
        seeds = range(first, first + recordings)
        print(f"seeds {seeds[0]} to {seeds[-1]}: {describe('walks', seeds)}")
    print(f"{len(done.bags)} walks, {result['elapsed_s']:.0f} s")
    print(f"written: {out / 'report.html'}, {out / 'validation.json'}")
