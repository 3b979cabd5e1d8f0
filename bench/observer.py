# SPDX-License-Identifier: BSD-3-Clause
"""Whether the observer's covariances are as large as its errors.

    python bench/observer.py BAG... --worlds SEED...

NEES needs the truth: of worlds, which are recorded for it, and of bags with BAG.truth.npz beside them (coman record).

NIS and NEES are 3 on average if all is as assumed. Errors are correlated in time, so one sample a step enters NEES: the
middle of each single support. Motors and springs take no part in it,
so `prediction.reference` is `none`. Truth is the COM of the links of the URDF at the true joint positions.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from markdown import table
from scipy.stats import chi2

import coman_reduced_model as coman
from coman_reduced_model.core.base.types import Array, Phase, Prediction
from coman_reduced_model.sim.record import load_truth
from coman_reduced_model.sim.virtual_robot import START_NS

SETTLED = 2.0  # [s] that are left out at the beginning
HEAD = [
    "recording", "NIS", "steps", "95 % band of NEES", "NEES position", "NEES velocity", "RMS error of velocity [mm/s]",
    "of that by encoders alone",
]  # fmt: skip


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bags", nargs="+", metavar="BAG")
    parser.add_argument("--config", metavar="FILE")
    parser.add_argument("--worlds", nargs="*", default=[], metavar="SEED", help="worlds to record, 8 s each")
    arguments = parser.parse_args()
    rows = [row(bag, arguments.config) for bag in arguments.bags]
    with tempfile.TemporaryDirectory() as folder:
        for seed in arguments.worlds:
            bag = f"{folder}/world {seed}"
            command = [sys.executable, "-m", "coman_reduced_model.cli.main", "record", "--world", seed]
            subprocess.run([*command, "--duration", "8", "--out", bag], check=True, capture_output=True)
            rows.append(row(bag, arguments.config))
    print(table(HEAD, rows))
    return 0


def row(bag: str, config: str | None) -> list[str]:
    """The figures of one recording."""
    with coman.Session(bag, coman.load_config(config).replaced({"prediction.reference": "none"})) as session:
        all_of_it = list(session.predictions())
        first = all_of_it[0].stamp_ns
        late = [p for p in all_of_it if (p.stamp_ns - first) * 1e-9 > SETTLED and np.isfinite(p.estimate.com[0])]
        cells = [Path(bag).name, f"{np.nanmean([p.estimate.nis for p in late]):.1f}"]
        truth_file = Path(f"{bag}.truth.npz")
        if not truth_file.exists():
            return cells + [""] * (len(HEAD) - len(cells))
        truth, posture = load_truth(truth_file), session.robot.posture()

        def true_motion(p: Prediction) -> tuple[Array, Array]:
            t = (p.stamp_ns - START_NS) * 1e-9
            q, qd = ([np.interp(t, truth["t"], column) for column in truth[name].T] for name in ("q", "qd"))
            posture.update(np.array(q), np.array(qd))
            return posture.com_in_sole(p.support.support_foot)

        chosen = middles(late)
        motions = [true_motion(p) for p in chosen]
        true = np.array(motions)
        off = np.array([[p.estimate.com, p.estimate.com_vel] for p in chosen]) - true
        plain = np.array([p.measured_com_vel for p in chosen]) - true[:, 1]
        parts = [p.estimate.covariance for p in chosen]
        nees = [
            np.mean([e @ np.linalg.solve(P[s, s], e) for e, P in zip(off[:, k], parts, strict=True)])
            for k, s in enumerate((slice(0, 3), slice(3, 6)))
        ]
    n = len(chosen)
    low, high = chi2.ppf([0.025, 0.975], 3 * n) / n
    rms = [", ".join(f"{1e3 * each:.0f}" for each in np.sqrt(np.mean(e**2, axis=0))) for e in (off[:, 1], plain)]
    return [*cells, str(n), f"{low:.1f} to {high:.1f}", *(f"{each:.1f}" for each in nees), *rms]


def middles(predictions: list[Prediction]) -> list[Prediction]:
    """The middle sample of each single support."""
    phases = np.array([p.support.phase for p in predictions])
    cuts = np.flatnonzero(np.diff(phases)) + 1
    pieces = np.split(np.arange(len(phases)), cuts)
    single = [piece for piece in pieces if phases[piece[0]] in (Phase.LEFT, Phase.RIGHT)]
    return [predictions[piece[len(piece) // 2]] for piece in single]


if __name__ == "__main__":
    sys.exit(main())
