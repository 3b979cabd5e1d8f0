# SPDX-License-Identifier: BSD-3-Clause
"""The page of a diagnosis."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..report.page import page

if TYPE_CHECKING:
    from .workflow import Diagnosis


def diagnosis_page(diagnosis: Diagnosis) -> str:
    """One self-contained HTML page."""
    return page("Diagnosis", diagnosis.result["sentence"], [])
