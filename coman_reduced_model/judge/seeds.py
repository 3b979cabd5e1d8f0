# SPDX-License-Identifier: BSD-3-Clause
"""Which seeds are spent (seeds.yaml) and which range is fresh."""

from __future__ import annotations

import hashlib
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import yaml

from ..resources import version

PACKAGE = "coman_reduced_model"  # new files elsewhere, such as runs, change nothing
FILE = Path(__file__).with_name("seeds.yaml")


@dataclass(frozen=True)
class Spent:
    """Seeds on which something was chosen or reported."""

    seeds: range
    purpose: str
    commit: str

    def __str__(self) -> str:
        return f"{self.seeds.start}:{self.seeds.stop} {self.purpose} ({self.commit})"


@cache
def spent(use: str) -> tuple[Spent, ...]:
    """The entries of the file for one use: worlds, judge, monitor or walks."""
    entries = yaml.safe_load(FILE.read_text(encoding="utf-8"))[use]
    return tuple(Spent(parse_range(entry["seeds"]), entry["purpose"], entry["commit"]) for entry in entries)


def parse_range(text: str) -> range:
    """Seeds from `FIRST:END` (END not included).

    Raises:
        ValueError: not of that form, or empty.
    """
    first, colon, end = text.partition(":")
    if not (colon and first.isdigit() and end.isdigit() and int(first) < int(end)):
        raise ValueError(f"{text!r}: wanted: FIRST:END, such as 1000:1200")
    return range(int(first), int(end))


def spent_among(use: str, seeds: Sequence[int]) -> list[Spent]:
    """The entries that hold any of these seeds."""
    return [entry for entry in spent(use) if any(seed in entry.seeds for seed in seeds)]


def fresh_range(use: str, size: int, step: int = 1) -> range:
    """The first `size` seeds from a multiple of `step` on, none of which is spent."""
    seeds = range(size)
    while entries := spent_among(use, seeds):
        end = min(entry.seeds.stop for entry in entries)
        first = -(-end // step) * step
        seeds = range(first, first + size)
    return seeds


def describe(use: str, seeds: Sequence[int]) -> str:
    """`fresh`, or how many of the seeds are spent and on what."""
    entries = spent_among(use, seeds)
    if not entries:
        return "fresh"
    number = sum(any(seed in entry.seeds for entry in entries) for seed in seeds)
    return f"{number} of {len(seeds)} spent: {'; '.join(map(str, entries))}"


def summary(use: str, seeds: Sequence[int]) -> dict[str, Any]:
    """First and last of the seeds, how many are fresh, and the entries that hold any of the others."""
    entries = spent_among(use, seeds)
    return {
        "first": min(seeds),
        "last": max(seeds),
        "fresh": sum(not any(seed in entry.seeds for entry in entries) for seed in seeds),
        "spent": [
            {"seeds": f"{e.seeds.start}:{e.seeds.stop}", "purpose": e.purpose, "commit": e.commit} for e in entries
        ],
    }


def entry_to_add(seeds: Sequence[int], at: str, purpose: str = "reported") -> str:
    """The line of the file that records these seeds as spent at a commit."""
    return f'  - {{seeds: "{min(seeds)}:{max(seeds) + 1}", purpose: "{purpose}", commit: "{at}"}}'


@cache
def commit() -> str:
    """Commit of the checkout that this file belongs to, with a hash of its changes; without one, the version."""
    return commit_of(FILE.resolve().parents[2])


def commit_of(checkout: Path) -> str:
    """The same of a checkout."""
    if not (checkout / ".git").exists():
        return version()

    def git(*command: str) -> bytes:
        return subprocess.run(["git", "-C", str(checkout), *command], capture_output=True, check=True).stdout

    try:
        name = git("describe", "--always", "--exclude", "*").decode().strip()
        changes = git("diff", "--no-ext-diff", "--no-color", "HEAD")
        for path in git("ls-files", "--others", "--exclude-standard", "-z", PACKAGE).decode().split("\0")[:-1]:
            changes += path.encode() + (checkout / path).read_bytes()
    except (OSError, subprocess.CalledProcessError):
        return version()
    return f"{name}-dirty-{hashlib.sha256(changes).hexdigest()[:6]}" if changes else name
