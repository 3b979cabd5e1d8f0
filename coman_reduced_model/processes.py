# SPDX-License-Identifier: BSD-3-Clause
"""Processes that work for a command. Ctrl-C in a terminal goes to all of them; only the command answers it."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import active_children, get_all_start_methods, get_context
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
    pool = ProcessPoolExecutor(max(1, count), context, _begin, (begin, arguments))
    with _interrupts_ignored():  # by what this starts
        pool.submit(int)
    try:
        yield pool
    except BaseException:
        for process in active_children():
            if process.pid not in before:
                process.terminate()
        pool.shutdown(cancel_futures=True)
        raise
    pool.shutdown()


def _begin(begin: Callable[..., None] | None, arguments: tuple[Any, ...]) -> None:
    """A process that is to end leaves its work by an exception: a command that it waits for is ended too."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    if begin is not None:
        begin(*arguments)


@contextmanager
def _interrupts_ignored() -> Iterator[None]:
    """Processes that are started meanwhile ignore Ctrl-C; outside of the main thread they do not."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
