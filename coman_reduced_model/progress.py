# SPDX-License-Identifier: BSD-3-Clause
"""How long work reports how far it is."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[float, str], None]  # fraction done (0..1), what is being done
