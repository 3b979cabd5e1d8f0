# SPDX-License-Identifier: BSD-3-Clause
"""What to install for a command whose packages are not there: a plain `pip install` leaves out what few need."""

from __future__ import annotations

_EXTRAS = {"mujoco": "sim", "pydrake": "drake", "rerun": "view"}
_EXTRAS |= dict.fromkeys(("pyarrow", "fsspec", "duckdb", "ray"), "archive")


def remedy(error: ModuleNotFoundError) -> str | None:
    """One line that says what to install; None for a module that a complete installation has."""
    name = (error.name or "").partition(".")[0]
    if name in _EXTRAS:
        extra = _EXTRAS[name]
        return f"this needs {name}, which is not installed: pip install 'coman_reduced_model[{extra}]', or '.[{extra}]'"
    return None
