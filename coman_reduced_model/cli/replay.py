# SPDX-License-Identifier: BSD-3-Clause
"""`coman replay`."""

from __future__ import annotations

import os
import time
from contextlib import suppress
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import ComanError
from .common import BagArgument, JsonOption, NamespaceOption, RemapOption, print_json, progress, warn
from .interrupt import answered

if TYPE_CHECKING:
    from ..ros.tools.replay import Progress

_PATIENCE_S = 120.0  # a predictor that has never run on a machine compiles for a minute before it listens


def replay(
    bag: BagArgument,
    rate: Annotated[
        float, typer.Option("--rate", metavar="R", min=0.0, help="Times as fast; 0: no waiting at all.")
    ] = 1.0,
    loop: Annotated[bool, typer.Option("--loop", help="Begin again at the end, until Ctrl-C.")] = False,
    wait: Annotated[
        float, typer.Option("--wait", metavar="S", min=0.0, help="Give nodes so long to connect [s].")
    ] = 1.0,
    listener: Annotated[
        list[str] | None,
        typer.Option("--await", metavar="TOPIC", help="Begin when somebody listens to it (120 s at most); repeatable."),
    ] = None,
    exclude: Annotated[
        list[str] | None, typer.Option("--exclude", metavar="TOPIC", help="Do not play; repeatable.")
    ] = None,
    namespace: NamespaceOption = "",
    remap: RemapOption = None,
    json: JsonOption = False,
) -> None:
    """Play a bag into ROS 2 in its own time, with /clock, until its end or Ctrl-C.

    Its messages stay on this machine unless you set `ROS_AUTOMATIC_DISCOVERY_RANGE`.
    """
    from ..topics import PREDICTION, TopicNames

    TopicNames(namespace, remap or ())  # says what is wrong with a name better than rcl does
    # Nobody who replays a bag at a desk means to drive a robot on the network.
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    try:
        import rclpy
        from rclpy.signals import SignalHandlerOptions

        from ..ros.tools.replay import Replay
    except ImportError as error:
        raise ComanError(
            f"replay needs ROS 2 and its messages ({error}): source ROS 2 Jazzy, or `make setup`"
        ) from None
    arguments = [item for rule in remap or () for item in ("-r", rule)]
    rclpy.init(args=["--ros-args", *arguments] if arguments else [], signal_handler_options=SignalHandlerOptions.NO)
    node = player = None
    try:
        node = rclpy.create_node("replay", namespace=namespace.strip("/") or None)
        player = Replay(node, bag, tuple(topic.lstrip("/") for topic in exclude or ()))
        warn([*player.bag.warnings, *(f"{topic}: not played: {why}" for topic, why in player.progress.skipped.items())])
        if player.has(PREDICTION):
            warn([f"plays {PREDICTION} as recorded, beside that of any predictor that runs (--exclude {PREDICTION})"])
        time.sleep(wait)
        awaited = [topic.lstrip("/") for topic in listener or ()]
        warn([f"--await {each}: the bag has no such topic: not waited for" for each in awaited if not player.has(each)])
        if awaited := [each for each in awaited if player.has(each)]:
            player.wait_for_subscribers(awaited, _PATIENCE_S)
        with progress("replaying") as report:

            def keep_going(state: Progress) -> bool:
                if not state.messages % 50:
                    behind = f", {1e3 * state.lag_s:.0f} ms behind" if state.lag_s > 0.02 else ""
                    done = state.messages / max(state.total, 1) - (state.loops - 1)
                    report(done, f"{state.messages} messages{behind}")
                return True

            player.play(rate, loop, keep_going)
    except KeyboardInterrupt:  # how a replay is usually ended
        if player is None:
            raise
        answered()
    finally:
        with suppress(Exception):
            if player is not None:
                player.close()
            if node is not None:
                node.destroy_node()
            rclpy.try_shutdown()
    result = player.progress
    if json:
        print_json(
            {"bag": str(bag), "messages": result.messages, "max_lag_s": result.max_lag_s, "skipped": result.skipped}
        )
    else:
        print(f"{result.messages} messages; at most {1e3 * result.max_lag_s:.1f} ms late")
