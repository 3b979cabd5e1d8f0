# SPDX-License-Identifier: BSD-3-Clause
"""Whether the observer's covariances are as large as its errors.

    python bench/observer.py BAG... --worlds SEED...

NEES needs the truth: of worlds, which are recorded for it, 8 s each, of bags with BAG.truth.npz beside them (coman
record), and of the shipped walks, in the data of the tests. Truth is the COM of all that the robot carries, in the
frame of the true sole.

NIS and NEES are 3 on average if all is as assumed. Errors are correlated in time, so one sample a step enters NEES, and
the NIS of steps, whose mean has the same band: the middle of each single support. The error of the position is made by
what is constant in a walk, zeros of encoders and masses of links: a walk counts once for it, however many steps it has,
and its band is that of a single draw. Motors and springs take no part in the estimate, so `prediction.reference` is
`none`. Walks in which the robot falls are left out. The external force counts from the first quarter of a walk on, each
walk once.

Velocity against the ground: as above, but of the COM in the world, in the axes of the sole, however that tilts.

The rotation of the trunk: errors to gravity, RMS over the samples from 2 s on, in thousandths. With the IMU, and the
same samples without it; `encoders alone` takes the sole as flat, and velocities as the joints have them; `IMU alone` is
its orientation. Its error is mostly constant, by zeros of encoders and how the IMU is mounted, so that a walk counts
once for the NEES of roll and pitch. Yaw is that against the support sole.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from bands import bands, counted
from markdown import table
from rotation import Turning, against_ground, rows, turned
from scipy.stats import chi2
from truth import truth_of

import coman_reduced_model as coman
from coman_reduced_model.core.base.nominal import load_nominal
from coman_reduced_model.core.base.types import Array
from coman_reduced_model.core.evaluation.consistency import LEVELS, Consistency, reliability, within
from coman_reduced_model.core.evaluation.statistics import NINETY
from coman_reduced_model.judge.by_kind import new_kinds
from coman_reduced_model.sim.worlds.draw import world_of
from coman_reduced_model.sim.worlds.run import can_walk

HEAD = [
    "recording", "kinds", "NIS", "steps", "NIS of steps", "NEES position", "NEES velocity",
    "95 % band of a mean of steps", "RMS error of velocity [mm/s]", "of that by encoders alone",
]  # fmt: skip
DURATION = 8.0  # [s] of a walk
SHOWN = ("engine", "contact", "floor", "controller", "body", "gait", "sensors", "imperfections")
NEW = (
    "Of worlds with a kind that config/nominal.yaml was not learnt on; what else the estimate counts was chosen on "
    "worlds of all kinds:"
)


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bags", nargs="*", metavar="BAG")
    parser.add_argument("--config", metavar="FILE")
    parser.add_argument("--worlds", nargs="*", default=[], metavar="SEED")
    arguments = parser.parse_args()
    of_bags = {Path(bag).name: judged(bag, arguments.config) for bag in arguments.bags}
    lines = [row(name, each) for name, each in of_bags.items()]
    turns = {Path(bag).name: turned(bag, truth_of(bag), arguments.config) for bag in arguments.bags}
    walks: dict[str, Consistency] = {}
    forces: list[Array] = []  # of the worlds, in which nothing pushes
    with tempfile.TemporaryDirectory() as folder:
        for seed in arguments.worlds:
            bag = f"{folder}/{seed}"
            world = replace(world_of(seed), duration_s=DURATION)
            if not can_walk(world, bag, world.seed, store=False):
                lines.append([f"world {seed}", kinds(seed), *["fell"] * (len(HEAD) - 2)])
                continue
            walks[seed] = judged(bag, arguments.config, forces)
            lines.append(row(f"world {seed}", walks[seed], kinds(seed)))
            turns[f"world {seed}"] = turned(bag, truth_of(bag), arguments.config)
    print(table(HEAD, lines))
    if walks:
        print(f"\n{pooled(list(walks.values()))}")
        shares = np.mean([np.mean(np.abs(each) < NINETY, axis=0) for each in forces], axis=0)
        words = ", ".join(f"{100 * each:.0f}" for each in shares)
        print(f"\n{worse_than_encoders(walks)}")
        print(f"\nExternal force, of which there is none: within its 90 % interval, x, y, z: {words} %.")
    if new := [walk for seed, walk in walks.items() if new_kinds({"worlds": world_of(seed).kinds}, load_nominal())]:
        print(f"\n{NEW}", *in_bands(new), sep="\n")
    print(f"\n{against_ground(of_bags | {f'world {seed}': walk for seed, walk in walks.items()})}")
    known: dict[str, Turning] = {name: each for name, each in turns.items() if each is not None}
    print(f"\n{rows(known)}" if known else "")
    return 0


def judged(bag: str, config: str | None, forces: list[Array] | None = None) -> Consistency:
    """A recording, predicted and judged; to `forces`, the external force over its standard deviation (n, 3)."""
    found = Consistency(truth_of(bag))
    settings = coman.load_config(config).replaced({"prediction.reference": "none", "prediction.horizons": []})
    with coman.Session(bag, settings) as session:
        predictions = list(session.predictions())
    for prediction in predictions:
        found.add(prediction)
    if forces is not None:
        estimates = [p.estimate for p in predictions[len(predictions) // 4 :] if np.isfinite(p.estimate.force[0])]
        forces.append(np.array([each.force / np.sqrt(np.diag(each.force_covariance)) for each in estimates]))
    return found


def kinds(seed: str) -> str:
    """What is not as in the plain world."""
    drawn = world_of(seed).kinds
    usual = ("mujoco", "firm", "level", "open_loop", "legs", "usual", "tolerances")
    return ", ".join(drawn[axis] for axis in SHOWN if drawn[axis] not in usual)


def row(name: str, found: Consistency, kinds: str = "") -> list[str]:
    """The figures of one recording."""
    summary = found.summary()
    nis = found.nis
    n = len(nis)
    cells = [name, kinds, f"{summary['nis']:.1f}", str(n)]
    if not n:
        return cells + [""] * (len(HEAD) - len(cells))
    low, high = bands(np.array([n]))
    cells.append(f"{nis.mean():.1f}")
    band = f"{low[0]:.1f} to {high[0]:.1f}"
    if "steps" not in summary:
        return [*cells, "", "", band, "", ""]
    rms = [
        ", ".join(f"{1e3 * each:.0f}" for each in np.sqrt((e**2).mean(axis=0))) for e in found.errors.transpose(1, 0, 2)
    ]
    nees = [f"{summary[f'nees_{part}']:.1f}" for part in ("position", "velocity")]
    return [*cells, *nees, band, *rms]


def pooled(walks: list[Consistency]) -> str:
    """What all worlds show together."""
    n = len(walks)
    position = np.array([walk.nees[:, 0].mean() for walk in walks])
    steps = sum(len(walk.nees) for walk in walks)
    single, together = chi2.ppf([0.025, 0.975], 3), chi2.ppf([0.025, 0.975], 3 * n) / n
    inside_one = int(((position >= single[0]) & (position <= single[1])).sum())
    off: Array = np.concatenate([walk.off for walk in walks])
    inside = within(off)
    lines = [
        f"{n} worlds, {steps} steps.",
        f"NEES of position, a walk counting once: {position.mean():.1f} on average (95 % band {together[0]:.1f} to "
        f"{together[1]:.1f}); {inside_one} of {n} within the band of one walk, {single[0]:.1f} to "
        f"{single[1]:.1f}.",
        *in_bands(walks),
        "Within their 90 % interval, all worlds together, x, y, z: position "
        + ", ".join(f"{100 * each:.0f}" for each in inside[0])
        + " %, velocity "
        + ", ".join(f"{100 * each:.0f}" for each in inside[1])
        + " %.",
    ]
    head = ["interval that should hold [%]", *(f"{100 * level:.0f}" for level in LEVELS)]
    shares = [
        [f"{name} within it [%]", *(f"{100 * each:.0f}" for each in reliability(off[:, k]))]
        for k, name in enumerate(("position", "velocity"))
    ]
    return "\n".join(lines) + f"\n\n{table(head, shares)}"


def worse_than_encoders(walks: dict[str, Consistency]) -> str:
    """Worlds in which the velocity of the estimate is worse than that by encoders alone, and whether flags say so."""
    rms = {seed: np.sqrt((walk.errors**2).mean(axis=0)) for seed, walk in walks.items()}
    found = [
        f"{seed} ({', '.join(axis for axis, worse in zip('xyz', estimate > encoders, strict=True) if worse)}; "
        f"INCONSISTENT {100 * walks[seed].summary()['inconsistent']:.0f} %)"
        for seed, (estimate, encoders) in rms.items()
        if (estimate > encoders).any()
    ]
    return f"Velocity worse than by encoders alone, by axis and samples that are flagged: {', '.join(found) or 'none'}."


def in_bands(walks: list[Consistency]) -> list[str]:
    """How many walks are consistent, each in the band of as many steps as it has."""
    walks = [walk for walk in walks if len(walk.nis)]  # with a single support
    lines = []
    for name, values in (
        ("NIS", [walk.nis for walk in walks]),
        ("NEES of velocity", [walk.nees[:, 1] for walk in walks]),
    ):
        median, inside, below, above = counted(values)
        lines.append(
            f"{name}: median {median:.1f}; {inside} of {len(walks)} walks in the band, {below} below (too cautious), "
            f"{above} above (too sure)."
        )
    return lines


if __name__ == "__main__":
    sys.exit(main())
