# SPDX-License-Identifier: BSD-3-Clause
"""Start a node, spin it, stop it: exit code 0 on Ctrl-C or SIGTERM however often, 2 with one line on bad input."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from ...errors import ComanError
from .processes import PARENT

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_TAKING_DOWN_S = 3.0  # launch sends the next signal after 5 s


class Stop:
    """Takes the first SIGINT or SIGTERM; all later ones are ignored. While `at_once`, it interrupts."""

    def __init__(self) -> None:
        self.requested = False
        self.at_once = True
        self.interrupted = False  # it has
        for number in _SIGNALS:
            signal.signal(number, self._take)

    def _take(self, number: int, frame: object) -> None:
        self.requested = True
        for each in _SIGNALS:  # ignored even while the interpreter shuts down, which would restore a handler
            signal.signal(each, signal.SIG_IGN)
        if self.at_once:
            self.interrupted = True
            raise KeyboardInterrupt


class _TimerEvent(ctypes.Structure):
    """`struct sigevent` of Linux: at its time, a thread of its own calls `function(value)`."""

    _fields_ = [
        ("value", ctypes.c_void_p),
        ("signal", ctypes.c_int),
        ("notify", ctypes.c_int),
        ("function", ctypes.c_void_p),
        ("rest", ctypes.c_char * 40),
    ]


def exit_in(seconds: float, failed: bool = False) -> None:
    """End the process after some seconds [s], even if by then a call into C holds the interpreter's lock.

    Exit code 0, or 1 if it has failed.

    Fast DDS 2.14 can hang while it is taken down: `DomainParticipant::set_listener` waits for a callback of discovery
    that waits for the participant's mutex, if another participant leaves at that moment (seen in one of 250 nodes that
    were stopped six at a time). No Python thread can run then. Where timers are not in libc, nothing happens.
    """
    thread = 2  # SIGEV_THREAD
    with suppress(AttributeError, OSError):
        libc = ctypes.CDLL(None)
        leave = ctypes.cast(libc._exit, ctypes.c_void_p).value
        timer, event = ctypes.c_void_p(), _TimerEvent(value=int(failed), notify=thread, function=leave)
        if not libc.timer_create(1, ctypes.byref(event), ctypes.byref(timer)):  # CLOCK_MONOTONIC
            when = (ctypes.c_long * 4)(0, 0, int(seconds), int(seconds % 1.0 * 1e9))  # once: no interval
            libc.timer_settime(timer, 0, ctypes.byref(when), None)


def run(name: str, find: Callable[[], Callable[[], Any]]) -> int:
    """Run a node until it is asked to stop.

    Args:
        name: of the node, for messages.
        find: imports what makes the node, which takes long enough for a first Ctrl-C. The node may have `todo`, work
            that takes seconds (and may be interrupted), done between callbacks and then set to None; its `finish()`
            is called before it is destroyed.

    Returns:
        Exit code.
    """
    stop = Stop()
    try:
        return _run(name, find, sys.argv, stop)
    except KeyboardInterrupt:
        return 0
    except ComanError as error:
        print(f"{name}: {error}", file=sys.stderr, flush=True)
        return 2
    except Exception:
        if stop.interrupted:  # while compiling, which turns a KeyboardInterrupt into errors of its own
            return 0
        raise


def _run(name: str, find: Callable[[], Callable[[], Any]], argv: list[str], stop: Stop) -> int:
    import rclpy
    from rclpy.experimental import EventsExecutor
    from rclpy.signals import SignalHandlerOptions

    from ..interface.parameters import check_files

    check_files(argv, name)  # first, because the other imports take a second or two
    make_node = find()
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
        parent = os.environ.get(PARENT)  # None: it outlives who started it
        while not stop.requested and parent in (None, str(os.getppid())):
            if getattr(node, "todo", None) is not None:
                todo, node.todo = node.todo, None
                stop.at_once = True
                todo()
                stop.at_once = False
            executor.spin_once(timeout_sec=0.1)
        node.finish()
    finally:
        stop.at_once = False
        if stop.requested:
            exit_in(_TAKING_DOWN_S, failed=isinstance(sys.exc_info()[1], Exception) and not stop.interrupted)
        with suppress(Exception):  # whatever is wrong at the end, the reason for ending is what counts
            sys.stdout.flush()
            if executor is not None:
                executor.shutdown()
            if node is not None:
                node.destroy_node()
            rclpy.try_shutdown()
    return 0
