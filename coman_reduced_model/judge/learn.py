# SPDX-License-Identifier: BSD-3-Clause
"""Learns config/nominal.yaml from cases whose answers are known: run again whenever the model or its laws change.

    coman judge --seeds 0:120 --out RUN --no-oracle         # or only the bags of a run
    python -m coman_reduced_model.judge.learn RUN... --out config/nominal.yaml --jobs 2

1. How much nominal robots vary, from the clean cases, how far laws are trusted, and what they leave that repeats with
   each stride (learn_variability.py): from each half of the cases; what ships is the mean. --keep-widths: as in the
   file that ships.
2. The first comparison of explanations of every case, and what the laws leave on clean ones; with widths of one half of
   the cases for the other half, as robots of users are not among those that widths were learnt from.
3. The weights by which an effect is named, the alarm (weights.py), and the factors on intervals.
4. Both again with a baseline of each robot, for cases with nominal recordings (`coman judge --baseline`).

Kinds of worlds are left out one by one: the shares that are printed, and written beside the file as
NAME.left_out.json, are of kinds that the weights did not see.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import pickle
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.stats import t as student

from ..core.base.nominal import Nominal, load_nominal
from ..core.config.files import load_config
from ..diagnose.baseline import baseline
from ..diagnose.inference.case_cache import CaseCache
from ..diagnose.inference.check import Checked
from ..diagnose.inference.compare import compare
from ..diagnose.inference.decide import ALL
from ..diagnose.inference.effects import CONFIDENCE
from ..diagnose.inference.explanation import by_law
from ..diagnose.inference.finding import Finding
from ..diagnose.inference.search import possible, rivals_of
from ..diagnose.physics.hypotheses import candidates
from ..errors import ComanError
from ..output import to_json, write_file
from ..processes import workers
from .by_kind import kinds_of
from .families import of_this_catalogue
from .hidden import as_fitted, in_all
from .learn_variability import checked_case, learn_variability
from .score import rate
from .seeds import commit
from .weights import SHOWN, Example, by_left_out, learn_decision

LEAST_SCATTER = 0.15  # of the logarithm of what a law leaves
FOLDS = 2
COMPARISON = 10  # grows where comparisons that are kept in files would come out otherwise
SHARED = 2  # errors of an effect that those of all others are worth
TENTHS = 10
TINY = 1e-12  # of a width


def first_comparison(bags: Path, stored: Path, nominal: Nominal) -> list[dict[str, Any]] | None:
    """The explanations that a diagnosis of a case compares first, as plain values; kept in a file."""
    if not stored.is_file():
        try:
            write_file(stored, json.dumps(_first_comparison(checked_case(bags, nominal), nominal)))
        except ComanError:
            return None
    found: list[dict[str, Any]] = json.loads(stored.read_text(encoding="utf-8"))
    return found


def with_baseline(
    bags: Path, healthy: Path, stored: Path, nominal: Nominal
) -> tuple[Nominal, list[dict[str, Any]]] | None:
    """A robot's baseline by its recordings without a hidden effect, and `first_comparison` with it; kept in a file."""
    if not stored.is_file():
        try:
            config = load_config(bags / "robot.yaml")
            own = baseline(sorted(healthy.iterdir()), config, population=nominal).nominal
            write_file(stored, pickle.dumps((own, _first_comparison(checked_case(bags, own), own))))
        except ComanError:
            return None
    found: tuple[Nominal, list[dict[str, Any]]] = pickle.loads(stored.read_bytes())
    return found


def _first_comparison(checked: Checked, nominal: Nominal) -> list[dict[str, Any]]:
    cache = CaseCache(checked.train, checked.select, nominal)
    nothing = np.zeros(len(cache.known))
    finding = Finding(cache.known, nothing, nominal=nominal)
    finding.train, finding.hold = cache.at(nothing, "train"), cache.at(nothing, "hold")
    rivals = rivals_of(finding, candidates(cache.known))
    rows = []
    for each in compare(finding, cache, rivals):
        if each.option and not possible(cache.known, each):  # as a diagnosis has it
            continue
        deviation, option, parameters = np.sqrt(np.diag(each.fit.covariance)), each.option, {}
        for i in option.unknowns if option else ():
            known = cache.known[i]
            parameters[known.key] = [known.nominal, known.usual + each.fit.x[i], deviation[i], known.logarithmic]
        rows.append({
            "name": option.effect if option else "", "where": option.place if option else "", "gain": each.gain,
            "confirmed": each.confirmed, "ways": each.ways, "leftover": by_law(each.leftover),
            "pulled": dict(each.pulled), "together": each.together, "parameters": parameters,
        })  # fmt: skip
    return rows


def learn_leftover(examples: Sequence[Example]) -> dict[str, tuple[float, float]]:
    """By law: median, and standard deviation of the logarithm, of what it leaves on clean robots [noise floors]."""
    values: dict[str, list[float]] = {}
    for example in examples:
        if example.answer["kind"] == "clean":
            for law, value in example.rows[0]["leftover"].items():
                values.setdefault(law, []).append(float(np.log(max(value, 1e-3))))
    out = {}
    for law, each in values.items():
        low, median, high = np.quantile(each, [0.16, 0.5, 0.84])
        out[law] = float(np.exp(median)), max(float(high - median), float(median - low), LEAST_SCATTER)
    return out


def parameter_errors(examples: Sequence[Example]) -> dict[str, list[float]]:
    """By effect, errors of the parameters of those that are hidden, where they are compared [standard deviations].

    An effect that was compared in several ways (joint states late with or without torques) counts in its best one.
    """
    errors: dict[str, list[float]] = {}
    for example in examples:
        for effect in in_all(example.answer) if example.answer["kind"] in ("single", "pair") else ():
            place = effect["name"], effect["where"] or ""
            ways = [row for row in example.rows[1:] if (row["name"], row["where"]) == place]
            for row in sorted(ways, key=lambda way: -way["gain"])[:1]:
                for key, (nominal, x, deviation, logarithmic) in row["parameters"].items():
                    truth = as_fitted(effect).get(key)
                    if isinstance(truth, float) and (not logarithmic or truth > 0.0):
                        true = np.log(truth / nominal) if logarithmic else truth - nominal
                        errors.setdefault(effect["name"], []).append(abs(x - true) / deviation)
    return errors


def interval_factors(examples: Sequence[Example]) -> dict[str, float]:
    """By effect, by which intervals of true effects must be longer to hold 95 % of the true values; `all` together.

    Errors of an effect are taken for normal about zero, with a variance that is the middle effect's as long as few are
    known, as if SHARED of them were: the interval is Student's.
    """
    errors = parameter_errors(examples)
    if not errors:
        return {"all": 1.0}
    usual = float(np.median([np.mean(np.square(each)) for each in errors.values()]))
    out = {"all": float(np.quantile(np.concatenate(list(errors.values())), 0.95)) / CONFIDENCE}
    for name, each in sorted(errors.items()):
        count = len(each) + SHARED
        variance = (np.sum(np.square(each)) + SHARED * usual) / count
        out[name] = float(student.ppf(0.975, count) * np.sqrt(variance)) / CONFIDENCE
    return {name: max(value, 1.0) for name, value in out.items()}


def coverage(examples: Sequence[Example]) -> dict[str, Any]:
    """Share of true values within intervals whose factors were learnt from nine tenths of the cases, without theirs."""
    inside: list[bool] = []
    tenth = [int(np.random.default_rng([43, int(each.answer["seed"])]).integers(TENTHS)) for each in examples]
    for k in range(TENTHS):
        factors = interval_factors([each for each, i in zip(examples, tenth, strict=True) if i != k])
        for name, errors in parameter_errors([e for e, i in zip(examples, tenth, strict=True) if i == k]).items():
            inside += [bool(error < CONFIDENCE * factors.get(name, factors["all"])) for error in errors]
    return rate(sum(inside), len(inside))


def cases_of(run: Path) -> dict[str, dict[str, Any]]:
    """Answers of a run by case."""
    sealed = run.with_name(f"{run.name}.sealed")
    return {
        path.stem: of_this_catalogue(json.loads(path.read_text(encoding="utf-8")))
        for path in sorted(sealed.glob("*.json"))
        if path.stem != "seeds" and (run / "bags" / path.stem).is_dir()
    }


def learn(
    runs: Sequence[Path], nominal: Nominal, jobs: int, keep_widths: bool = False
) -> tuple[Nominal, list[Example], list[Example]]:
    """A new record of nominal variability, the examples that it was learnt from, and those with baselines."""
    cases = [(run, name, answer) for run in runs for name, answer in cases_of(run).items()]
    folds = [fold_of(answer) for *_, answer in cases]
    for run in runs:
        (run / "learn").mkdir(exist_ok=True)
    with workers(jobs) as pool:
        others = [nominal] * FOLDS
        if not keep_widths:
            begun = _made_with(nominal)
            clean = [
                (fold, (run / "bags" / name, run / "learn" / f"{name}.{begun}.laws.pkl"))
                for fold, (run, name, answer) in zip(folds, cases, strict=True)
                if answer["kind"] == "clean"
            ]
            others = [learn_variability([e for f, e in clean if f != fold], nominal, pool) for fold in range(FOLDS)]
            nominal = mean_of(others)
        places = [
            (run / "bags" / name, run / "learn" / f"{name}.{_made_with(others[fold])}.json", others[fold])
            for fold, (run, name, _) in zip(folds, cases, strict=True)
        ]
        found = list(pool.map(first_comparison, *zip(*places, strict=True)))
        compared = [
            (fold, Example(answer, nominal, rows))
            for fold, (_, _, answer), rows in zip(folds, cases, found, strict=True)
            if rows
        ]
        nominal, others, examples = with_leftover(nominal, others, compared)
        made = [_made_with(other, other.leftover) for other in others]
        known = [
            (
                answer,
                (run / "bags" / name, run / "healthy" / name, run / "learn" / f"{name}.{made[fold]}.pkl", others[fold]),
            )
            for fold, (run, name, answer) in zip(folds, cases, strict=True)
            if (run / "healthy" / name).is_dir()
        ]
        own = list(pool.map(with_baseline, *zip(*(task for _, task in known), strict=True))) if known else []
    baselines = [Example(answer, *each) for (answer, _), each in zip(known, own, strict=True) if each]
    seeds = sorted(int(example.answer["seed"]) for example in examples)
    source = {**nominal.source, "commit": commit(), "cases": len(examples), "seeds": [seeds[0], seeds[-1]]}
    source["kinds"] = kinds_of(
        [example.answer for example in examples],
        nominal.source.get("kinds") if keep_widths or not baselines else None,  # with what is kept of the earlier file
    )
    nominal = replace(nominal, source=source, **_decisions(examples))
    if baselines:
        own_seeds = sorted(int(example.answer["seed"]) for example in baselines)
        source["with_baseline"] = {
            "commit": commit(), "cases": len(baselines), "seeds": [own_seeds[0], own_seeds[-1]],
        }  # fmt: skip
        nominal = replace(nominal, source=source, with_baseline=_decisions(baselines))
    return nominal, examples, baselines


def mean_of(records: Sequence[Nominal]) -> Nominal:
    """The geometric mean of all that `learn_variability` learns, but for what is usual."""

    def mean(name: str) -> dict[str, float]:
        each = [getattr(record, name) for record in records]
        shared = [key for key in each[0] if all(key in one for one in each)]
        return {key: _mean([one[key] for one in each], key.endswith(".usual")) for key in shared}

    widths = [record.source["widths"] for record in records]
    precise = {part: sum(one["precise"][part] for one in widths) for part in widths[0]["precise"]}
    counts = {**widths[0], "robots": sum(one["robots"] for one in widths), "precise": precise}
    return replace(
        records[0], source={**records[0].source, "widths": counts}, widths=mean("widths"), precise=mean("precise"),
        trust=mean("trust"), repeats=mean("repeats"),
    )  # fmt: skip


def _mean(values: Sequence[float], plain: bool) -> float:
    """The arithmetic or the geometric one."""
    return float(np.mean(values) if plain else np.exp(np.mean(np.log(np.maximum(values, TINY)))))


def fold_of(answer: Mapping[str, Any]) -> int:
    """Of a case, by its seed."""
    return int(np.random.default_rng([37, int(answer["seed"])]).integers(FOLDS))


def with_leftover(
    nominal: Nominal, others: Sequence[Nominal], compared: Sequence[tuple[int, Example]]
) -> tuple[Nominal, list[Nominal], list[Example]]:
    """The records with what the laws leave, and the examples; each fold with what they leave on the others."""
    nominal = replace(nominal, leftover=learn_leftover([example for _, example in compared]))
    left = [learn_leftover([each for f, each in compared if f != fold]) for fold in range(len(others))]
    of_folds = [replace(other, leftover=each or nominal.leftover) for other, each in zip(others, left, strict=True)]
    return nominal, of_folds, [replace(example, nominal=of_folds[fold]) for fold, example in compared]


def _made_with(nominal: Nominal, *more: Mapping[str, Any]) -> str:
    """Part of the names of files that depend on these figures, and on what is kept of a comparison."""
    of_robots = nominal.widths, nominal.most, nominal.precise
    figures = *of_robots, nominal.limits, nominal.floor, nominal.sensors, nominal.trust, nominal.repeats, *more
    text = json.dumps([COMPARISON, ALL, *(dict(sorted(each.items())) for each in figures)])
    return hashlib.sha256(text.encode()).hexdigest()[:8]


def _decisions(examples: Sequence[Example]) -> dict[str, Any]:
    """What is learnt from examples: weights with their alarms, and the factors on intervals."""
    return {"decision": learn_decision(examples), "interval_factor": interval_factors(examples)}


def main() -> None:
    """See the top of this file."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--keep-widths", action="store_true", help="learn only the weights, and what the laws leave")
    asked = parser.parse_args()
    runs = [run.absolute() for run in asked.runs]
    nominal, *several = learn(runs, load_nominal(), asked.jobs, asked.keep_widths)
    write_file(asked.out, header() + yaml.safe_dump(nominal.plain(), sort_keys=False, width=120))
    names = ("population", "with_baseline")
    kinds = {name: by_left_out(examples) for name, examples in zip(names, several, strict=True)}
    beside = asked.out.with_suffix(".left_out.json")
    write_file(beside, to_json({"source": nominal.source, "intervals": coverage(several[0]), **kinds}))
    for name, by_axis in kinds.items():
        for axis, found in by_axis.items():
            shares = (f"{key} {found[''][key]['hits']} of {found[''][key]['of']}" for key in SHOWN)
            print(f"{name}: kinds of {axis} left out: {', '.join(shares)}")
    print(f"by kind: {beside}")


def header() -> str:
    """Comment at the top of a file of nominal variability."""
    return """# SPDX-License-Identifier: BSD-3-Clause
#
# What nominal robots are like. Written by judge/learn.py; `coman baseline` writes such a file for a robot of your own.
#
# source: where the figures come from. kinds: by axis, the kinds of worlds that they were learnt on, but for monitor.
# widths: standard deviations over nominal robots (spread) and where an effect is (reach) of the parameters that
#     core/effects and diagnose/physics/hypotheses.py name; usual: what nominal robots have of it. sheets: the same by
#     data sheets and what is common, where learning begins. most: what they allow at most. In weights: pulls and
#     what sinks; in weights times half the length of a foot: friction, zeros of torques, what turns or yields; in
#     masses of the robot: loads, blows; in masses times lengths of a leg: where loads are; in lengths of a leg: where
#     the trunk's COM is. All else in SI.
# precise: by the same names, widths of robots on which all of a part, the foot sensors or all else, is precise.
# trust: by law, the share of its information that counts: with which recordings of the same robot agree best.
# limits: chosen by hand, not learnt.
#     experiment: standard deviation of a parameter by an experiment that measures it [of its reach]: 1 mrad by a gauge,
#     1.5 ms by a tap, 0.3 % of the weight by a scale.
#     blow_seen: share of a blow at landing that the forces show beside the load that comes.
#     blow_apart [m/s], slide_apart [m], share_apart [of the usual]: by which a landing is unlike most.
#     scuff: force from which a foot in the air touches the ground [weights].
#     torque_sure: torque whose sign is sure [weights times m].
#     sole_turned: tilt by the IMU with which a sole is not flat [rad].
#     sole_edge: how far out a foot bears that may turn [half a sole].
#     play_seen: what smoothed encoders surely show [rad].
#     walk_to_walk: by which a value differs between walks [of it].
#     imu_off: tilt by the IMU that is another frame [rad].
#     Of the monitor. load_rises: mean force of a load that only rises while a foot lands [of the load after it].
#     torque_rate: of the needed torque at which a delay counts half [weights times COM height / s].
#     deflection [rad], deflection_rate [rad/s]: beyond which noise of `stiffness` grows, by errors of gains and clocks.
# floor: by law, what the best of sensors leaves of its residuals [rad, Nm, N, m, Ns]. A simulator whose sensors have no
#     noise at all must not make every hair's breadth an effect.
# sensors: the least noise that any sensor is taken to have: force in weights, moment in weights times the length of a
#     foot, count of an encoder [rad], tilt of a direction [1], com of the measured COM [m].
# repeats: by law, what it leaves that repeats with each stride, in the median. In weights for N, weights times m for
#     Nm, mass times m/s for Ns, else SI.
# leftover: by law, what it leaves [noise floors]: median, and standard deviation of the logarithm. `apart`: how many
#     times what the middle one of its joints leaves the worst one does.
# decision: weights by which an effect is named, with recordings that help to choose and alone; alarm: probability that
#     nothing is missing, up to which one in a hundred of these robots gets; together: how far all that varies is pulled
#     on nearly all of them [deviations of chi squared]. with_baseline: the same where the robot's own baseline
#     is known.
# interval_factor: by effect, by which 95 % intervals of the fit are longer, and of all together.
# monitor: by law (of one robot also by channel), by judge/learn_monitor.py: unit; single, double: noise, the usual
#     standard deviation of a phase mean from phase to phase in that support; by_robot, by_channel: how much the
#     logarithm of that noise varies from robot to robot, and between channels of a law of one robot; drift of a level
#     from one phase of a kind to the next, as a share of the noise; robots: standard deviation of the value over
#     nominal robots (0: not known); by_load: the same as a share of the deflection of a spring, by data sheets; usual:
#     value of this robot at the deflection usual_load [rad], usual_slope: over the deflection. In weights for N, weight
#     times COM height for Nm, mass times m/s for Ns.
"""


if __name__ == "__main__":
    main()
