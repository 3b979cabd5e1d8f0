# SPDX-License-Identifier: BSD-3-Clause
"""One run of the judge: bags, verdicts, baselines, oracles, and only then the answers.

    OUT/commit.txt      the commit that the run was begun at: figures of different versions are not pooled
    OUT/time.txt        how long it took, each time that it went on
    OUT/options.yaml    the options that it was begun with: --world, --workflow, --cases, --baseline
    OUT/bags/CASE/      train, hold1, hold2, robot.yaml: all that a diagnosis gets, as a copy in another folder
    OUT/healthy/CASE/   with --baseline: the same robot without what is hidden
    OUT/verdicts/CASE/  baseline.yaml where it was learnt, diagnosis.json, baselines.json, run.json (exit code, time)
    OUT/verdicts.sha256 hashes of all verdicts, written before a score reads any answer
    OUT/oracle/CASE/    diagnosis.json of a diagnosis that is given the name and place of each effect
    OUT/ranking/CASE/   ranking.json of all candidates by a method that is given how much clean robots vary
    OUT/rounds.txt      a hash for each earlier round of verdicts on the same bags (--again)
    OUT/score.json
    OUT.sealed/         CASE.json (the answers) and seeds.json; beside OUT, so that no folder that a diagnosis sees
                        leads to it

Existing files are kept: an interrupted run continues where it stopped. A case that cannot be recorded has no verdict.
"""

from __future__ import annotations

import hashlib
import json
import shlex
import shutil
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import as_completed
from pathlib import Path
from typing import Any

from ..errors import ConfigError, OutputError
from ..output import write_file
from ..processes import workers
from ..progress import Progress
from ..sim.engines import check_engine
from ..sim.worlds.world import world_from_yaml
from .cases import BAGS, BLOCK, HiddenCase, answer, draw_case, write_healthy, write_seed
from .commands import CaseCopy, last_line, run_command, run_diagnosis
from .folder import RunFolder, stored
from .seeds import commit, fresh_range, parse_range

DIAGNOSE = (sys.executable, "-m", "coman_reduced_model.cli.main", "diagnose")
LEARN_BASELINE = (sys.executable, "-m", "coman_reduced_model.cli.main", "baseline")
BASELINES = (sys.executable, "-m", "coman_reduced_model.judge.baselines")
RANK = (sys.executable, "-m", "coman_reduced_model.judge.rank")
FRESH = 200  # cases of a run by default


def choose_seeds(text: str, out: str | Path) -> Sequence[int]:
    """Seeds as asked for; else those of the run in `out`; else the next fresh range.

    Args:
        text: FIRST:END (END not included), or nothing.
        out: folder of the run.

    Raises:
        ConfigError: not of that form, or empty; those of the run cannot be read.
    """
    known = RunFolder(Path(out).absolute()).seeds
    if text:
        try:
            return parse_range(text)
        except ValueError as error:
            raise ConfigError(f"--seeds: {error}") from None
    if known.is_file():
        if (seeds := stored(known)) is None:
            raise ConfigError(f"{known}: cannot be read: give the seeds of this run by --seeds")
        return [int(seed) for seed in seeds]
    return fresh_range("worlds", FRESH, BLOCK)


def chosen_cases(
    out: str | Path,
    seeds: Sequence[int],
    kinds: Sequence[str] = (),
    again: bool = False,
    judged: Mapping[str, str | bool] | None = None,
    **fixed: Any,
) -> tuple[RunFolder, list[HiddenCase]]:
    """The folder of a run, ready to be written, and its cases.

    Args:
        out: folder of the run; an existing run continues.
        seeds: one for each case.
        kinds: only these (clean, single, pair, unknown); none: all.
        again: drop the verdicts of another commit.
        judged: options of what diagnoses, `workflow` and `baseline`; None: no diagnosis is judged.
        fixed: see draw_case.

    Raises:
        ConfigError: there is no such case.
        OutputError: `out` cannot be written, or the run was begun at another commit or with other options.
    """
    folder = RunFolder(Path(out).absolute())
    cases = [case for case in (draw_case(seed, **fixed) for seed in seeds) if not kinds or case.kind in kinds]
    if not cases:
        raise ConfigError(f"--only: no case of {', '.join(kinds)} among these seeds")
    try:
        for name in ("bags", "verdicts"):
            (folder.out / name).mkdir(parents=True, exist_ok=True)
        folder.sealed.mkdir(mode=0o700, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{error.filename}: cannot be written: {error.strerror}") from None
    worlds = " ".join((fixed.get("worlds") or {}).values())
    options = {"cases": "", "world": worlds, **(judged or {})}
    folder.keep_to_options(options, again)
    keep_to_one_commit(folder, again)  # the last that refuses: it drops verdicts
    _write_sealed(folder.seeds, list(seeds))
    return folder, cases


def keep_to_one_commit(folder: RunFolder, again: bool = False) -> None:
    """A run goes on with the code that it was begun with; writes OUT/commit.txt.

    Raises:
        OutputError: this is another commit, and `again` is not asked for.
    """
    begun = folder.begun
    if not begun and any((folder.out / "verdicts").glob("*")):
        begun = "(not known)"
    if again:
        _drop_verdicts(folder)
    elif begun and begun != commit():
        raise OutputError(
            f"{folder.out}: was begun at commit {begun}, and this is {commit()}: figures of different versions are not "
            "pooled; take another folder, or diagnose the bags of these seeds again with --again"
        )
    write_file(folder.commit, f"{commit()}\n")


def run(
    out: str | Path,
    seeds: Sequence[int],
    kinds: Sequence[str] = (),
    jobs: int = 1,
    command: Sequence[str] = DIAGNOSE,
    baselines: Sequence[str] = BASELINES,
    oracle: bool = True,
    again: bool = False,
    baseline: bool = False,
    progress: Progress | None = None,
    **fixed: Any,
) -> list[str]:
    """Record, diagnose and seal; `score.score_run` opens the answers afterwards.

    Args:
        out: folder of the run; an existing run continues.
        seeds: one for each case.
        kinds: only these (clean, single, pair, unknown); none: all.
        jobs: processes at a time.
        command: the workflow, to which bags and options are appended.
        baselines: the same for the simpler methods; empty: none.
        oracle: also run the two oracles: diagnoses that are given the name and place of each effect, and rankings
            (rank.py) that are given the variability of clean robots of this world.
        again: keep the bags and judge a changed workflow on them; the score counts the rounds.
        baseline: each diagnosis gets the baseline of its robot, learnt from recordings without what is hidden.
        progress: called with the fraction done and a text.
        fixed: see draw_case.

    Returns:
        The names of the cases.

    Raises:
        ConfigError: there is no such case.
        OutputError: `out` cannot be written, or the run was begun at another commit or with other options.
    """
    judged: dict[str, str | bool] = {"workflow": workflow_of(command), "baseline": baseline}
    folder, cases = chosen_cases(out, seeds, kinds, again, judged, **fixed)
    if baseline:
        (folder.out / "healthy").mkdir(exist_ok=True)
    names = [case.name for case in cases]
    tasks = [(folder, case.seed, tuple(command), tuple(baselines), fixed, baseline) for case in cases]
    run_all(_judge_case, tasks, jobs, _part(progress, 0.0, 0.85 if oracle else 1.0), "cases")
    seal(folder, names)
    if oracle:
        asked = [(folder, name, tuple(command)) for name in names]
        run_all(_run_oracles, asked, jobs, _part(progress, 0.85, 1.0), "oracles")
    return names


def workflow_of(command: Sequence[str]) -> str:
    """A command as `--workflow` gives it; nothing: that of this project."""
    return "" if tuple(command) == DIAGNOSE else shlex.join(command)


def _drop_verdicts(folder: RunFolder) -> None:
    """Remove all verdicts, and what they took; `rounds.txt` keeps their hash."""
    folder.times.unlink(missing_ok=True)
    if folder.hashes.is_file():
        digest = hashlib.sha256(folder.hashes.read_bytes()).hexdigest()
        with folder.rounds.open("a", encoding="utf-8") as file:
            file.write(f"{digest}\n")
        folder.hashes.unlink()
    for name in ("verdicts", "oracle", "ranking", "predictions", "monitor", "hours"):
        shutil.rmtree(folder.out / name, ignore_errors=True)
    (folder.out / "verdicts").mkdir()


def _part(progress: Progress | None, begin: float, end: float) -> Progress | None:
    """Report a part of the whole run."""
    return None if progress is None else lambda done, what: progress(begin + (end - begin) * done, what)


def run_all(
    work: Callable[..., None], tasks: Sequence[tuple[Any, ...]], jobs: int, progress: Progress | None, what: str
) -> None:
    """Run `work(*task)` for each task in processes; the first error ends all."""
    with workers(jobs) as pool:
        futures = [pool.submit(work, *task) for task in tasks]
        for done, future in enumerate(as_completed(futures), 1):
            future.result()
            if progress:
                progress(done / len(tasks), f"{done} of {len(tasks)} {what}")


def make_case(folder: RunFolder, seed: int, **fixed: Any) -> tuple[str, str]:
    """Bags and answer of a seed's case, unless they exist; its name, and why it cannot be recorded, or nothing.

    Raises:
        ConfigError: its engine is not installed.
        OSError, OutputError, MemoryError, ImportError: not of the case, but of this machine.
    """
    case = draw_case(seed, **fixed)
    known = stored(folder.answer(case.name))
    if known is None or not (folder.bags(case.name).is_dir() or "failed" in known):
        check_engine(case.world.engine)
        try:
            _, known = write_seed(seed, folder.out / "bags", force=True, **fixed)
        except (OSError, OutputError, MemoryError, ImportError):
            raise
        except Exception as error:  # whatever else ends a simulation is the failure of this case, not of the run
            shutil.rmtree(folder.bags(case.name), ignore_errors=True)
            known = {**answer(case), "failed": f"{type(error).__name__}: {' '.join(str(error).split())}"}
        _write_sealed(folder.answer(case.name), known)
    return case.name, known.get("failed", "")


def make_healthy(folder: RunFolder, name: str) -> None:
    """Healthy recordings of the robot of a case, unless they exist."""
    if not folder.healthy(name).is_dir():
        known, partial = stored(folder.answer(name)), folder.healthy(f".{name}.part")
        write_healthy(world_from_yaml(known["world"]), known["seed"], partial, force=True)
        partial.rename(folder.healthy(name))


def _judge_case(
    folder: RunFolder,
    seed: int,
    command: Sequence[str],
    baselines: Sequence[str],
    fixed: dict[str, Any],
    baseline: bool = False,
) -> None:
    """Bags, verdict and baselines of one case; one that cannot be recorded has none, and its answer says why."""
    name, failed = make_case(folder, seed, **fixed)
    done = stored(folder.verdict(name) / "run.json") is not None
    if failed:
        if not done:
            write_file(folder.verdict(name) / "run.json", json.dumps({"message": "not recorded"}))
        return
    if not done:
        usual = None
        if baseline:
            make_healthy(folder, name)
            usual = _learn_baseline(folder, name)
        _diagnose_case(folder, name, folder.verdict(name), command, usual=usual)
    if baselines and stored(folder.verdict(name) / "baselines.json") is None:
        _run_baselines(folder.bags(name), folder.verdict(name), baselines)


def _write_sealed(path: Path, value: Any) -> None:
    """Write JSON that only its owner can read."""
    write_file(path, json.dumps(value, indent=1), private=True)


def _run_baselines(bags: Path, verdict: Path, command: Sequence[str]) -> None:
    """Run the simpler methods on a copy of the training walk of a case."""
    with _case_copy(bags) as (copy, environment):
        train, config = copy / BAGS[0], copy / "robot.yaml"
        result = run_command([*command, str(train), "--config", str(config)], copy, environment)
    text = result.stdout if result.returncode == 0 else json.dumps({"failed": last_line(result.stderr)})
    write_file(verdict / "baselines.json", text)


def _case_copy(bags: Path) -> CaseCopy:
    return CaseCopy([bags / bag for bag in BAGS], bags / "robot.yaml")


def _diagnose_case(
    folder: RunFolder, name: str, verdict: Path, command: Sequence[str], *extra: str, usual: Path | None = None
) -> None:
    bags = [folder.bags(name) / bag for bag in BAGS]
    run_diagnosis(bags, folder.bags(name) / "robot.yaml", verdict, command, extra, usual)


def _learn_baseline(folder: RunFolder, name: str) -> Path | None:
    """The baseline of a case's robot; None, and a message beside the verdict: it could not be learnt."""
    verdict, bags = folder.verdict(name), sorted(folder.healthy(name).iterdir())
    if not bags:
        write_file(verdict / "no_baseline.txt", "it falls on all gaits\n")
        return None
    with CaseCopy(bags, folder.bags(name) / "robot.yaml") as (copy, environment):
        paths, out = [str(copy / bag.name) for bag in bags], copy / "baseline.yaml"
        options = ["--config", str(copy / "robot.yaml"), "--out", str(out)]
        result = run_command([*LEARN_BASELINE, *paths, *options], copy, environment)
        if out.is_file():
            write_file(verdict / "baseline.yaml", out.read_bytes())
            return verdict / "baseline.yaml"
    write_file(verdict / "no_baseline.txt", f"{last_line(result.stderr)}\n")
    return None


def _run_oracles(folder: RunFolder, name: str, command: Sequence[str]) -> None:
    """Both oracles of a case with hidden effects, rankings of clean ones too; run after the verdicts are sealed."""
    known = stored(folder.answer(name))
    if known["kind"] not in ("single", "pair", "clean") or "failed" in known:
        return
    if known["kind"] != "clean" and stored(folder.oracle(name) / "run.json") is None:
        assumed = [f"{e['name']}:where={e['where']}" if e["where"] else e["name"] for e in known["effects"]]
        options = [part for text in assumed for part in ("--assume", text)]
        learnt = folder.verdict(name) / "baseline.yaml"
        usual = learnt if learnt.is_file() else None
        _diagnose_case(folder, name, folder.oracle(name), command, *options, usual=usual)
    if stored(folder.ranking(name) / "ranking.json") is None:
        _write_ranking(folder, name, known["world"])


def _write_ranking(folder: RunFolder, name: str, world: str) -> None:
    """Rank the candidates by the method that is given the variability of clean robots of this world."""
    with _case_copy(folder.bags(name)) as (copy, environment):
        (copy / "world.yaml").write_text(world, encoding="utf-8")
        result = run_command([*RANK, str(copy)], copy, environment)
    text = result.stdout if result.returncode == 0 else json.dumps({"failed": last_line(result.stderr)})
    write_file(folder.ranking(name) / "ranking.json", text)


def seal(folder: RunFolder, names: Sequence[str]) -> str:
    """Write the hash of each verdict before an answer is read, and check those written before.

    Returns:
        The hash of all.

    Raises:
        OutputError: a verdict was changed after its answer could have been read.
    """
    lines = []
    for name in sorted(names):
        parts = [folder.verdict(name) / file for file in ("diagnosis.json", "run.json")]
        digest = hashlib.sha256(b"".join(part.read_bytes() for part in parts if part.is_file())).hexdigest()
        lines.append(f"{digest}  {name}")
    path = folder.hashes
    written = [line.split() for line in path.read_text().splitlines()] if path.is_file() else []
    known = {name: digest for digest, name in written}
    for line in lines:
        digest, name = line.split()
        if known.setdefault(name, digest) != digest:
            raise OutputError(
                f"{folder.verdict(name)}: changed since the answers were opened; --again starts another round"
            )
    write_file(path, "".join(f"{digest}  {name}\n" for name, digest in sorted(known.items())))
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()
