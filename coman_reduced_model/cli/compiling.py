# SPDX-License-Identifier: BSD-3-Clause
"""The first use of an installation compiles the model, half a minute in which numba says nothing."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from ..resources import PACKAGE

COMPILING = "compiling the model, once per installation: half a minute to a minute"


@contextmanager
def compilation(say: Callable[[int, int], None]) -> Iterator[None]:
    """Call say(number, total) for each function that is compiled and not found compiled."""
    if "numba" not in sys.modules:  # the command has no use for the model, or has not loaded it yet
        yield
        return
    from numba.core import event

    class Count(event.Listener):
        """Counts functions; those that another one calls are compiled within it."""

        done = 0

        def on_start(self, event: Any) -> None:
            self.done += 1
            say(self.done, max(_functions(), self.done))

        def on_end(self, event: Any) -> None:
            pass

    with event.install_listener("numba:compile", Count()):
        yield


def _functions() -> int:
    """How many compiled functions the loaded modules of the package have."""
    from numba.core.dispatcher import Dispatcher

    modules = [module for name, module in list(sys.modules.items()) if name.startswith(f"{PACKAGE}.")]
    return len({id(each) for module in modules for each in vars(module).values() if isinstance(each, Dispatcher)})
