# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of how right the probabilities of a diagnosis are, for the page of the judge."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

CAPTION = "Reliability of the most likely statement, and alarms on robots with an effect against those on clean ones"
BLUE, GREY = "#0072b2", "#5b606b"


def draw(found: Mapping[str, Any], path: Path) -> None:
    """Draw `calibration` of a score.json into a file."""
    figure = Figure((8.6, 4.2), layout="constrained")
    reliable, alarms = figure.subplots(1, 2)
    for ax in (reliable, alarms):
        ax.plot([0, 100], [0, 100], color=GREY, linewidth=0.8)
        ax.set(xlim=(0, 100), ylim=(0, 100), aspect="equal")
        ax.grid(color="#e4e7ed", linewidth=0.5)
    for p, right, n in found["reliability"]:
        reliable.plot(100 * p, 100 * right, "o", color=BLUE, markersize=3.0 + n**0.5)
    reliable.set(xlabel="probability of the most likely statement [%]", ylabel="right [%]")
    reliable.set_title("larger dots: more diagnoses", fontsize="small")
    curve = found["roc"]
    alarms.plot(*(100 * np.array([0.0, *curve[key], 1.0]) for key in ("false_alarms", "found")), "o-", color=BLUE)
    alarms.set(xlabel="alarms on clean robots [%]", ylabel="alarms on medium and strong effects [%]")
    alarms.set_title("wherever the limit of an alarm is", fontsize="small")
    figure.savefig(path, dpi=75, metadata={"Software": None})
