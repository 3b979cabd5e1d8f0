# SPDX-License-Identifier: BSD-3-Clause
"""Tasks in processes of this machine. A process that is killed costs its task a second try, and nothing else."""

from __future__ import annotations

import multiprocessing
import os
import queue
import signal
import threading
from collections.abc import Generator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool

from ..processes import only_for_its_parent
from .work import DIED, Task, run_task

TRIES = 2
Outcome = tuple[Task, str]  # and the status of its part


def run_locally(tasks: Sequence[Task], workers: int) -> Generator[Outcome, None, None]:
    """Do all tasks; outcomes come as they are ready. Ends all processes when it is closed."""
    waiting: queue.SimpleQueue[Task] = queue.SimpleQueue()
    ready: queue.SimpleQueue[Outcome | BaseException] = queue.SimpleQueue()
    for task in tasks:
        waiting.put(task)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # each worker has a core, and no more
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    slots = [_Slot(waiting, ready) for _ in range(max(1, min(workers, len(tasks))))]
    try:
        for slot in slots:
            slot.start()
        for _ in tasks:
            outcome = ready.get()
            if isinstance(outcome, BaseException):
                raise outcome
            yield outcome
    finally:
        for slot in slots:
            slot.stop()
        for slot in slots:
            slot.join()


class _Slot(threading.Thread):
    """A thread with a process of its own: the pools of the standard library end with the first process that dies."""

    def __init__(self, waiting: queue.SimpleQueue[Task], ready: queue.SimpleQueue[Outcome | BaseException]) -> None:
        super().__init__(daemon=True)
        self._waiting, self._ready = waiting, ready
        self._stopped = False
        self._pool: ProcessPoolExecutor | None = None

    def run(self) -> None:
        while not self._stopped:
            try:
                task = self._waiting.get_nowait()
            except queue.Empty:
                break
            try:
                self._ready.put((task, self._done(task)))
            except BaseException as error:
                self._ready.put(error)
                break
        self._end()

    def stop(self) -> None:
        """End after the present task, which is cut short."""
        self._stopped = True
        for process in list(getattr(self._pool, "_processes", None) or {}).copy():
            _kill(process)

    def _done(self, task: Task) -> str:
        for _ in range(TRIES):
            if self._stopped:
                break
            if self._pool is None:
                self._pool = ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), only_for_its_parent)
            try:
                return self._pool.submit(run_task, task).result()
            except BrokenProcessPool:
                self._end()
        return DIED

    def _end(self) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
            self._pool = None


def _kill(process: int) -> None:
    try:
        os.kill(process, signal.SIGKILL)
    except (ProcessLookupError, PermissionError):
        return
