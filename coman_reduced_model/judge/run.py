# SPDX-License-Identifier: BSD-3-Clause
"""One run of the judge: bags, verdicts, baselines, oracles; then, and only then, the answers.

    OUT/bags/CASE/      train, hold1, hold2, robot.yaml: all that a diagnosis gets, in a copy elsewhere
    OUT/verdicts/CASE/  diagnosis.json, baselines.json, run.json (exit code, time)
    OUT/verdicts.sha256 of all verdicts, written before any answer is read
    OUT/oracle/CASE/    diagnosis.json of a diagnosis that was told name and place
    OUT/rounds.txt      hashes of earlier verdicts on the same bags (--again): how often these answers have been opened
    OUT/score.json
    OUT.sealed/         CASE.json: what is true; beside OUT, so that no folder that a diagnosis sees leads to it

What is there is not made again: a run that was broken off goes on.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import ConfigError, OutputError
from .cases import BAGS, draw_case, write_seed

Progress = Callable[[float, str], None]
DIAGNOSE = (sys.executable, "-m", "coman_reduced_model.cli.main", "diagnose")
BASELINES = (sys.executable, "-m", "coman_reduced_model.judge.baselines")
TUNING_SEEDS = range(1000)  # for choosing thresholds; figures are reported on seeds from 1000 on
TIMEOUT = 600.0  # [s] after which a diagnosis counts as failed


@dataclass(frozen=True)
class Layout:
    """Where things of a run are."""

    out: Path

    @property
    def sealed(self) -> Path:
        """The answers."""
        return self.out.with_name(f"{self.out.name}.sealed")

    @property
    def hashes(self) -> Path:
        """Of the verdicts."""
        return self.out / "verdicts.sha256"

    @property
    def rounds(self) -> Path:
        """Of earlier verdicts on the same bags."""
        return self.out / "rounds.txt"

    def bags(self, case: str) -> Path:
        return self.out / "bags" / case

    def verdict(self, case: str) -> Path:
        return self.out / "verdicts" / case

    def oracle(self, case: str) -> Path:
        return self.out / "oracle" / case

    def answer(self, case: str) -> Path:
        return self.sealed / f"{case}.json"


def parse_seeds(text: str) -> range:
    """Seeds from `FIRST:END` (END not included).

    Raises:
        ConfigError: not of that form, empty, or across the border between tuning and reporting.
    """
    first, colon, end = text.partition(":")
    if not (colon and first.isdigit() and end.isdigit() and int(first) < int(end)):
        raise ConfigError(f"--seeds: {text!r}: wanted: FIRST:END, such as 1000:1200")
    seeds = range(int(first), int(end))
    if seeds[0] in TUNING_SEEDS and seeds[-1] not in TUNING_SEEDS:
        border = TUNING_SEEDS.stop
        raise ConfigError(
            f"--seeds: {text!r}: allowed: below {border} (for choosing thresholds) or from {border} on (for reporting)"
        )
    return seeds


def run(
    out: str | Path,
    seeds: Sequence[int],
    kinds: Sequence[str] = (),
    jobs: int = 1,
    command: Sequence[str] = DIAGNOSE,
    baselines: Sequence[str] = BASELINES,
    oracle: bool = True,
    again: bool = False,
    progress: Progress | None = None,
) -> list[str]:
    """Everything but the score: `score.score_run` opens the answers.

    Args:
        out: folder of the run; one that is there is gone on with.
        seeds: of the cases.
        kinds: only these (clean, single, pair, unknown); none: all.
        jobs: processes at a time.
        command: the workflow, to which bags and options are appended.
        baselines: the same for the simpler methods; empty: none.
        oracle: also run diagnoses that are told name and place.
        again: keep the bags and judge a changed workflow on them; the round is counted in the score.
        progress: called now and then.

    Returns:
        The names of the cases.

    Raises:
        OutputError: `out` cannot be written.
    """
    layout = Layout(Path(out).absolute())
    chosen = [seed for seed in seeds if not kinds or draw_case(seed).kind in kinds]
    if not chosen:
        raise ConfigError(f"--only: no case of {', '.join(kinds)} among these seeds")
    names = [draw_case(seed).name for seed in chosen]
    try:
        for folder in (layout.out / "bags", layout.out / "verdicts"):
            folder.mkdir(parents=True, exist_ok=True)
        layout.sealed.mkdir(mode=0o700, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{error.filename}: cannot be written: {error.strerror}") from None
    if again:
        _forget(layout)
    _all(_case, [(layout, s, tuple(command), tuple(baselines)) for s in chosen], jobs, progress, "cases", 0.0)
    seal(layout, names)
    if oracle:
        _all(_oracle, [(layout, name, tuple(command)) for name in names], jobs, progress, "oracles", 0.85)
    return names


def _forget(layout: Layout) -> None:
    """Drops all verdicts, but not the memory that there were some."""
    if layout.hashes.is_file():
        digest = hashlib.sha256(layout.hashes.read_bytes()).hexdigest()
        with layout.rounds.open("a", encoding="utf-8") as file:
            file.write(f"{digest}\n")
        layout.hashes.unlink()
    for folder in ("verdicts", "oracle"):
        shutil.rmtree(layout.out / folder, ignore_errors=True)
        (layout.out / folder).mkdir()


def _all(
    work: Callable[..., None], tasks: list[Any], jobs: int, progress: Progress | None, what: str, at: float
) -> None:
    share = 0.85 if at == 0.0 else 0.15
    with ProcessPoolExecutor(max(1, jobs)) as pool:
        futures = [pool.submit(work, *task) for task in tasks]
        try:
            for done, future in enumerate(as_completed(futures), 1):
                future.result()
                if progress:
                    progress(at + share * done / len(tasks), f"{done} of {len(tasks)} {what}")
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _case(layout: Layout, seed: int, command: Sequence[str], baselines: Sequence[str]) -> None:
    """Bags, verdict and baselines of one case."""
    name = draw_case(seed).name
    if not (layout.bags(name).is_dir() and layout.answer(name).is_file()):
        _, answer = write_seed(seed, layout.out / "bags", force=True)
        layout.answer(name).write_text(json.dumps(answer, indent=1), encoding="utf-8")
        layout.answer(name).chmod(0o600)
    if not (layout.verdict(name) / "run.json").is_file():
        diagnose(layout.bags(name), layout.verdict(name), command)
    if baselines and not (layout.verdict(name) / "baselines.json").is_file():
        with _Copy(layout.bags(name)) as (copy, environment):
            result = _call([*baselines, *_arguments(copy)[:1], *_arguments(copy)[-2:]], copy, environment)
            text = result.stdout if result.returncode == 0 else json.dumps({"failed": _last_line(result.stderr)})
        (layout.verdict(name) / "baselines.json").write_text(text, encoding="utf-8")


class _Copy:
    """A copy of a case's bags under a name of its own, far from the run: what a diagnosis can see of it."""

    def __init__(self, bags: Path) -> None:
        self._bags = bags

    def __enter__(self) -> tuple[Path, dict[str, str]]:
        self._folder = Path(tempfile.mkdtemp(prefix="walk_"))
        for name in (*BAGS, "robot.yaml"):
            source = self._bags / name
            (shutil.copytree if source.is_dir() else shutil.copy2)(source, self._folder / name)
        # Nothing inherited names the run: neither the working directory nor the command line that started the judge.
        hidden = str(self._bags.parents[1])
        needed, telling = ("PATH", "PYTHONPATH", "LD_LIBRARY_PATH", "HOME"), ("OLDPWD", "PWD", "_")
        environment = {k: v for k, v in os.environ.items() if k in needed or (hidden not in v and k not in telling)}
        return self._folder, environment

    def __exit__(self, *_: object) -> None:
        shutil.rmtree(self._folder, ignore_errors=True)


def _arguments(copy: Path) -> list[str]:
    held = [argument for bag in BAGS[1:] for argument in ("--holdout", str(copy / bag))]
    return [str(copy / BAGS[0]), *held, "--config", str(copy / "robot.yaml")]


def _call(command: Sequence[str], folder: Path, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    try:
        return subprocess.run(
            command, cwd=folder, env=environment, capture_output=True, text=True, timeout=TIMEOUT, check=False
        )
    except subprocess.TimeoutExpired:
        return subprocess.CompletedProcess(command, -1, "", f"no verdict within {TIMEOUT:g} s")
    except OSError as error:
        raise ConfigError(f"{command[0]}: cannot be started: {error.strerror}") from None


def _last_line(text: str) -> str:
    return (text.strip().splitlines() or [""])[-1]


def diagnose(bags: Path, verdict: Path, command: Sequence[str], extra: Sequence[str] = ()) -> None:
    """Runs the workflow on a copy of a case's bags and keeps its diagnosis and how the run went."""
    verdict.mkdir(parents=True, exist_ok=True)
    with _Copy(bags) as (copy, environment):
        out = copy / "out"
        before = os.times()
        began = time.perf_counter()
        result = _call([*command, *_arguments(copy), "--out", str(out), "--json", *extra], copy, environment)
        seconds, after = time.perf_counter() - began, os.times()
        cpu = after.children_user + after.children_system - before.children_user - before.children_system
        if (out / "diagnosis.json").is_file():
            shutil.copy2(out / "diagnosis.json", verdict / "diagnosis.json")
    report = {"exit": result.returncode, "seconds": seconds, "cpu_seconds": cpu, "said": _last_line(result.stderr)}
    (verdict / "run.json").write_text(json.dumps(report), encoding="utf-8")


def _oracle(layout: Layout, name: str, command: Sequence[str]) -> None:
    """The same diagnosis, told the name and the place of its effects; run after the verdicts are sealed."""
    answer = json.loads(layout.answer(name).read_text(encoding="utf-8"))
    if answer["kind"] not in ("single", "pair") or (layout.oracle(name) / "run.json").is_file():
        return
    told = [f"{e['name']}:where={e['where']}" if e["where"] else e["name"] for e in answer["effects"]]
    diagnose(layout.bags(name), layout.oracle(name), command, [part for text in told for part in ("--assume", text)])


def seal(layout: Layout, names: Sequence[str]) -> str:
    """The hash of all verdicts, written before an answer is read; a run that goes on must find the same verdicts.

    Raises:
        OutputError: a verdict was changed after its answer could have been read.
    """
    lines = []
    for name in sorted(names):
        parts = [layout.verdict(name) / file for file in ("diagnosis.json", "run.json")]
        digest = hashlib.sha256(b"".join(part.read_bytes() for part in parts if part.is_file())).hexdigest()
        lines.append(f"{digest}  {name}")
    path = layout.hashes
    written = [line.split() for line in path.read_text().splitlines()] if path.is_file() else []
    known = {name: digest for digest, name in written}
    for line in lines:
        digest, name = line.split()
        if known.setdefault(name, digest) != digest:
            raise OutputError(f"{layout.verdict(name)}: changed since the answers were opened; --again judges anew")
    path.write_text("".join(f"{digest}  {name}\n" for name, digest in sorted(known.items())), encoding="utf-8")
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()
