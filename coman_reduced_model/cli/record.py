# SPDX-License-Identifier: BSD-3-Clause
"""`coman record`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from . import complete
from .common import ConfigOption, ForceOption, JsonOption, SetOption, print_json, progress, read_config, warn

if TYPE_CHECKING:
    from ..sim.disturbances import Disturbance
    from ..sim.record import RecordedBag


def record(
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Folder of the new bag; DIR.truth.npz is the truth.")
    ],
    gait: Annotated[
        str,
        typer.Option(
            "--gait",
            metavar="NAME",
            help="test1, test2, stand, ..., load, decay; default: gait.name.",
            autocompletion=complete.gaits,
        ),
    ] = "",
    duration: Annotated[
        float | None, typer.Option("--duration", metavar="S", help="About how long to walk [s].")
    ] = None,
    seed: Annotated[int, typer.Option("--seed", metavar="N", min=0, help="Of noise, bias, jitter and drops.")] = 0,
    robot: Annotated[str, typer.Option("--robot", metavar="NAME", help="Which virtual robot.")] = "coman",
    joint: Annotated[str, typer.Option("--joint", metavar="NAME", help="Of --gait decay: the soft joint.")] = "",
    rate: Annotated[float, typer.Option("--rate", metavar="HZ", help="Rate of the sensors [Hz].")] = 200.0,
    hide: Annotated[
        list[str] | None,
        typer.Option(
            "--hide", metavar="EFFECT", help="Hidden effect, as in backlash:where=LKneeSag,width=0.012; repeatable."
        ),
    ] = None,
    scatter: Annotated[
        int | None,
        typer.Option("--scatter", metavar="N", help="Springs, dampers and masses a few percent off, drawn by seed N."),
    ] = None,
    motor_states: Annotated[
        str, typer.Option("--motor-states", metavar="KIND", help="What /motor_states holds: measured or commanded.")
    ] = "measured",
    world: Annotated[
        str,
        typer.Option(
            "--world",
            metavar="FILE|KIND|SEED",
            help="Record this world (coman worlds lists the kinds), and store it as DIR.world.yaml.",
            autocompletion=complete.worlds,
            show_default=False,
        ),
    ] = "",
    exact: Annotated[bool, typer.Option("--exact", help="Perfect sensors: no noise, bias, jitter or drops.")] = False,
    config: ConfigOption = None,
    changes: SetOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Walk the virtual robot and record a bag of what its sensors publish.

    What is hidden changes physics or sensors, never the robot_description in the bag. Of a
    configuration gait.* counts.
    """
    if world:
        given = {"--robot": robot != "coman", "--rate": rate != 200.0, "--scatter": scatter is not None,
                 "--motor-states": motor_states != "measured", "--exact": exact, "--joint": joint,
                 "--config": config is not None, "--set": bool(changes)}  # fmt: skip
        _record_world(world, out, gait, duration, hide or (), seed, given, force, json)
        return
    settings = read_config(config, changes, "trajectory").gait
    from ..errors import ConfigError

    if ignored := [change for change in changes or () if not change.startswith("gait.")]:
        raise ConfigError(f"--set {ignored[0]}: only gait.* counts here; --hide, --scatter, --world change the robot")
    from ..sim.disturbances import Scatter
    from ..sim.experiments import EXPERIMENTS, record_experiment
    from ..sim.record import ROBOTS, SensorOptions
    from ..sim.record import record as record_walk

    if robot not in ROBOTS:
        raise ConfigError(f"--robot: {robot!r} is not allowed (allowed: {', '.join(ROBOTS)})")
    name = gait or settings.name
    kind = SensorOptions.exact if exact else SensorOptions
    sensors = kind(rate_hz=rate, motor_source=motor_states)
    hidden: list[Disturbance] = [] if scatter is None else [Scatter(scatter)]
    hidden += _hidden(hide or ())
    if joint and name != "decay":
        raise ConfigError("--joint: only with --gait decay")
    common: dict[str, Any] = {
        "robot": robot,
        "sensors": sensors,
        "disturbances": hidden,
        "seed": seed,
        "duration_s": duration,
    }
    with progress("recording") as report:
        if name in EXPERIMENTS:
            result = record_experiment(name, out, joint, **common, force=force, progress=report)
        else:
            result = record_walk(name, out, **common, changes=settings.changes(), force=force, progress=report)
    _show(result, name, json)


def _record_world(
    text: str,
    out: Path,
    gait: str,
    duration: float | None,
    hide: Sequence[str],
    seed: int,
    given: Mapping[str, object],
    force: bool,
    json: bool,
) -> None:
    """Record a world; a gait and a duration that are given replace its own.

    Raises:
        ConfigError: the world is not possible, or another option says what the world says already.
    """
    from ..errors import ConfigError
    from ..sim.worlds import record_world, world_of

    if refused := [option for option, value in given.items() if value]:
        raise ConfigError(
            f"{refused[0]}: not with --world, which says it (coman worlds {text} > FILE; edit; --world FILE)"
        )
    chosen = world_of(text)
    if gait:
        chosen = replace(chosen, gait=gait, gait_changes={}, kinds={**chosen.kinds, "gait": gait})
    if duration is not None:
        chosen = replace(chosen, duration_s=duration)
    hidden = _hidden(hide)
    with progress("recording") as report:
        result = record_world(chosen, out, hidden, seed, force, report)
    _show(result, chosen.gait, json)
    if not json:
        drawn = ", ".join(kind for axis, kind in chosen.kinds.items() if axis not in ("gait", "length"))
        print(f"world: {drawn or text}; robot {chosen.robot}; in full: {out}.world.yaml")


def _hidden(texts: Sequence[str]) -> list[Disturbance]:
    """The effects that --hide names.

    Raises:
        ConfigError: an effect or a parameter is not allowed.
    """
    from ..errors import ConfigError
    from ..sim.disturbances import parse

    try:
        for effect in (hidden := [parse(text) for text in texts]):
            what = effect.to_dict()
            if what["name"] not in ("scatter", "imperfections") and what["parameters"] == _nominal(what["name"]):
                keys = ", ".join(what["parameters"])
                raise ConfigError(f"{what['name']}: nothing is hidden without a parameter (allowed: {keys})")
        return hidden
    except ConfigError as error:
        raise ConfigError(f"--hide: {error}") from None


def _nominal(name: str) -> dict[str, Any]:
    """The parameters with which an effect changes nothing."""
    from ..sim.disturbances import DISTURBANCES

    return dict(DISTURBANCES[name]().to_dict()["parameters"])


def _show(result: RecordedBag, name: str, json: bool) -> None:
    if result.fallen_s is not None:
        warn([f"the robot fell at {result.fallen_s:.2f} s"])
    if json:
        print_json({**asdict(result), "bag": str(result.bag), "truth": str(result.truth)})
        return
    print(f"{result.duration_s:.1f} s of {name} at {result.realtime_factor:.1f} x real time")
    print(f"written: {result.bag} ({sum(result.messages.values())} messages), {result.truth}")
