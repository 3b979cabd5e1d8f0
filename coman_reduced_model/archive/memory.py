# SPDX-License-Identifier: BSD-3-Clause
"""How much memory a worker may take. One that takes more is ended: what it was at could not go on correctly.

A limit of the system would make allocations fail instead, and readers take a failed allocation for a damaged bag.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

_STATM = Path("/proc/self/statm")  # of Linux; elsewhere there is no limit
_EVERY = 0.05  # [s] what is taken in between is not seen


@contextmanager
def memory_watched(megabytes: int, exceeded: Callable[[], object]) -> Iterator[None]:
    """End this process, after a last call, as soon as it has more than this in memory [MB]; 0: no limit."""
    if megabytes <= 0 or not _STATM.is_file():
        yield
        return
    done, most = threading.Event(), megabytes * 2**20

    def watch() -> None:
        while resident() <= most:
            if done.wait(_EVERY):
                return
        exceeded()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
    try:
        yield
    finally:
        done.set()


def resident() -> int:
    """Memory of this process [bytes]."""
    return int(_STATM.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
