# SPDX-License-Identifier: BSD-3-Clause
"""The folder that a diagnosis is written into."""

from __future__ import annotations

from pathlib import Path

from ...core.config.files import save_config
from ...output import OutputFolder, to_json
from ..result import DIAGNOSIS_FILE, MODEL_FILE, REPORT_FILE, Diagnosis
from .page import diagnosis_page


def save_diagnosis(diagnosis: Diagnosis, folder: str | Path, force: bool = False) -> None:
    """Write diagnosis.json, model.yaml and report.html.

    Raises:
        OutputError: the folder exists (without `force`), or cannot be written.
    """
    with OutputFolder(folder, force) as out:
        (out / DIAGNOSIS_FILE).write_text(to_json(diagnosis.result) + "\n", encoding="utf-8")
        comment = f"by coman diagnose: {diagnosis.result['sentence']}"
        save_config(diagnosis.model, out / MODEL_FILE, comment, folder=folder)
        (out / REPORT_FILE).write_text(diagnosis_page(diagnosis), encoding="utf-8")
