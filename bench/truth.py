# SPDX-License-Identifier: BSD-3-Clause
"""The truth of a recording, for benches: beside the bag, or, of the shipped walks, among the data of the tests."""

from __future__ import annotations

from pathlib import Path

from coman_reduced_model.bag.truth import true_motion
from coman_reduced_model.core.evaluation.consistency import TrueMotion

ROOT = Path(__file__).resolve().parent.parent


def truth_of(bag: str | Path) -> TrueMotion | None:
    """How the COM moved in truth; None: nobody knows."""
    path = Path(bag).resolve()
    shipped = path.parent == ROOT / "bags"
    return true_motion(ROOT / "test" / "data" / path.name if shipped else path)
