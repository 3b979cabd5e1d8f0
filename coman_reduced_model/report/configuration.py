# SPDX-License-Identifier: BSD-3-Clause
"""The section of a report that lists the configuration."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..core.config.schema import parameter_table
from ..core.evaluation.run import Run
from .page import Notice, Part, Section, Table, Text


def configuration_section(summary: Mapping[str, Any], run: Run, plots: Path | None) -> Section:
    """What differs from the nominal values, and all values, folded; run and plots as for all sections."""
    config, table = summary.get("config") or {}, parameter_table()
    if not config:
        return Section("Configuration", [Notice("The summary does not hold the configuration.")], "configuration")
    rows, changed = [], []
    for key, value in config.items():
        known = table.get(key)
        row = [
            key,
            _value(value),
            known.unit if known and known.unit != "1" else "",
            known.description if known else "",
        ]
        rows.append(row)
        if known is None or _value(value) != _value(known.nominal):
            changed.append(row)
    head = ["key", "value", "unit", "meaning"]
    parts: list[Part] = [
        Table(head, changed, "What differs from the nominal values.", words=4)
        if changed
        else Text("All values are nominal.")
    ]
    parts.append(Table(head, rows, words=4, folded=f"All {len(rows)} values"))
    return Section("Configuration", parts, "configuration")


def _value(value: Any) -> str:
    if isinstance(value, (list, tuple)):
        return ", ".join(_value(item) for item in value) or "none"
    if isinstance(value, bool):
        return "true" if value else "false"
    return f"{value:g}" if isinstance(value, (int, float)) else str(value) or "none"
