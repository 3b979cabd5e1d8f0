# SPDX-License-Identifier: BSD-3-Clause
"""Ctrl-C ends the work of a command, wherever it comes."""

from __future__ import annotations

import signal
import sys
from types import FrameType
from typing import Any

_SOON_S = 0.01
_AGAIN_S = 0.5  # far longer than an exception takes to be handled

_came = False


def listen() -> None:
    """From now on Ctrl-C raises KeyboardInterrupt.

    Compiled code and destructors can swallow it. As long as it is not handled, it is raised again. Where a lock is
    taken or released it waits: the lock would stay taken, and the threads of a pool would wait for it for ever.
    """
    signal.signal(signal.SIGINT, _on_interrupt)
    signal.signal(signal.SIGALRM, _again)
    sys.unraisablehook = _on_swallowed


def came() -> bool:
    """Whether Ctrl-C has come. Compiled code also turns it into errors of its own."""
    return _came


def answered() -> None:
    """The work is over, or has been ended by Ctrl-C: from now on it changes nothing."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.setitimer(signal.ITIMER_REAL, 0.0)


def _on_interrupt(number: int, frame: FrameType | None) -> None:
    """The first Ctrl-C ends the work, further ones do not disturb the cleaning up."""
    global _came
    _came = True
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.setitimer(signal.ITIMER_REAL, _SOON_S if _holds(frame) else _AGAIN_S, _AGAIN_S)
    if not _holds(frame):
        raise KeyboardInterrupt


def _again(number: int, frame: FrameType | None) -> None:
    if sys.exc_info()[0] is None and not _holds(frame):  # nothing is being handled
        raise KeyboardInterrupt


def _holds(frame: FrameType | None) -> bool:
    return frame is not None and frame.f_code.co_name in ("__enter__", "__exit__")


def _on_swallowed(unraisable: Any) -> None:
    if not _came:  # else Ctrl-C itself, or an error of something that it left half made
        sys.__unraisablehook__(unraisable)
