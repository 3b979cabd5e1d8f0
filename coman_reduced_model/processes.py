# SPDX-License-Identifier: BSD-3-Clause
"""Processes that work for a command. Ctrl-C in a terminal goes to all of them; only the command answers it."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import active_children, get_all_start_methods, get_context, parent_process, resource_tracker
from multiprocessing.process import BaseProcess
from typing import Any


@contextmanager
def workers(
    count: int, begin: Callable[..., None] | None = None, arguments: tuple[Any, ...] = (), method: str = "fork"
) -> Iterator[ProcessPoolExecutor]:
    """Processes that end with the block; an exception, Ctrl-C among them, ends them at once, with what they started.

    Args:
        count: how many work at a time.
        begin: called with `arguments` in each of them first.
        method: to start them; "spawn" where there is no "fork".
    """
    before = {process.pid for process in active_children()}
    context = get_context(method if method in get_all_start_methods() else "spawn")
    pool = _Pool(max(1, count), context, _begin, (begin, arguments))
    try:
        with _interrupts_kept():
            pool.submit(int)
        yield pool
    except BaseException:
        for process in active_children():
            if process.pid not in before:
                process.terminate()
        pool.shutdown(cancel_futures=True)
        raise
    pool.shutdown()


class _Pool(ProcessPoolExecutor):
    def submit(self, call: Callable[..., Any], /, *arguments: Any, **named: Any) -> Future[Any]:
        return super().submit(_work, call, *arguments, **named)


_ended = _working = False
_LONGEST_END_S = 5.0
_LOOK_S = 0.2


def _begin(begin: Callable[..., None] | None, arguments: tuple[Any, ...]) -> None:
    """Ctrl-C is not for it. A process that is to end leaves its work, with the command that it waits for."""
    only_for_its_parent()
    signal.signal(signal.SIGTERM, _end)
    if begin is not None:
        begin(*arguments)


def only_for_its_parent() -> None:
    """In a new process: Ctrl-C is for the one that started it, and without that one there is nothing to do."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
    threading.Thread(target=_follow, args=(parent_process(),), daemon=True).start()


def _follow(parent: BaseProcess | None) -> None:
    if parent is not None:
        while os.getppid() == parent.pid:  # its end is not seen by others that it started
            time.sleep(_LOOK_S)
        os.kill(os.getpid(), signal.SIGTERM)  # and with it what it waits for
        end = time.monotonic() + _LONGEST_END_S
        while _working and time.monotonic() < end:
            time.sleep(_LOOK_S)
        os._exit(1)


def _work(call: Callable[..., Any], /, *arguments: Any, **named: Any) -> Any:
    global _working
    if _ended:
        sys.exit(128 + signal.SIGTERM)
    _working = True
    try:
        return call(*arguments, **named)
    finally:
        _working = False


def _end(number: int, frame: object) -> None:
    """By an exception, but not while a result is sent: half of one would block both processes for ever.

    What has not ended some seconds later is ended by the system.
    """
    global _ended
    _ended = True
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_REAL, _LONGEST_END_S)
    if _working:
        sys.exit(128 + number)


@contextmanager
def _interrupts_kept() -> Iterator[None]:
    """Ctrl-C comes at the end of the block; processes that are started meanwhile do not get it until they ignore it.

    Outside of the main thread nothing is done.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    resource_tracker.ensure_running()  # it would unblock the signal
    came: list[int] = []
    handler = signal.signal(signal.SIGINT, lambda *_: came.append(1))  # another thread may take it
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        if came:
            signal.raise_signal(signal.SIGINT)
