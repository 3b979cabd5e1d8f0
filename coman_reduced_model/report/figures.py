# SPDX-License-Identifier: BSD-3-Clause
"""One function a figure: a Run in, a matplotlib Figure out. Positions in m, differences in mm, times in s.

Where the data for a figure do not exist, it raises NoData with the sentence that stands in its place.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.mlab import detrend_mean, psd
from matplotlib.patches import Polygon

from ..core.base.types import Array, Flags, Foot, Phase
from ..core.evaluation.run import Run
from ..core.evaluation.statistics import AXES
from .draw import FAINT, INK, SERIES, STYLES, legend, line, log_ticks, new_figure, phase_patches, shade, thin, title

DIRECTIONS = {"x": "x, forward", "y": "y, left", "z": "z, up"}
MEASURED, PREDICTED, REFERENCE = "measured", "predicted", "reference (rigid robot)"
_PAUSE_S = 0.25  # in which nothing was measured
_LABELS = {
    "published": "published",
    "model": "model alone",
    "planned": "planned",
    "persistence": "persistence",
    "lipm": "LIPM",
    "deflected": "deflected",
    "still": "still",
}


class NoData(Exception):
    """There is nothing to draw; the text says why."""


def com_over_time(run: Run, axes: str = "xyz") -> Figure:
    """Measured, predicted and reference COM in `odom`."""
    _need(run, run.measured, "no measured COM: no support phase was found")
    figure, plots = new_figure(len(axes), sharex=True)
    for ax, axis in zip(plots, axes, strict=True):
        _positions(ax, run, axis)
        ax.set_ylabel(f"{DIRECTIONS[axis]} [m]")
    _time_axis(plots[-1], run)
    legend(figure, _fullest(plots), phase_patches(run))
    return figure


def deflection(run: Run, axes: str = "xyz") -> Figure:
    """COM against its reference, as measured and as predicted, in the support sole: what a rigid robot gets wrong."""
    _need(run, run.deflection, "no reference COM: the deflection from it is not known")
    figure, plots = new_figure(len(axes), sharex=True)
    for ax, axis in zip(plots, axes, strict=True):
        _deflections(ax, run, axis)
        ax.set_ylabel(f"{DIRECTIONS[axis]} [mm]")
    _time_axis(plots[-1], run)
    legend(figure, _fullest(plots), phase_patches(run))
    return figure


def three_steps(run: Run, axes: str = "xz", count: int = 3) -> Figure:
    """Figs. 10 to 12 of the paper: predicted and measured COM over consecutive steps; beside it the deflection."""
    found = run.consecutive_steps(count)
    if found is None:
        raise NoData(f"The recording holds no {count} steps in a row (it has {len(run.steps())} complete steps).")
    part = run.slice(*found)
    _need(part, part.measured, "no measured COM in these steps")
    both = bool(np.isfinite(part.deflection).any())
    figure, plots = new_figure(len(axes), 1 + both, 0.7 + 2.3 * len(axes), sharex=True)
    for row, axis in enumerate(axes):
        ax = plots[row * (1 + both)]
        _positions(ax, part, axis)
        title(ax, f"COM, {DIRECTIONS[axis]}")
        ax.set_ylabel("[m]")
        if both:
            beside = plots[2 * row + 1]
            _deflections(beside, part, axis)
            title(beside, f"difference from the reference, {DIRECTIONS[axis]}")
            beside.set_ylabel("[mm]")
    for ax in plots[-1 - both :]:
        _time_axis(ax, part)
    legend(figure, _fullest(plots), phase_patches(part))
    return figure


def horizon_error(errors: Mapping[str, Mapping[str, Mapping[str, float | None]]]) -> Figure:
    """RMS error over the horizon, per axis, of what is published, of the model and of baselines.

    Args:
        errors: `horizon_rmse_m` of summary.json: by horizon [s], predictor and axis [m].
    """
    names = [
        name for name in _LABELS if any(_number(by[name].get(a)) for by in errors.values() if name in by for a in AXES)
    ]
    if "published" not in names:
        raise NoData("No horizon prediction was judged.")
    figure, plots = new_figure(1, 3, 3.1)
    markers = dict(zip(_LABELS, "osD^vPX", strict=True))
    for ax, axis in zip(plots, AXES, strict=True):
        for name in names:
            values = {float(h): by[name].get(axis) for h, by in errors.items()}
            known = [(h, 1e3 * value) for h, value in values.items() if value is not None and np.isfinite(value)]
            colour = SERIES[list(_LABELS).index(name)]
            width, size = (2.2, 7) if name == "published" else (1.3, 5)
            if known:
                x, y = zip(*known, strict=True)
                ax.plot(
                    x,
                    y,
                    color=colour,
                    marker=markers[name],
                    label=_LABELS[name],
                    linewidth=width,
                    markersize=size,
                )
        title(ax, DIRECTIONS[axis])
        ax.set_xlabel("horizon [s]")
        log_ticks(ax.yaxis)
        ax.set_xlim(left=0)
    plots[0].set_ylabel("RMS error [mm]")
    legend(figure, _fullest(plots))
    return figure


def top_view(run: Run, soles: Mapping[Foot, Sequence[float]]) -> Figure:
    """The COM from above in `odom`, with the soles where they carried.

    Args:
        run: what to draw.
        soles: x of the back and the front edge, y of the right and the left edge of each in its frame [m].
    """
    measured = run.in_odom(run.measured)
    _need(run, measured, "no measured COM: no support phase was found")
    corners = {
        foot: np.array([(x, y, 0, 1) for x, y in ((x1, y1), (x0, y1), (x0, y0), (x1, y0))])
        for foot, (x0, x1, y0, y1) in soles.items()
    }
    feet = [(foot, (T @ corners[foot].T)[:2].T) for foot, T in _footholds(run)]
    extent = np.concatenate([measured[np.isfinite(measured[:, 0]), :2], *(shape for _, shape in feet)])
    across, along = np.ptp(extent[:, 1]), np.ptp(extent[:, 0])
    figure, (ax,) = new_figure(1, 1, float(np.clip(1.3 + 8.4 * across / max(along, 1e-6), 2.6, 8.0)))
    for foot, shape in feet:
        colour = SERIES[2] if foot == Foot.LEFT else SERIES[4]
        ax.add_patch(Polygon(shape, facecolor=colour, edgecolor=colour, alpha=0.16, linewidth=1))
    for values, label in ((run.reference, REFERENCE), (run.predicted, PREDICTED), (run.measured, MEASURED)):
        points = run.in_odom(values)
        if np.isfinite(points).any():
            keep, _ = thin(np.arange(len(run), dtype=float), points[:, 1], run.breaks(), 1500)
            index = np.where(np.isnan(keep), 0, keep).astype(int)
            path = np.where(np.isnan(keep)[:, None], np.nan, points[index, :2])
            ax.plot(path[:, 0], path[:, 1], label=label, **STYLES[label.split()[0]])
    # As wide as what was measured: a prediction that diverges must not shrink it.
    middle, half = (extent.max(axis=0) + extent.min(axis=0)) / 2, np.ptp(extent, axis=0) / 2 + 0.02
    width, height = figure.get_size_inches() - (1.2, 1.3)  # about what the axes get
    scale = max(half[0] / width, half[1] / height)
    ax.set(xlim=middle[0] + scale * width * np.array((-1, 1)), ylim=middle[1] + scale * height * np.array((-1, 1)))
    ax.set_aspect("equal", adjustable="box")
    ax.set_xlabel("x in odom [m]")
    ax.set_ylabel("y in odom [m]")
    legend(figure, ax)
    for foot, name in ((Foot.LEFT, "left sole"), (Foot.RIGHT, "right sole")):
        first = next((shape for side, shape in feet if side == foot), None)
        if first is not None:
            ax.annotate(name, first.mean(axis=0), ha="center", va="center", color=INK, fontsize=9)
    return figure


def load_share(run: Run) -> Figure:
    """Share of the vertical force on the left foot, over the phases found from it."""
    if not np.isfinite(run.left_share).any():
        raise NoData("No wrenches: the load on the feet is not known.")
    figure, (ax,) = new_figure(1, 1, 2.4)
    shade(ax, run)
    paused = np.diff(run.time, prepend=run.time[:1]) > _PAUSE_S
    ax.plot(*thin(run.time, run.left_share, paused), color=INK, linewidth=1.2)
    ax.set_ylim(-0.05, 1.05)
    ax.set_yticks([0, 0.5, 1], ["all right", "equal", "all left"])
    _time_axis(ax, run)
    legend(figure, ax, phase_patches(run))
    return figure


def by_cycle(run: Run) -> Figure:
    """Errors over the step, all steps laid on each other: median and the middle 80 %, by axis and support foot."""
    steps = run.steps()
    if len(steps) < 2:
        raise NoData(f"Too few complete steps to compare them ({len(steps)}).")
    feet = [foot for foot in (Foot.LEFT, Foot.RIGHT) if any(step.foot == foot for step in steps)]
    figure, plots = new_figure(len(feet), 3, 0.7 + 2.3 * len(feet), sharex=True, sharey="col")
    percent = np.linspace(0.0, 100.0, 101)
    for row, foot in enumerate(feet):
        own = [step for step in steps if step.foot == foot]
        plots[3 * row].set_ylabel(f"{foot.name.lower()} foot, {len(own)} steps\nmeasured - predicted [mm]")
        lifts = [_lift(run, step.first, step.last) for step in own]
        for column, axis in enumerate(AXES):
            ax = plots[3 * row + column]
            for values, label, colour, dashes in (
                (run.deflection, "rigid robot", SERIES[1], (0, (1.2, 1.2))),
                (run.residual, "this model", SERIES[0], "-"),
            ):
                laid = np.array([_laid(run, values[:, column], step.first, step.last, percent) for step in own])
                laid = laid[np.isfinite(laid).any(axis=1)]
                if not len(laid):
                    continue
                low, middle, high = np.percentile(laid, (10, 50, 90), axis=0) * 1e3
                ax.fill_between(percent, low, high, color=colour, alpha=0.18, linewidth=0)
                ax.plot(percent, middle, color=colour, linestyle=dashes, linewidth=1.6, label=label)
            ax.axhline(0, color=FAINT, linewidth=0.8)
            ax.axvspan(0, float(np.median(lifts)), facecolor="#e4e7ee", edgecolor="none", zorder=0)
            title(ax, DIRECTIONS[axis])
            ax.set_xlim(0, 100)
    for ax in plots[-3:]:
        ax.set_xlabel("of the step [%]")
    legend(figure, _fullest(plots), [patch for patch in phase_patches(run) if patch.get_label() == "double support"])
    return figure


def spectrum(run: Run) -> Figure:
    """Amplitude spectral density of what the model and the rigid robot leave unexplained, per axis."""
    steps = np.diff(run.time)
    ends = [0, *(np.flatnonzero((steps <= 0.0) | (steps > _PAUSE_S)) + 1).tolist(), len(run)]
    whole = slice(*max(pairwise(ends), key=lambda run: run[1] - run[0]))  # the longest stretch without a pause
    time = run.time[whole]
    dt = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    if dt <= 0.0 or time[-1] - time[0] < 4.0:
        raise NoData("Too short for a spectrum (4 s without a pause are needed).")
    figure, plots = new_figure(1, 3, 3.1, sharex=True)
    grid = np.arange(time[0], time[-1], dt)
    drawn = False
    for values, label, colour, dashes in (
        (run.deflection[whole], "rigid robot", SERIES[1], (0, (1.2, 1.2))),
        (run.residual[whole], "this model", SERIES[0], "-"),
    ):
        known = np.isfinite(values).all(axis=1)
        if known.mean() < 0.9:  # filling longer gaps would invent a spectrum
            continue
        for column, ax in enumerate(plots):
            filled = np.interp(grid, time[known], values[known, column]) * 1e3
            window = min(len(filled), round(4.0 / dt))
            power, frequency = map(np.asarray, psd(filled, window, 1.0 / dt, detrend_mean, noverlap=window // 2))
            use = (frequency > 0) & (frequency <= 25.0) & (power > 0)
            if use.any():
                ax.plot(frequency[use], np.sqrt(power[use]), color=colour, linestyle=dashes, linewidth=1.3, label=label)
                drawn = True
    if not drawn:
        raise NoData("Too little was predicted for a spectrum (90 % of the samples are needed).")
    for ax, axis in zip(plots, AXES, strict=True):
        log_ticks(ax.xaxis)
        log_ticks(ax.yaxis)
        title(ax, DIRECTIONS[axis])
        ax.set_xlabel("frequency [Hz]")
    plots[0].set_ylabel("error [mm/√Hz]")
    legend(figure, _fullest(plots))
    return figure


def heat_map(values: Array, rows: Sequence[str], columns: Sequence[str], label: str, digits: int = 1) -> Figure:
    """A table as colours with its numbers in the cells; NaN cells are left empty and say n/a."""
    if not np.isfinite(values).any():
        raise NoData(f"No values of {label}.")
    figure, (ax,) = new_figure(1, 1, 1.4 + 0.36 * len(rows))
    high = float(np.nanmax(values))
    image = ax.imshow(np.ma.masked_invalid(values), aspect="auto", cmap="cividis")
    for (i, j), value in np.ndenumerate(values):
        known = np.isfinite(value)
        middle = (high + float(np.nanmin(values))) / 2
        colour = FAINT if not known else "#111111" if value > middle else "#fefefe"  # not the page's own ink
        ax.text(j, i, f"{value:.{digits}f}" if known else "n/a", ha="center", va="center", color=colour, fontsize=9.5)
    ax.set_xticks(range(len(columns)), columns)
    ax.set_yticks(range(len(rows)), rows)
    ax.grid(False)
    figure.colorbar(image, ax=ax, label=label)
    return figure


def _positions(ax: Axes, run: Run, axis: str) -> None:
    column = AXES.index(axis)
    shade(ax, run)
    for values, label in ((run.reference, REFERENCE), (run.measured, MEASURED), (run.predicted, PREDICTED)):
        line(ax, run, run.in_odom(values)[:, column], label)


def _deflections(ax: Axes, run: Run, axis: str) -> None:
    column = AXES.index(axis)
    shade(ax, run)
    line(ax, run, np.where(np.isfinite(run.reference[:, column]), 0.0, np.nan), REFERENCE)
    line(ax, run, 1e3 * run.deflection[:, column], MEASURED)
    line(ax, run, 1e3 * run.predicted_deflection[:, column], PREDICTED)
    resets = (run.flags & Flags.RESET) != 0
    level = 1e3 * run.predicted_deflection[resets, column]
    if 0 < resets.sum() <= 200:
        ax.plot(run.time[resets], level, "o", color=STYLES["predicted"]["color"], markersize=4)


def _time_axis(ax: Axes, run: Run) -> None:
    ax.set_xlabel("time [s]")
    if len(run) > 1:
        ax.set_xlim(run.time[0], run.time[-1])


def _need(run: Run, values: Array, otherwise: str) -> None:
    if not len(run) or not np.isfinite(values).any():
        raise NoData(otherwise[0].upper() + otherwise[1:] + ".")


def _fullest(plots: Sequence[Axes]) -> Axes:
    return max(plots, key=lambda ax: len(ax.get_legend_handles_labels()[0]))


def _number(value: float | None) -> bool:
    return value is not None and bool(np.isfinite(value))


def _footholds(run: Run) -> list[tuple[Foot, Array]]:
    """Each place that a sole carried at, once: foot and pose (4, 4)."""
    found: list[tuple[Foot, Array]] = []
    edges = [0, *(np.flatnonzero(np.diff(run.foot)) + 1).tolist(), len(run)]
    for first, last in zip(edges, edges[1:], strict=False):
        T = run.T_odom_sole[(first + last) // 2]
        foot = Foot(int(run.foot[first]))
        near = any(f == foot and np.linalg.norm(P[:2, 3] - T[:2, 3]) < 0.01 for f, P in found)
        if foot and np.isfinite(T).all() and not near:
            found.append((foot, T))
    return found


def _lift(run: Run, first: int, last: int) -> float:
    """Where in a step its single support begins [%]."""
    begin = first + int(np.argmax(run.phase[first:last] != Phase.DOUBLE))
    return float(100.0 * (run.time[begin] - run.time[first]) / (run.time[last - 1] - run.time[first]))


def _laid(run: Run, values: Array, first: int, last: int, percent: Array) -> Array:
    time = run.time[first:last]
    known = np.isfinite(values[first:last])
    if known.mean() < 0.9:
        return np.full(len(percent), np.nan)
    share = 100.0 * (time - time[0]) / (time[-1] - time[0])
    return np.interp(percent, share[known], values[first:last][known])
