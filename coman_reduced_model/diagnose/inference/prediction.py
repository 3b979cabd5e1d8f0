# SPDX-License-Identifier: BSD-3-Clause
"""Step 4, predict: the COM with and without the effects, which decides what goes into the model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from ...core.config.schema import Config
from .check import Checked
from .effects import effect_entries, with_effects
from .finding import Finding
from .predicted_com import Errors, FreeRun, FreeRuns, admitted, change, errors


@dataclass(frozen=True)
class Predicted:
    """The COM that the models predict.

    Attributes:
        effects: what was found, as diagnosis.json lists it, with its change of the predicted COM as `com`.
        model: the configuration with the effects that do not make the predicted COM worse.
        train, hold: errors of the nominal and of this model, by bag.
        shown: errors in the last judging bag of the nominal model, and of the model with all effects.
    """

    effects: list[dict[str, Any]]
    model: Config
    train: list[Errors]
    hold: list[Errors]
    shown: Errors


def predict_com(finding: Finding, checked: Checked, config: Config, free_runs: FreeRuns) -> Predicted:
    """Predict all bags with the nominal model and with the effects; leave out effects that make it worse."""
    effects = effect_entries(finding, config)
    every = with_effects(config, effects)
    free_runs.start(checked.train_paths, every)  # in the helper process, while the judging bags are predicted here
    judging = checked.judging_paths
    _leave_out_what_worsens(
        effects,
        lambda some: free_runs.of(judging, with_effects(config, some)),
        "held-out" if checked.hold_paths else "training",
    )
    model = with_effects(config, effects)
    pairs = zip(free_runs.of(checked.paths, config), free_runs.of(checked.paths, model), strict=True)
    com = [errors(nominal, changed) for nominal, changed in pairs]
    shown = errors(free_runs.of(judging, config)[-1], free_runs.of(judging, every)[-1])
    n = len(checked.train_paths)
    return Predicted(effects, model, com[:n], com[n:], shown)


def _leave_out_what_worsens(
    effects: Sequence[dict[str, Any]], judge: Callable[[Sequence[dict[str, Any]]], list[FreeRun]], which: str
) -> None:
    """Take effects out of the model that make the predicted COM worse; each gets its change of it as `com`.

    Args:
        effects: changed in place.
        judge: free runs of the model with some effects, over the bags that judge them.
        which: name of these bags in a sentence.
    """
    inside = [effect for effect in effects if effect["in_model"]]
    kept, changes = admitted(len(inside), lambda some: judge([inside[i] for i in some]))
    for i, effect in enumerate(inside):
        effect["com"] = changes[i].plain()
        if i not in kept:
            effect["in_model"] = False
            effect["left_out"] = f"it makes the predicted COM of {which} walks worse, {changes[i]}"
    for effect in effects:
        if "com" not in effect:  # the model has it anyway
            runs = judge([inside[i] for i in kept])
            effect["com"] = change([errors(run, run) for run in runs]).plain()
