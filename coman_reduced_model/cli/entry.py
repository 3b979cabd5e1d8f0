# SPDX-License-Identifier: BSD-3-Clause
"""Entry point of `coman`: Ctrl-C is taken care of before anything is imported that takes time."""

from __future__ import annotations

import os
import signal


def main() -> None:
    """`coman`."""
    signal.signal(signal.SIGINT, _leave)
    from .main import main as run

    run()


def _leave(number: int, frame: object) -> None:
    """Nothing has begun yet that would have to be ended."""
    os._exit(130)
