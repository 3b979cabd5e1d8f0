# SPDX-License-Identifier: BSD-3-Clause
"""The files of a run of the judge; run.py says what each is."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from ..errors import ConfigError, OutputError
from ..output import write_file


def stored(path: Path) -> Any:
    """The value of a JSON file; None: there is none, or one that was left unfinished."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


def read_verdict(path: Path) -> Any:
    """What diagnosis.json says; None: there is none, or it is not of the form that `coman diagnose` writes."""
    said = stored(path)
    try:
        effects = [*(said.get("effects") or ()), *(said.get("suspected") or ())]
        likely = said.get("probabilities") or {}
        names = [said["verdict"], *likely, *(effect["name"] for effect in effects)]
        names += [effect.get("where") or "" for effect in effects]
        values = [each.get("value") for effect in effects for each in effect.get("parameters", {}).values()]
        numbers = [value for value in (*likely.values(), *values) if value is not None]
    except (AttributeError, KeyError, TypeError):
        return None
    known = all(isinstance(name, str) for name in names) and all(isinstance(each, int | float) for each in numbers)
    return {**said, "effects": list(said.get("effects") or ())} if known else None


def names_effects(said: Mapping[str, Any]) -> bool:
    """Whether a verdict names effects, some that matter or minor ones alone (`none` with `only_minor`)."""
    return said["verdict"] == "effect" or bool(said.get("only_minor") and said.get("effects"))


def _with_option(name: str, value: str | bool) -> str:
    if isinstance(value, bool):
        return f"{'with' if value else 'without'} --{name}"
    return f"with --{name} {value}" if value else f"with the default of --{name}"


@dataclass(frozen=True)
class RunFolder:
    """The files of a run."""

    out: Path

    @property
    def sealed(self) -> Path:
        """Folder of the answers."""
        return self.out.with_name(f"{self.out.name}.sealed")

    @property
    def seeds(self) -> Path:
        """The seeds of the run; they are the answers to whoever can run this code."""
        return self.sealed / "seeds.json"

    @property
    def hashes(self) -> Path:
        """Hashes of the verdicts."""
        return self.out / "verdicts.sha256"

    @property
    def commit(self) -> Path:
        """The commit that the run was begun at."""
        return self.out / "commit.txt"

    @property
    def begun(self) -> str:
        """What it says; nothing: not known."""
        return self.commit.read_text(encoding="utf-8").strip() if self.commit.is_file() else ""

    @property
    def options(self) -> Path:
        """The options that the run was begun with."""
        return self.out / "options.yaml"

    @property
    def rounds(self) -> Path:
        """Hashes of earlier verdicts on the same bags."""
        return self.out / "rounds.txt"

    @property
    def times(self) -> Path:
        """What was judged, for how long [s] and in how many processes; a line each time that the run went on."""
        return self.out / "time.txt"

    def keep_to_options(self, given: Mapping[str, str | bool], again: bool = False) -> None:
        """A run goes on with the options that it was begun with; writes OUT/options.yaml.

        Args:
            given: by option; nothing: its default.
            again: what is judged may be another: `config`, `workflow` and `baseline`.

        Raises:
            OutputError: these are others, or it cannot be written.
        """
        begun = yaml.safe_load(self.options.read_text(encoding="utf-8")) if self.options.is_file() else {}
        for name, value in given.items():
            if begun.get(name, value) != value and not (again and name in ("config", "workflow", "baseline")):
                raise OutputError(
                    f"{self.out}: was begun {_with_option(name, begun[name])}: go on so, or take another folder"
                )
        write_file(self.options, yaml.safe_dump({**begun, **given}))

    @contextmanager
    def timed(self, what: str, jobs: int) -> Iterator[None]:
        """Write down how long the part inside took, however it ends, unless it was refused."""
        began, refused = time.monotonic(), False
        try:
            yield
        except (ConfigError, OutputError):
            refused = True
            raise
        finally:
            if not refused and self.out.is_dir():
                with self.times.open("a", encoding="utf-8") as file:
                    file.write(f"{what} {time.monotonic() - began:.0f} {jobs}\n")

    def took(self, what: str) -> dict[str, float] | None:
        """Seconds of all that was judged so, and the most processes; None: not known."""
        lines = self.times.read_text(encoding="utf-8").splitlines() if self.times.is_file() else []
        found = [line.split() for line in lines if line.split()[:1] == [what]]
        if not found:
            return None
        return {"seconds": sum(float(each[1]) for each in found), "jobs": max(int(each[2]) for each in found)}

    def bags(self, case: str) -> Path:
        return self.out / "bags" / case

    def healthy(self, case: str) -> Path:
        return self.out / "healthy" / case

    def verdict(self, case: str) -> Path:
        return self.out / "verdicts" / case

    def oracle(self, case: str) -> Path:
        return self.out / "oracle" / case

    def ranking(self, case: str) -> Path:
        return self.out / "ranking" / case

    def answer(self, case: str) -> Path:
        return self.sealed / f"{case}.json"
