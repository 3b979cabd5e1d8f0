# SPDX-License-Identifier: BSD-3-Clause
"""Figures of a diagnosis: what the residuals are before and after the effects that were found."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from ...core.base.types import Array, Integers, Phase
from ...core.effects.catalogue import CATALOGUE
from ...report.draw import FAINT, GRID, INK, PHASE_NAMES, SERIES, SHADES, legend, new_figure, thin, title
from ...report.figures import NoData
from ..data.masks import supports
from ..data.recording import RATE
from ..inference.case import Case
from ..inference.finding import Finding
from ..inference.predicted_com import Errors
from .words import channel, channel_unit

SHOWN_S = 6.0  # [s] of a recording that a figure over time shows: more steps say no more
BEFORE = {"color": SERIES[0], "linewidth": 1.3}
AFTER = {"color": SERIES[1], "linewidth": 1.5}
# What the law of a joint is drawn against (`Effect.law`).
_AGAINST = {
    "torque": "measured torque [Nm]",
    "torque rate": "rate of the measured torque [Nm/s]",
    "speed": "joint speed [°/s]",
}


@dataclass(frozen=True)
class Pair:
    """One recording with the nominal robot, and with what was found."""

    before: Case
    after: Case
    finding: Finding

    @property
    def name(self) -> str:
        return self.before.recording.name

    @cached_property
    def left(self) -> tuple[dict[str, Array], dict[str, Array]]:
        """By group, what is left without and with what was found."""
        return self.finding.gaps(self.before, self.after)

    def over_ticks(self, name: str) -> tuple[Array, Array]:
        """A channel (m,) before and after at the recording's ticks; NaN where it says nothing."""
        return _joined(self.before, self.left[0], name), _joined(self.after, self.left[1], name)

    def made(self, name: str) -> Array:
        """(m,) What the effects alone put into a channel."""
        made: Array = self.before.state.residuals[name] - self.after.state.residuals[name]
        return made

    def floor(self, name: str) -> float:
        """Noise floor of a channel, the larger of single and double support."""
        return max(self.after.floor.get(f"{name}|{part}", 0.0) for part in supports(name))


def pairs(finding: Finding) -> tuple[list[Pair], list[Pair]]:
    """Of the training recordings, and of the held-out ones."""
    train, hold = (
        [Pair(old, new, finding) for old, new in zip(before, after, strict=True)]
        for before, after in zip(finding.before, (finding.train, finding.hold), strict=True)
    )
    return train, hold


def _joined(case: Case, left: dict[str, Array], name: str) -> Array:
    out = np.full(len(case.where.ticks), np.nan)
    for part in supports(name):
        key = f"{name}|{part}"
        if key in left:
            out[case.problem.times[key]] = left[key]
    return out


def residuals(pair: Pair, channels: Sequence[str], changed: bool) -> Figure:
    """What is left of channels over time, before and (if anything `changed`) after, over the noise floor."""
    if not channels:
        raise NoData("No residual shows it.")
    figure, plots = new_figure(len(channels), 1, 0.9 + 1.9 * len(channels), sharex=True)
    recording = pair.before.recording
    time = recording.t[pair.before.where.ticks]
    span = _span(time)
    inside = (time >= span[0]) & (time <= span[1])
    for ax, name in zip(plots, channels, strict=True):
        unit, factor = channel_unit(name)
        before, after = pair.over_ticks(name)
        _shade(ax, recording.t, recording.phase, span)
        level = factor * pair.floor(name)
        ax.axhspan(-level, level, facecolor=SERIES[2], alpha=0.25, edgecolor="none", label="noise floor (RMS)")
        ax.plot(*thin(time[inside], factor * before[inside]), label="before", marker=".", markersize=4, **BEFORE)
        if changed:
            ax.plot(*thin(time[inside], factor * after[inside]), label="after", marker=".", markersize=4, **AFTER)
        title(ax, channel(name))
        ax.set_ylabel(f"[{unit}]")
        ax.set_xlim(*span)
    plots[-1].set_xlabel("time [s]")
    legend(figure, plots[0], _patches(recording.phase))
    return figure


def law(pairs: Sequence[Pair], effect: str, joint: str) -> Figure:
    """The law of a joint: its residual with the effect (and the effect's share alone), and without it."""
    kind, against = CATALOGUE[effect].law or ("spring", "torque")
    name = f"{kind}/{joint}"
    unit, factor = channel_unit(name)
    points = []
    for pair in pairs:
        if name in pair.before.state.residuals:
            x, made, after = _against(pair, against, joint), pair.made(name), pair.over_ticks(name)[1]
            points.append(np.column_stack([x, made, after])[np.isfinite(made) & np.isfinite(after)])
    if not points:
        raise NoData(f"The recordings hold no {kind} of {joint}.")
    x, made, after = np.concatenate(points).T
    figure, (left, right) = new_figure(1, 2, 3.6, sharex=True, sharey=True)
    left.plot(x, factor * (made + after), ".", color=SERIES[0], markersize=3.5, label="measured")
    left.plot(x, factor * made, ".", color=INK, markersize=3, label="the effect alone, as fitted")
    right.plot(x, factor * after, ".", color=SERIES[1], markersize=3.5, label="left after")
    title(left, "before")
    title(right, "after")
    left.set_ylabel(f"{channel(name)} [{unit}]")
    for ax in (left, right):
        ax.axhline(0.0, color=FAINT, linewidth=0.8)
        ax.set_xlabel(_AGAINST[against])
    legend(figure, left)
    return figure


def _against(pair: Pair, what: str, joint: str) -> Array:
    case = pair.before
    j = case.state.world.robot.joint_names.index(joint)
    if what == "speed":
        return np.degrees(case.state.motion.qd[:, j])
    if case.recording.tau is None:
        raise NoData(f"No joint torques were recorded, so the law of {joint} cannot be drawn.")
    torque = case.state.smoothed(case.recording.tau)[:, j]
    if what == "torque rate":
        torque = np.gradient(torque, 1.0 / RATE)
    return np.asarray(torque[case.where.ticks])


def com_error(name: str, com: Errors, changed: bool) -> Figure:
    """Measured minus predicted COM of the free run over time, before and after."""
    times, before, after = com.times, com.before, com.after
    if not len(times):
        raise NoData(f"{name}: the COM was not predicted.")
    span = _span(times)
    inside = (times >= span[0]) & (times <= span[1])
    figure, plots = new_figure(3, 1, 5.2, sharex=True)
    for k, (ax, axis) in enumerate(zip(plots, ("x, forward", "y, left", "z, up"), strict=True)):
        ax.plot(*thin(times[inside], 1e3 * before[inside, k]), label="before", **BEFORE)
        if changed:
            ax.plot(*thin(times[inside], 1e3 * after[inside, k]), label="after", **AFTER)
        ax.axhline(0.0, color=FAINT, linewidth=0.8)
        ax.set_ylabel(f"{axis} [mm]")
        ax.set_xlim(*span)
    plots[-1].set_xlabel("time [s]")
    legend(figure, plots[0])
    return figure


def _span(times: Array) -> tuple[float, float]:
    """The middle of a recording."""
    middle, half = 0.5 * (times[0] + times[-1]), 0.5 * min(SHOWN_S, times[-1] - times[0])
    return float(middle - half), float(middle + half)


def _runs(phase: Integers) -> Iterator[tuple[int, int]]:
    edges = [0, *(np.flatnonzero(np.diff(phase)) + 1).tolist(), len(phase)]
    yield from zip(edges, edges[1:], strict=False)


def _shade(ax: Axes, t: Array, phase: Integers, span: tuple[float, float]) -> None:
    for first, last in _runs(phase):
        shade = SHADES.get(Phase(int(phase[first])))
        if shade and t[last - 1] > span[0] and t[first] < span[1]:
            ax.axvspan(t[first], t[min(last, len(t) - 1)], facecolor=shade, edgecolor="none", zorder=0)


def _patches(phase: Integers) -> list[Patch]:
    return [
        Patch(facecolor=SHADES[each], edgecolor=GRID, label=PHASE_NAMES[each])
        for each in (Phase.DOUBLE, Phase.LEFT, Phase.RIGHT)
        if (phase == each).any()
    ]
