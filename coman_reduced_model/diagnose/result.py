# SPDX-License-Identifier: BSD-3-Clause
"""The result of a diagnosis."""

from __future__ import annotations

import dataclasses
from typing import Any

from ..core.config.schema import Config
from .data.recording import Recording
from .inference.finding import Finding
from .inference.predicted_com import Errors

DIAGNOSIS_FILE, MODEL_FILE, REPORT_FILE = "diagnosis.json", "model.yaml", "report.html"


@dataclasses.dataclass
class Diagnosis:
    """The result of a diagnosis.

    Attributes:
        result: contents of diagnosis.json.
        model: the configuration with the effects added.
        finding: the evidence behind it; recordings: of the training bags, then the held-out ones.
        com: errors of the predicted COM in the last held-out bag, or else training bag, with the nominal model and
            with all that was found.
    """

    result: dict[str, Any]
    model: Config
    finding: Finding
    recordings: list[Recording]
    com: Errors

    @property
    def verdict(self) -> str:
        """`effect`, `none`, `unknown` (something is missing, but it is not clear what) or `not_excited`."""
        return str(self.result["verdict"])

    @property
    def sentence(self) -> str:
        """The result in words."""
        return str(self.result["sentence"])
