# SPDX-License-Identifier: BSD-3-Clause
"""`coman live`."""

from __future__ import annotations

import sys
import time
from typing import Annotated, Any

import typer

from . import complete
from .common import ConfigOption, read_config, say_domain

_START_S = 150.0
_LOWERED = 0.5  # own lead of the robot where it is compensated: what is left if the predictor fails
_AHEAD_S = 0.3  # and how far the plan is published ahead, so that its deflections come in time on a busy machine too


def live(
    gait: Annotated[
        str,
        typer.Option(
            "--gait", metavar="NAME", help="test1, test2, ...; default: gait.name.", autocompletion=complete.gaits
        ),
    ] = "",
    duration: Annotated[
        float | None, typer.Option("--duration", metavar="S", help="Stop after so long [s]; default: at Ctrl-C.")
    ] = None,
    world: Annotated[
        str,
        typer.Option(
            "--world",
            metavar="FILE|KIND|SEED",
            help="World of the virtual robot (coman worlds).",
            autocompletion=complete.worlds,
        ),
    ] = "",
    compensate: Annotated[
        bool,
        typer.Option(
            "--compensate",
            help="Motors lead by the planned deflection that the predictor publishes, instead of the robot's own lead.",
        ),
    ] = False,
    config: ConfigOption = None,
) -> None:
    """Virtual robot, trajectory and predictor, running live until Ctrl-C, with a view of the prediction."""
    settings = read_config(config, [f"gait.name={gait}"] if gait else [])
    from ..core.config.files import load_config
    from ..core.gait.gait import plan_walk
    from ..errors import ComanError, ConfigError
    from ..resources import config_path
    from ..ros.runtime.processes import NodeFailed, Nodes, confine, why_not
    from ..ros.runtime.spin import Stop
    from ..sim.record import suiting
    from ..sim.robot_table import ROBOTS
    from ..sim.worlds import world_for

    stop = Stop()
    confine()
    if problem := why_not():
        raise ComanError(f"live: {problem}")
    say_domain()
    if settings.robot.name not in ROBOTS:
        raise ConfigError(
            f"robot.name: {settings.robot.name!r}: there is no such virtual robot (there are: {', '.join(ROBOTS)})"
        )
    table = ROBOTS[settings.robot.name]
    if world:
        world_for(settings.robot.name, world)  # says what is wrong with it before anything is started
    # What suits the robot goes for what the configuration leaves open.
    planned = load_config(config, "trajectory").replaced({"gait.name": settings.gait.name} if gait else {})
    suits = {f"gait.{key.removesuffix('_m')}": value for key, value in suiting(table, planned.gait.name).items()}
    flat = planned.flat()
    walk: dict[str, Any] = {key: value for key, value in suits.items() if flat.get(key) == -1}
    walk["gait.name"] = planned.gait.name
    from ..core.gait.walk import gait_of

    plan_walk(gait_of(planned.replaced(walk)))  # says what is wrong with it before anything is started
    try:
        with Nodes(config or config_path()) as nodes:
            paced = {"use_sim_time": True}
            own: dict[str, Any] = {"virtual_robot.world": world} if world else {}
            plan: dict[str, Any] = {"gait.repeat": True, "gait.autostart": False}
            if compensate:
                own |= {"virtual_robot.compensate": True, "virtual_robot.lead": _LOWERED}
                plan["gait.ahead"] = _AHEAD_S
            nodes.start("virtual_robot", {**walk, **own, **paced})
            nodes.start("predictor", paced)
            nodes.start("trajectory", {**walk, **plan, **paced})
            stop.at_once = False
            _watch(nodes, duration, stop)
    except NodeFailed as error:
        print(f"coman: live failed: {error}", file=sys.stderr)
        raise typer.Exit(1) from None


def _watch(nodes: Any, duration: float | None, stop: Any) -> None:
    from rich.console import Console
    from rich.live import Live

    from ..bag.decode import decoder
    from ..bag.types import typestore
    from ..core.base.stream_names import REFERENCE
    from ..messages import COM_PREDICTION, prediction_from
    from ..ros.interface.diagnostic_report import IN_TIME, REAL_TIME
    from ..ros.runtime.processes import NodeFailed
    from ..ros.tools.listener import Listener
    from ..ros.tools.live_view import LiveView
    from ..ros.tools.paced_clock import PacedClock
    from ..ros.tools.tracking import Tracking

    view, store, tracking, decode = LiveView(), typestore(), Tracking(), decoder(REFERENCE)
    clocks: list[PacedClock] = []

    def on_prediction(raw: bytes) -> None:
        prediction = prediction_from(store.deserialize_cdr(raw, COM_PREDICTION))
        view.add(prediction)
        tracking.add(prediction)
        for clock in clocks:
            clock.on_prediction(prediction.stamp_ns)

    console = Console()
    with Listener("live", on_prediction, lambda raw: tracking.add_plan(decode(raw))) as listener:
        clocks.append(clock := PacedClock(listener.node))
        clock.follow_real_time()
        starter = _Starter(listener.node)
        ends = None if duration is None else time.monotonic() + duration
        deadline, shown = time.monotonic() + _START_S, 0.0
        screen = (
            Live(console=console, auto_refresh=False) if console.is_terminal and not console.is_dumb_terminal else None
        )
        try:
            if screen:
                screen.start()
            while not stop.requested and (ends is None or time.monotonic() < ends):
                nodes.check()
                if view.count:
                    starter.start_once()
                elif time.monotonic() > deadline:
                    raise NodeFailed(f"no prediction after {_START_S:g} s: {view.line(listener)}")
                if screen:
                    screen.update(view.panel(listener), refresh=True)
                elif time.monotonic() - shown > 1.0:
                    shown = time.monotonic()
                    print(view.line(listener), flush=True)
                time.sleep(0.2)
        finally:
            if screen:
                screen.stop()
        robot = listener.report("virtual_robot: simulation").values  # time goes on for all of them
        nodes.stop()
    model, rigid = view.rms_mm()
    if not view.count:
        if not stop.requested:
            raise NodeFailed(f"no prediction within {duration:g} s")
        print("no predictions were made")
        return
    print(f"{view.count} predictions; RMS error of the last seconds, x, y, z [mm]:")
    print("  model", *(f"{value:.2f}" for value in model), "  rigid", *(f"{value:.2f}" for value in rigid))
    print("COM off its plan while that moves [mm]:", *(f"{value:.2f}" for value in tracking.rms_mm()))
    for name in (REAL_TIME, IN_TIME):
        if name in robot:
            print(f"{name}: {robot[name]}")


class _Starter:
    """Starts the trajectory node, once it is there."""

    def __init__(self, node: Any) -> None:
        from std_srvs.srv import Trigger

        self._request = Trigger.Request()
        self._client = node.create_client(Trigger, "/trajectory/start")
        self._future: Any = None

    def start_once(self) -> None:
        """Call ~/start if that has not been done."""
        if self._future is None and self._client.service_is_ready():
            self._future = self._client.call_async(self._request)
