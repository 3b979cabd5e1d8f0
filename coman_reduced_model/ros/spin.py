# SPDX-License-Identifier: BSD-3-Clause
"""Start a node, spin it, stop it: exit code 0 on Ctrl-C or SIGTERM however often, 2 with one line on bad input."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from ..errors import ComanError


class Stop:
    """Takes SIGINT and SIGTERM. While `at_once`, the first one interrupts; otherwise it is only noted."""

    def __init__(self) -> None:
        self.requested = False
        self.at_once = True
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._take)

    def _take(self, number: int, frame: object) -> None:
        first, self.requested = not self.requested, True
        if first and self.at_once:
            raise KeyboardInterrupt


def run(name: str, make_node: Callable[[], Any], argv: list[str] | None = None) -> int:
    """Run a node until it is told to stop.

    Args:
        name: of the node, for messages.
        make_node: makes it. It may have `todo`, work that takes seconds (and may be interrupted), done between
            callbacks and then set to None; and `finish()`, called before it is destroyed.
        argv: arguments; None: those of the command line.

    Returns:
        Exit code.
    """
    stop = Stop()
    argv = sys.argv if argv is None else argv
    try:
        return _run(name, make_node, argv, stop)
    except KeyboardInterrupt:
        return 0
    except ComanError as error:
        print(f"{name}: {error}", file=sys.stderr, flush=True)
        return 2


def _run(name: str, make_node: Callable[[], Any], argv: list[str], stop: Stop) -> int:
    import rclpy
    from rclpy.experimental import EventsExecutor
    from rclpy.signals import SignalHandlerOptions

    from .parameters import check_files

    check_files(argv, name)
    node = executor = None
    try:
        try:
            rclpy.init(args=argv, signal_handler_options=SignalHandlerOptions.NO)
            node = make_node()
        except (ComanError, KeyboardInterrupt):
            raise
        except Exception as error:  # arguments that rcl cannot read, as several types
            if type(error).__module__.startswith(("rclpy", "_rclpy")) or "rcl" in str(error):
                raise ComanError(" ".join(str(error).split())) from None
            raise
        # Several times cheaper than the other executors; its spin() never looks at signals.
        executor = EventsExecutor()
        executor.add_node(node)
        stop.at_once = False
        while not stop.requested:
            if getattr(node, "todo", None) is not None:
                todo, node.todo = node.todo, None
                stop.at_once = True
                todo()
                stop.at_once = False
            executor.spin_once(timeout_sec=0.1)
        node.finish()
    finally:
        stop.at_once = False
        with suppress(Exception):  # whatever is wrong at the end, the reason for ending is what counts
            if executor is not None:
                executor.shutdown()
            if node is not None:
                node.destroy_node()
            rclpy.try_shutdown()
    return 0
