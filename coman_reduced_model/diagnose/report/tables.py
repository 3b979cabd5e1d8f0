# SPDX-License-Identifier: BSD-3-Clause
"""Tables of the effects that a diagnosis found or suspects: their values, the predicted COM, probabilities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ...core.evaluation.statistics import AXES
from ...report.page import Part, Table
from .words import FAR_HEAD, alternatives, far, figure, known, spaced

ROWS = 14  # of the heat map and the tables, the rest is folded away


def values(effects: Sequence[Mapping[str, Any]]) -> Table:
    """Each parameter with its interval, and the evidence for its effect."""
    rows = [
        [
            spaced(effect["name"]), effect["where"] or "–", " or ".join(alternatives(effect)) or "–", key,
            figure(parameter), f"{effect['evidence']:.0f}", known(effect["select_evidence"]),
            known(effect["confirm_evidence"]), known(effect["probability"], ".0%"),
        ]
        for effect in effects
        for key, parameter in effect["parameters"].items()
    ]  # fmt: skip
    caption = (
        "Values with intervals that are longer than 1.96 standard deviations of the linearised posterior by a "
        "factor, by robots with known faults, with which they are to hold 95 % of the true values. Evidence: "
        "natural logarithm of the ratio of the probabilities of the data with the effect and with no more than "
        "nominal variability (4.6 nats are 100 to 1), of the training recordings, of those that help to choose, "
        "and of the one that confirms. The probability is that of the effect and all that it could be as well, which "
        "these recordings cannot distinguish from it."
    )
    head = ["effect", "where", "could be as well", "parameter", "value"]
    return Table([*head, "training", "choosing", "confirming", "probability"], rows, caption, words=4)


def errors_of_com(effects: Sequence[Mapping[str, Any]], held: bool) -> Table:
    """What each effect makes of the predicted COM."""
    rows = []
    for effect in effects:
        errors, inside = effect["com"], "yes" if effect["in_model"] else "no"
        for axis in AXES:
            sizes = [f"{1e3 * errors[which][axis]:.3f}" for which in ("before", "after")]
            low, high = (1e6 * value for value in errors["change"][axis])
            change = f"{low:+.4f} to {high:+.4f}" if np.isfinite(high) else "–"
            rows.append([spaced(effect["name"]), effect["where"] or "–", axis, *sizes, change, inside])
    which = "held-out recordings" if held else "training recordings: none was held out"
    caption = (
        "Error of the predicted COM without and with each effect, beside the others in the model: RMS over the "
        f"{which}, both against the measurement as the effects correct it. The change of its square is a 95 % "
        f"interval, paired over {effects[0]['com']['steps']} steps. An effect stays out of the model if one axis is "
        "worse beyond chance."
    )
    head = ["effect", "where", "COM", "without [mm]", "with it [mm]", "change of square [mm²]", "in the model"]
    return Table(head, rows, caption, words=3)


def probabilities(result: Mapping[str, Any]) -> list[Part]:
    """What the first comparison says of each explanation, and what is pulled away from nominal."""
    parts: list[Part] = []
    rows = [[spaced(name), f"{p:.1%}"] for name, p in result["probabilities"].items()]
    if rows:
        caption = (
            "Before anything was chosen. The weights behind these figures were learnt from robots whose faults are "
            f"known (config/nominal.yaml says which). Judged as precise: {', '.join(result['precise']) or 'nothing'}."
        )
        parts.append(Table(["explanation", "probability"], rows[:ROWS], caption, words=1))
    rows = [far(row) for row in result["far_from_nominal"]]
    if rows:
        caption = "Beside this, the best explanation needs these further from nominal than nominal robots have them."
        parts.append(Table([*FAR_HEAD], rows[:ROWS], caption, words=2))
    return parts
