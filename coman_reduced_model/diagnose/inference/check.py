# SPDX-License-Identifier: BSD-3-Clause
"""Step 2, check: which recordings can be used, with which of their streams, and what they cannot show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...core.base.nominal import Nominal
from ...core.config.schema import Config
from ...core.effects.catalogue import CATALOGUE
from ...errors import BagError, ConfigError
from ..data.masks import TICKS, part_of, with_taken_up
from ..data.reading import Reading
from ..data.recording import Recording, moving
from ..physics.hypotheses import candidates, unknowns
from .case import STEADY_S, Prepared, prepare

# Shares of a training recording that confirm where there is no other, and of what is left that help to choose.
CONFIRMING, SELECTING = 1.0 / 3.0, 0.4


@dataclass(frozen=True)
class Checked:
    """Recordings that the search can use.

    Attributes:
        train, select, confirm: recordings with the streams that all of them have: effects are fitted to the first,
            the second help to choose, and the last is opened once, at the end, and can only take away.
        train_paths, hold_paths: bags of the first; of the others.
        recordings: all of them with all of their streams, the training bags first.
        not_checked: sentences on what the recordings cannot show, and which bags were left out.
    """

    train: list[Prepared]
    select: list[Prepared]
    confirm: list[Prepared]
    train_paths: list[str | Path]
    hold_paths: list[str | Path]
    recordings: list[Recording]
    not_checked: list[str]

    @property
    def paths(self) -> list[str | Path]:
        """All bags."""
        return [*self.train_paths, *self.hold_paths]

    @property
    def judging_paths(self) -> list[str | Path]:
        """Bags whose COM decides what goes into the model: the held-out ones, if there are any."""
        return self.hold_paths or self.train_paths

    @property
    def clocks_apart(self) -> list[str]:
        """By recording, streams whose clocks differ from that of the joint states, or that arrive at another time."""
        return [f"{each.name}: {line}" for each in self.recordings for line in each.clocks]


def parse_assumed(text: str) -> tuple[str, str]:
    """Name and place of an assumed effect: `NAME` or `NAME:where=PLACE`.

    Raises:
        ConfigError: of another form, or an unknown effect.
    """
    name, _, rest = text.partition(":")
    key, _, where = rest.partition("=")
    if name not in CATALOGUE or (rest and key != "where"):
        raise ConfigError(f"--assume {text}: wanted NAME or NAME:where=PLACE (names: {', '.join(CATALOGUE)})")
    return name, where


def check_recordings(
    readings: Sequence[Reading],
    train_count: int,
    config: Config,
    assumed: Sequence[tuple[str, str]],
    whole: bool = False,
    nominal: Nominal | None = None,
) -> Checked:
    """Prepare the recordings; a held-out one that hardly ever stands steadily is left out.

    Args:
        readings: of the `train_count` training bags, then of the held-out ones.
        assumed: effects by name and place that must be candidates of these recordings.
        whole: no part of a training recording is kept for choosing and confirming, as where effects are assumed.
        nominal: what nominal robots are like; default: the shipped population.

    Raises:
        BagError: a training bag hardly ever stands steadily.
        ConfigError: an assumed effect cannot be fitted to these recordings.
    """
    prepared: list[Prepared] = []
    paths, left_out = [], []
    for i, reading in enumerate(readings):
        try:
            prepared.append(prepare(reading.recording, reading.robot, config, nominal))
            paths.append(reading.path)
        except BagError as error:
            if i < train_count:
                raise
            left_out.append(f"{error}; left out")
    recordings = [recording for recording, _, _ in prepared]
    not_checked = [*left_out, *limitations(prepared)]
    prepared = with_common_streams(prepared)
    if assumed:
        _refuse_what_cannot_be_fitted(assumed, prepared[0])
    n = train_count
    train, hold = prepared[:n], prepared[n:]
    select, confirm = hold[:-1], hold[-1:]
    whole = whole or bool(assumed)  # nothing is chosen then
    if not hold and not whole:
        train, confirm = _last_part_apart(train, CONFIRMING)
    if not select and not whole:
        train, select = _last_part_apart(train, SELECTING)
    return Checked(train, select, confirm, paths[:n], paths[n:], recordings, not_checked)


def _last_part_apart(train: list[Prepared], share: float) -> tuple[list[Prepared], list[Prepared]]:
    """The last recording in two parts, the second a share of its steady ticks; whole where it is too short for that.

    Of a recording in which it walks, a share of those on one foot: the second part has steps, however long it stands.
    """
    *others, (recording, world, where) = train
    on_one_foot = np.flatnonzero(where.steady & ~where.double)
    steady = on_one_foot if moving(recording.phase) and len(on_one_foot) else np.flatnonzero(where.steady)
    cut = float(steady[round((1.0 - share) * (len(steady) - 1))]) / len(where.ticks)
    first, last = part_of(where, 0.0, cut), part_of(where, cut, 1.0)
    if min(last.steady.sum(), first.steady.sum()) < STEADY_S * TICKS:
        return train, []
    return [*others, (recording, world, first)], [(recording, world, last)]


def _refuse_what_cannot_be_fitted(assumed: Sequence[tuple[str, str]], prepared: Prepared) -> None:
    """The search would take these for absent."""
    places: dict[str, list[str]] = {}
    for option in candidates(unknowns(prepared[0], prepared[1])):
        places.setdefault(option.effect, []).append(option.place)
    for name, where in assumed:
        if name not in places:
            raise ConfigError(f"--assume {name}: cannot be fitted to these bags (can be: {', '.join(places)})")
        if where not in places[name]:
            allowed = ", ".join(dict.fromkeys(f"where={each}" if each else "no place" for each in places[name]))
            raise ConfigError(f"--assume {name}: at {where or 'no place'}: allowed: {allowed}")


def with_common_streams(prepared: Sequence[Prepared]) -> list[Prepared]:
    """The recordings without the streams that one of them lacks: all have the same parameters then."""
    drop = {
        name: None
        for name in ("tau", "motor_q", "up", "plan", "moved")
        if any(getattr(recording, name) is None for recording, _, _ in prepared)
    }
    less = [recording.changed(**drop) for recording, _, _ in prepared]
    return [
        (recording, world, with_taken_up(where, before, recording, world))
        for recording, (before, world, where) in zip(less, prepared, strict=True)
    ]


def limitations(prepared: Sequence[Prepared]) -> list[str]:
    """What the recordings cannot show, a sentence each."""
    lines, recordings = [], [recording for recording, _, _ in prepared]
    motors = all(recording.motor_q is not None for recording in recordings)
    if motors and any(recording.tau is None and not recording.computed for recording in recordings):
        lines.append("no joint torques: springs are judged by what the foot wrenches ask for")
    if not motors:
        lines.append("no motor states: springs, motors and play cannot be judged")
    if any(recording.up is None for recording in recordings):
        lines.append("no IMU: a sloping floor and a pull look alike")
    if any(recording.plan is None for recording in recordings):
        lines.append("no com/reference with motor states: what the motors make of it cannot be judged")
    if any(moving(recording.phase) and not where.slides for recording, _, where in prepared):
        lines.append("in a bag, the other foot leaves soon after each landing: a foot that slides does not show there")
    for recording in recordings:
        turned = (recording.turned,) if recording.turned else ()
        lines += [f"{recording.name}: {warning}" for warning in (*recording.warnings, *turned)]
    return lines
