# SPDX-License-Identifier: BSD-3-Clause
"""An oracle that knows how much clean robots of a world vary, but not which effect is hidden.

    python -m coman_reduced_model.judge.rank FOLDER        # of a case, with its world.yaml

All candidates of the diagnosis are ranked by their evidence on all bags at once, linear about the nominal robot, with
the true standard deviations of what varies on clean robots of this world instead of the diagnosis' own. Nothing is
decided. It is what a diagnosis could reach at most with these residuals; printed as JSON, best first:

    [{"name", "where", "evidence": nats, "parameters": {key: {"value", "deviation", "logarithmic"}}}, ...]
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..core.config.files import load_config
from ..core.effects.unknown import Unknown
from ..diagnose.data.reading import read_bags
from ..diagnose.inference.case import evidence_of, examine
from ..diagnose.inference.check import check_recordings
from ..diagnose.inference.effects import with_structure
from ..diagnose.inference.evidence import Evidence, scores
from ..diagnose.physics.hypotheses import candidates, unknowns
from ..errors import ComanError
from ..output import to_json
from ..sim.worlds import World, read_world
from .variability import true_deviations

BAGS = ("train", "hold1", "hold2")


def evidence_with(folder: Path, deviations: Mapping[str, float]) -> Evidence:
    """Evidence of all bags of a case, with given standard deviations of clean robots.

    Args:
        folder: holds the bags and robot.yaml.
        deviations: by the name of a width (`joint_stiffness.scale.spread`, config/nominal.yaml).

    Raises:
        ComanError: the bags cannot be used.
    """
    config = with_structure(load_config(folder / "robot.yaml"))
    bags = [folder / bag for bag in BAGS if (folder / bag).is_dir()]
    readings = read_bags(bags, config, None, None, lambda done, what: None)
    checked = check_recordings(readings, 1, config, [])
    recordings = [*checked.train, *checked.select, *checked.confirm]
    known = [with_deviation(each, deviations) for each in unknowns(recordings[0][0], recordings[0][1])]
    nominal = np.zeros(len(known))
    return evidence_of([examine(prepared, known, nominal) for prepared in recordings])


def with_deviation(unknown: Unknown, deviations: Mapping[str, float]) -> Unknown:
    """An unknown whose spread over clean robots is as given; as on most robots, if nothing is given."""
    name, unknown = unknown.widths.get("spread", ""), replace(unknown, precise=None)
    return replace(unknown, spread=deviations[name] * unknown.relative) if name in deviations else unknown


def ranking(evidence: Evidence) -> list[dict[str, Any]]:
    """All candidates, best first."""
    known, out = evidence.unknowns, []
    for score in scores(evidence, candidates(known)):
        indices = list(score.option.unknowns)
        spread = np.sqrt(np.diag(evidence.fit(indices).covariance)[indices])
        parameters = {
            known[i].key: {
                "value": float(value),
                "deviation": float(deviation),
                "logarithmic": known[i].logarithmic,
            }
            for i, value, deviation in zip(indices, score.values, spread, strict=True)
        }
        row = {"name": score.option.effect, "where": score.option.place, "evidence": score.gain}
        out.append({**row, "parameters": parameters})
    return out


def main(arguments: Sequence[str]) -> int:
    """Print the ranking of a case as JSON."""
    folder = Path(arguments[0])
    try:
        world: World = read_world(folder / "world.yaml")
        print(to_json(ranking(evidence_with(folder, true_deviations(world)))))
    except ComanError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
