# SPDX-License-Identifier: BSD-3-Clause
"""How long work reports how far it is."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[float, str], None]  # fraction done (0..1), what is being done


def between(whole: Progress, start: float, end: float, title: str = "") -> Progress:
    """The progress of a part of some work, for what does that part, which goes from one fraction to another."""
    return lambda fraction, what: whole(start + (end - start) * fraction, f"{title}: {what}" if title else what)
