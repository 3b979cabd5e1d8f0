# SPDX-License-Identifier: BSD-3-Clause
"""How every figure looks: colours, lines thinned to what a screen shows, shaded phases, export to SVG and PNG.

Figures are made without pyplot: no global state, no window, nothing to close.
"""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import XAxis, YAxis
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator, NullLocator

from ..core.base.types import Array, Booleans, Phase
from ..core.evaluation.run import Run

# Okabe and Ito's palette, safe for colour-blind readers; every series differs in its dashes or markers as well.
INK, FAINT, GRID = "#1a1c21", "#5b606b", "#d9dce3"
STYLES: dict[str, dict[str, Any]] = {
    "measured": {"color": INK, "linewidth": 1.5},
    "predicted": {"color": "#d55e00", "linewidth": 1.5, "linestyle": (0, (5, 1.2))},
    "reference": {"color": "#0072b2", "linewidth": 1.3, "linestyle": (0, (1.2, 1.2))},
}
SERIES = (STYLES["predicted"]["color"], STYLES["reference"]["color"], "#009e73", "#cc79a7", "#e69f00", FAINT, "#56b4e9")
SHADES = {Phase.DOUBLE: "#e4e7ee", Phase.LEFT: "#ffffff", Phase.RIGHT: "#fdf3dd", Phase.FLIGHT: "#f7d9d9"}
PHASE_NAMES = {
    Phase.DOUBLE: "double support",
    Phase.LEFT: "left support",
    Phase.RIGHT: "right support",
    Phase.FLIGHT: "no support",
}

# On the page, each colour is a variable, so that the dark scheme can change it; the fall-back serves a lone SVG.
VARIABLES = {
    INK: "--ink",
    FAINT: "--faint",
    GRID: "--grid",
    "#d55e00": "--predicted",
    "#0072b2": "--reference",
    "#009e73": "--third",
    "#cc79a7": "--fourth",
    "#e69f00": "--fifth",
    "#e4e7ee": "--double",
    "#fdf3dd": "--right",
    "#f7d9d9": "--flight",
    "#ffffff": "--paper",
}

_POINTS = 1200  # buckets a line: a pixel wide on a wide screen, each with its minimum and maximum
_RC: Any = {
    "font.family": "sans-serif",
    "font.size": 10.5,
    "axes.edgecolor": FAINT,
    "axes.labelcolor": INK,
    "axes.grid": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.formatter.useoffset": False,
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "text.color": INK,
    "xtick.color": FAINT,
    "ytick.color": FAINT,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "legend.frameon": False,
    "legend.fontsize": 10,
    "lines.solid_capstyle": "butt",
    "svg.fonttype": "none",
    "svg.hashsalt": "coman",  # the same data give the same page
    "path.simplify": True,
    "path.simplify_threshold": 0.2,
}


def new_figure(rows: int, columns: int = 1, height: float = 0.0, **options: Any) -> tuple[Figure, list[Axes]]:
    """A figure of the page's width with axes, row by row.

    Args:
        rows, columns: of axes.
        height: of the whole [inch]; 0: 1.9 a row.
        options: for `Figure.subplots`.
    """
    with mpl.rc_context(_RC):
        figure = Figure(figsize=(9.6, height or 0.6 + 1.9 * rows), layout="constrained", facecolor="#ffffff")
        axes = figure.subplots(rows, columns, squeeze=False, **options)
        for ax in axes.flat:
            ax.set_axisbelow(True)
            ax.set_facecolor("#ffffff")
    return figure, list(axes.flat)


def thin(x: Array, y: Array, breaks: Booleans | None = None, points: int = _POINTS) -> tuple[Array, Array]:
    """A line with at most a few points a pixel, that keeps every peak; NaN between stretches that don't join.

    Args:
        x, y: (n,).
        breaks: (n,) whether the line must not come from the point before.
        points: buckets over the whole line.
    """
    n = len(x)
    known = np.isfinite(y) & np.isfinite(x)
    starts = known.copy()
    if n > 1:
        starts[1:] &= ~known[:-1] if breaks is None else (~known[:-1] | breaks[1:])
    keep = starts.copy()
    keep[:-1] |= known[:-1] & ~known[1:]
    if breaks is not None:
        keep[:-1] |= breaks[1:] & known[:-1]
    keep[-1:] |= known[-1:]
    if known.sum() <= 2 * points:
        keep |= known
    else:
        bucket = np.minimum(np.arange(n) * points // n, points - 1)[known]
        index = np.flatnonzero(known)
        order = np.lexsort((y[index], bucket))
        edges = np.flatnonzero(np.diff(bucket[order])) + 1
        keep[index[order[np.concatenate(([0], edges))]]] = True
        keep[index[order[np.concatenate((edges - 1, [len(order) - 1]))]]] = True
    chosen = np.flatnonzero(keep)
    gaps = np.flatnonzero(starts[chosen])[1:]
    return np.insert(x[chosen], gaps, np.nan), np.insert(y[chosen], gaps, np.nan)


def title(ax: Axes, text: str) -> None:
    """What an axes shows, above it."""
    ax.set_title(text, loc="left", fontsize=10.5, fontweight="bold")


def log_ticks(axis: XAxis | YAxis) -> None:
    """A logarithmic scale with plain numbers at 1, 2, 5 of each decade (at 1 alone over many decades)."""
    axis.axes.set(**{f"{axis.axis_name}scale": "log"})
    low, high = axis.get_data_interval()
    wide = not 0.0 < low < high or high / low > 500.0
    axis.set_major_locator(LogLocator(subs=(1.0,) if wide else (1.0, 2.0, 5.0)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_locator(NullLocator())


def shade(ax: Axes, run: Run) -> None:
    """Colour the background by support phase."""
    times = np.append(run.time, run.time[-1:])
    for first, last, phase in run.phases():
        if phase != Phase.LEFT:  # left support is the paper itself
            ax.axvspan(times[first], times[last], facecolor=SHADES[phase], edgecolor="none", zorder=0)


def phase_patches(run: Run) -> list[Patch]:
    """Legend entries for the phases that occur."""
    present = {phase for _, _, phase in run.phases()}
    return [
        Patch(facecolor=SHADES[phase], edgecolor=GRID, label=PHASE_NAMES[phase])
        for phase in (Phase.DOUBLE, Phase.LEFT, Phase.RIGHT, Phase.FLIGHT)
        if phase in present
    ]


def line(ax: Axes, run: Run, values: Array, label: str, broken: bool = True) -> None:
    """One series over the time of a run, in the style of its label; nothing where it has no value."""
    if np.isfinite(values).any():
        x, y = thin(run.time, values, run.breaks() if broken else None)
        ax.plot(x, y, label=label, **STYLES[label.split()[0]])


def legend(figure: Figure, ax: Axes, extra: list[Patch] | None = None) -> None:
    """One legend above everything, so that it hides no data."""
    handles, _ = ax.get_legend_handles_labels()
    handles += extra or []
    if handles:
        with mpl.rc_context(_RC):
            figure.legend(handles=handles, loc="outside upper left", ncols=min(len(handles), 6), frameon=False)


@dataclass(frozen=True)
class Drawing:
    """A drawn figure, as the page takes it."""

    name: str
    svg: str  # inline, colours as CSS variables
    alt: str


def draw(name: str, figure: Figure, alt: str, folder: Path | None = None) -> Drawing:
    """Export a figure: SVG for the page, and `NAME.png` into the folder if one is given."""
    buffer = io.StringIO()
    with mpl.rc_context(_RC):
        engine = figure.get_layout_engine()
        if engine is not None:  # once for both files; else each of them draws everything twice
            engine.execute(figure)
            figure.set_layout_engine(None)
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
        if folder is not None:
            figure.savefig(folder / f"{name}.png", format="png", dpi=110)
    return Drawing(name, inline(buffer.getvalue(), name, VARIABLES), alt)


def inline(svg: str, name: str, variables: Mapping[str, str]) -> str:
    """An SVG of matplotlib's for use within HTML: no prologue, own ids, own fonts, colours as variables."""
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.S)
    svg = re.sub(r'<svg [^>]*viewBox="([^"]*)"[^>]*>', r'<svg viewBox="\1" aria-hidden="true">', svg, count=1)
    svg = re.sub(r'\bid="([^"]+)"', rf'id="{name}-\1"', svg)
    svg = re.sub(r"url\(#([^)]+)\)", rf"url(#{name}-\1)", svg)
    svg = re.sub(r'xlink:href="#([^"]+)"', rf'href="#{name}-\1"', svg)
    svg = re.sub(r"font: ([^;\"']*?)([\d.]+px) [^;\"]*", r"font: \1\2 var(--font)", svg)
    return re.sub(r"(fill|stroke): (#[0-9a-f]{6})", lambda m: f"{m[1]}: {_variable(m[2], variables)}", svg, flags=re.I)


def _variable(colour: str, variables: Mapping[str, str]) -> str:
    name = variables.get(colour.lower())
    return f"var({name})" if name else colour
