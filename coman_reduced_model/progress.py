# SPDX-License-Identifier: BSD-3-Clause
"""How long work reports how far it is."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[float, str], None]  # fraction done (0..1), what is being done


def part_of(whole: Progress, index: int, count: int, title: str) -> Progress:
    """The progress of one of `count` equal parts of some work, for what does that part."""
    return lambda fraction, what: whole((index + fraction) / count, f"{title}: {what}")
