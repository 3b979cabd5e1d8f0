# SPDX-License-Identifier: BSD-3-Clause
"""Predictions ahead of a robot without reference: the filtered pendulum against persistence and the plain pendulum.

    python bench/pendulum.py [BAG CONFIG]         # default: the shipped test1, as if it had no motor encoders

The constants of the filter were chosen on the first half of a recorded iCub walk; both are judged apart. What is
published is the blend of the filter and simpler predictions.
"""

from __future__ import annotations

import sys

from rich.console import Console
from rich.table import Table

from coman_reduced_model.core.config.files import load_config
from coman_reduced_model.core.predictor import Predictor
from coman_reduced_model.resources import bag_path, config_path
from coman_reduced_model.tuning.recording import read_recording


def main() -> None:
    bag, settings = sys.argv[1:3] if len(sys.argv) > 2 else (bag_path("test1"), config_path("coman"))
    config = load_config(settings).replaced({"prediction.reference": "none"})
    recording = read_recording(bag, config)
    samples = list(recording.copies())
    half = len(samples) // 2
    head = ("half", "ahead [s]", "axis", "filter [mm]", "published", "persistence", "pendulum", "skill of published")
    table = Table(*head, title=str(bag))
    for name, part in (("first", samples[:half]), ("second", samples[half:])):
        predictor = Predictor(recording.robot, config)
        for sample in part:
            predictor.update(sample)
        rmse, skill = predictor.judge.rmse(), predictor.judge.skill()
        for h, errors in rmse.items():
            for axis, word in enumerate(("fore-aft", "lateral")):
                figures = (f"{errors[who][axis] * 1e3:.2f}" for who in ("model", "published", "persistence", "lipm"))
                table.add_row(name, h, word, *figures, f"{skill[h][axis]:+.2f}")
    Console(width=120).print(table)


if __name__ == "__main__":
    main()
