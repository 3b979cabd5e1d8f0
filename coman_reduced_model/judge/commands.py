# SPDX-License-Identifier: BSD-3-Clause
"""Commands that the judge runs on copies of recordings: what is judged sees nothing else of the run."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from ..errors import ConfigError
from ..output import write_file

TIMEOUT = 600.0  # [s] after which a diagnosis counts as failed


class CaseCopy:
    """A temporary copy of bags, configuration and baseline, outside the run: all that a diagnosis can see."""

    def __init__(self, bags: Sequence[Path], config: Path, usual: Path | None = None) -> None:
        self._bags, self._config, self._usual = [bag.absolute() for bag in bags], config, usual

    def __enter__(self) -> tuple[Path, dict[str, str]]:
        self._folder = Path(tempfile.mkdtemp(prefix="walk_"))
        for bag in self._bags:
            shutil.copytree(bag, self._folder / bag.name)
        shutil.copy2(self._config, self._folder / "robot.yaml")
        if self._usual is not None:
            shutil.copy2(self._usual, self._folder / "baseline.yaml")
        # Nothing inherited names the run: neither the working directory nor the command line that started the judge.
        hidden = str(self._bags[0].parents[2])
        needed, revealing = ("PATH", "PYTHONPATH", "LD_LIBRARY_PATH", "HOME"), ("OLDPWD", "PWD", "_")
        environment = {k: v for k, v in os.environ.items() if k in needed or (hidden not in v and k not in revealing)}
        return self._folder, environment

    def __exit__(self, *_: object) -> None:
        shutil.rmtree(self._folder, ignore_errors=True)


def run_command(command: Sequence[str], folder: Path, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    """Run a command in a folder; one that takes longer than TIMEOUT has failed.

    Raises:
        ConfigError: it cannot be started.
    """
    try:
        return subprocess.run(
            command, cwd=folder, env=environment, capture_output=True, text=True, timeout=TIMEOUT, check=False
        )
    except subprocess.TimeoutExpired:
        return subprocess.CompletedProcess(command, -1, "", f"no verdict within {TIMEOUT:g} s")
    except OSError as error:
        raise ConfigError(f"{command[0]}: cannot be started: {error.strerror}") from None


def last_line(text: str) -> str:
    """Of what a command has printed."""
    return (text.strip().splitlines() or [""])[-1]


def run_diagnosis(
    bags: Sequence[Path],
    config: Path,
    verdict: Path,
    command: Sequence[str],
    extra: Sequence[str] = (),
    usual: Path | None = None,
) -> None:
    """Run the workflow on a copy of bags and configuration; keep its diagnosis, exit code, times and last message.

    Args:
        bags: the training bag, then the held-out ones.
        config: data sheet of the robot.
        verdict: folder for diagnosis.json and run.json.
        command: the workflow, to which bags and options are appended.
        extra: more options.
        usual: the robot's baseline.
    """
    (verdict / "diagnosis.json").unlink(missing_ok=True)  # of a run that was killed
    with CaseCopy(bags, config, usual) as (copy, environment):
        train, *held_out = (str(copy / bag.name) for bag in bags)
        options = [part for bag in held_out for part in ("--holdout", bag)]
        if usual is not None:
            options += ["--baseline", str(copy / "baseline.yaml")]
        out = copy / "out"
        arguments = [train, *options, "--config", str(copy / "robot.yaml"), "--out", str(out), "--json", *extra]
        before = os.times()
        began = time.perf_counter()
        result = run_command([*command, *arguments], copy, environment)
        seconds, after = time.perf_counter() - began, os.times()
        cpu = after.children_user + after.children_system - before.children_user - before.children_system
        if (out / "diagnosis.json").is_file():
            write_file(verdict / "diagnosis.json", (out / "diagnosis.json").read_bytes())
    report = {"exit": result.returncode, "seconds": seconds, "cpu_seconds": cpu, "message": last_line(result.stderr)}
    write_file(verdict / "run.json", json.dumps(report))
