# SPDX-License-Identifier: BSD-3-Clause
"""Do the laws of the diagnosis compute effects as the virtual robot has them? What is hidden, and what is found.

    python bench/sizes.py [EFFECT...]      # default: all; some five minutes

COMAN of the data sheet walks test 2 with one effect hidden, which the diagnosis assumes (`--assume`): only its size is
asked for, with joint torques and without them. Found: size and 95 % interval of the fit. Left: evidence [nats] that the
recording of the same robot without the effect has beyond what is left once the effect is fitted, over all laws but that
of feet in the air, for as many samples: what the laws compute otherwise than the robot does, and how else it walks.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from coman_reduced_model.core.base.nominal import load_nominal
from coman_reduced_model.core.config.files import load_config
from coman_reduced_model.core.effects.catalogue import CATALOGUE
from coman_reduced_model.diagnose.data.reading import read_bags
from coman_reduced_model.diagnose.inference.case_cache import CaseCache
from coman_reduced_model.diagnose.inference.check import check_recordings
from coman_reduced_model.diagnose.inference.evidence import parts_of
from coman_reduced_model.diagnose.inference.search import search
from coman_reduced_model.errors import ConfigError
from coman_reduced_model.sim.disturbances import parse
from coman_reduced_model.sim.record import record
from coman_reduced_model.sim.sensors import SensorOptions

HIDDEN = (
    "joint_friction:coulomb=1.0",
    "joint_friction:where=RKneeSag,coulomb=1.5",
    "backlash:width=0.006",
    "backlash:where=RKneeSag,width=0.008",
    "hysteresis:where=RKneeSag,width=0.006,friction=0.5",
    "spring_nonlinearity:where=RKneeSag,cubic=60",
    "joint_stiffness:where=RAnkSag,scale=0.7",
    "joint_stiffness:scale=0.8",
    "joint_damping:scale=2.0",
    "stiffness_drift:where=RKneeSag,change=-0.3,time=5",
    "motor_lag:time_constant=0.02",
    "transport_delay:delay=0.02",
    "motor_compliance:compliance=0.0006",
    "payload:mass=1.5,x=0.03,z=0.1",
    "body_mass:where=RKneeSag,scale=1.4",
    "com_offset:x=0.015",
    "encoder_bias:where=RKneeSag,bias=0.01",
    "encoder_delay:delay=0.015",
    "wrench_delay:delay=0.02",
    "wrench_scale:where=left,scale=1.1",
    "wrench_scale:where=left,scale=1.4",
    "wrench_bias:where=left,fz=20",
    "sensor_rotation:where=left,axis=y,angle=0.1",
    "ground_slope:pitch=0.02,roll=0.01",
    "ground_compliance:vertical=6e-6,rotational=3e-4",
    "external_force:x=6",
    "foot_slip:where=left,distance=0.006",
    "touchdown_impact:impulse=1.0",
)
LACKS = {"with torques": (), "without": ("tau",)}


@dataclass(frozen=True)
class Found:
    """What is found in a recording: sizes in words, and by group of residuals, evidence of a sample and their count."""

    sizes: str
    evidence: Mapping[str, tuple[float, int]]


def found(path: Path, lacks: tuple[str, ...], effect: str, where: str) -> Found:
    """Of a recording without some streams; `effect` at `where` is assumed, if any."""
    config = load_config(None)
    (reading,) = read_bags([path], config, None, None, lambda done, what: None)
    reading = replace(reading, recording=reading.recording.changed(**dict.fromkeys(lacks)))
    assumed = [(effect, where)] if effect else []
    checked = check_recordings([reading], 1, config, assumed, whole=True)
    finding = search(CaseCache(checked.train, [], load_nominal()), assumed)
    assert finding.fit is not None
    deviation, sizes = np.sqrt(np.diag(finding.fit.covariance)), []
    for i in finding.released:
        known, x = finding.known[i], float(finding.fit.x[i])
        low, high = (known.value(x + side * 1.96 * deviation[i]) for side in (-1.0, 1.0))
        sizes.append(f"{known.key} {known.value(x):.3g} [{low:.3g}, {high:.3g}]")
    (case,) = finding.train
    step, evidence = finding.fit.x - case.evidence.at, {}
    for key, part in zip(case.problem.rows, parts_of(case.problem, case.noise), strict=True):
        y, rows = step[part.at], len(case.problem.rows[key])
        nats = 0.5 * (part.energy - 2.0 * y @ part.moment + y @ part.gram @ y)
        evidence[key] = case.problem.usual.trust.get(part.law, 1.0) * float(nats) / rows, rows
    return Found("\n".join(sizes), evidence)


def left(one: Found, clean: Found) -> str:
    """Evidence [nats] that is lost against the robot without an effect, and the law that loses most."""
    lost: dict[str, float] = {}
    for key, (nats, count) in clean.evidence.items():
        law = key.partition("/")[0]
        if key in one.evidence and law != "unloaded":
            lost[law] = lost.get(law, 0.0) + count * (one.evidence[key][0] - nats)
    worst = max(lost, key=lost.__getitem__)
    return f"{sum(lost.values()):.0f} ({worst} {lost[worst]:.0f})"


def main() -> None:
    """Record each, and print a table."""
    wanted = [text for text in HIDDEN if not sys.argv[1:] or text.partition(":")[0] in sys.argv[1:]]
    shown = Table(show_lines=True)
    for title in ("effect", "hidden", *(f"{what}\n{name}" for name in LACKS for what in ("found", "left [nats]"))):
        shown.add_column(title)
    with tempfile.TemporaryDirectory() as folder:
        bags = {text: Path(folder) / str(number) for number, text in enumerate(("", *wanted))}
        for text, bag in bags.items():
            hidden = [parse(text)] if text else []
            record("test2", bag, sensors=SensorOptions(motor_source="measured"), disturbances=hidden, seed=11)
        clean = {name: found(bags[""], lacks, "", "") for name, lacks in LACKS.items()}
        for text in wanted:
            hidden, _, values = text.partition(":")
            where = next((each[6:] for each in values.split(",") if each.startswith("where=")), "")
            row = [hidden, values.replace(",", "\n")]
            for name, lacks in LACKS.items():
                try:
                    one = found(bags[text], lacks, hidden, where if CATALOGUE[hidden].place != "robot" else "")
                    row += [one.sizes, left(one, clean[name])]
                except ConfigError:  # these streams do not show it
                    row += ["-", "-"]
            shown.add_row(*row)
    Console().print(shown)


if __name__ == "__main__":
    main()
