# SPDX-License-Identifier: BSD-3-Clause
"""What `coman live` shows: predicted against measured COM, phase, rates, latency; on any terminal."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Group
from rich.table import Table
from rich.text import Text

from ...core.base.types import Array, Phase, Prediction
from ..interface.diagnostic_report import Level
from .listener import Listener

_SECONDS = 5.0
_SHOWN = {  # word and colour
    Level.OK: ("ok", "green"),
    Level.WARN: ("warning", "yellow"),
    Level.ERROR: ("ERROR", "red"),
    Level.STALE: ("stale", "magenta"),
}


class LiveView:
    """Collects predictions (in the listener's thread) and makes what is shown of them."""

    def __init__(self) -> None:
        self._recent: deque[tuple[int, Array, Array]] = deque(maxlen=20_000)  # stamp, model error, rigid error
        self.last: Prediction | None = None
        self.count = 0

    def add(self, prediction: Prediction) -> None:
        """Take a prediction in."""
        self.last = prediction
        self.count += 1
        rigid = prediction.measured_com - prediction.reference_com
        self._recent.append((prediction.stamp_ns, prediction.residual, rigid))
        while self._recent[0][0] < prediction.stamp_ns - _SECONDS * 1e9:
            self._recent.popleft()

    def rms_mm(self) -> tuple[Array, Array]:
        """RMS error of the model and of the rigid robot (3,), (3,) over the last seconds [mm]; NaN: unknown."""
        rows = [row for row in list(self._recent) if np.isfinite(row[1]).all() and np.isfinite(row[2]).all()]
        if not rows:
            return np.full(3, np.nan), np.full(3, np.nan)
        _, model, rigid = zip(*rows, strict=True)
        return _rms_mm(model), _rms_mm(rigid)

    def line(self, listener: Listener) -> str:
        """One line, for terminals that can do no more and for logs."""
        p = self.last
        if p is None:
            reports = sorted(listener.reports.items())
            return "; ".join(f"{name}: {report.message}" for name, report in reports) or "starting"
        model, rigid = self.rms_mm()
        robot = listener.report("virtual_robot: simulation").message
        return (
            f"{_phase(p):18s} measured {_mm(p.measured_com)} predicted {_mm(p.predicted_com)} mm, "
            f"RMS {_SECONDS:.0f} s: model {_triple(model)} rigid {_triple(rigid)} mm; robot: {robot}"
        )

    def panel(self, listener: Listener) -> Group:
        """Tables for a terminal."""
        p = self.last
        com = Table(box=SIMPLE_HEAD, title="COM in the support sole [mm]", title_justify="left")
        for name in ("", "x", "y", "z"):
            com.add_column(name, justify="left" if not name else "right")
        if p is not None:
            model, rigid = self.rms_mm()
            for name, values in (
                ("measured", 1e3 * p.measured_com),
                ("predicted", 1e3 * p.predicted_com),
                ("reference", 1e3 * p.reference_com),
                ("measured - predicted", 1e3 * p.residual),
                (f"RMS of the model, {_SECONDS:.0f} s", model),
                (f"RMS of a rigid robot, {_SECONDS:.0f} s", rigid),
            ):
                com.add_row(name, *(f"{value:.2f}" if np.isfinite(value) else "-" for value in values))
        nodes = Table(box=SIMPLE_HEAD, show_header=False)
        for name, report in sorted(listener.reports.items()):
            nodes.add_row(name, Text(*_SHOWN[report.level]), report.message[:90])
        rates = [f"{stream} {rate:.0f} Hz" for stream, rate in listener.report("predictor: input").rates().items()]
        phase = "waiting for predictions" if p is None else _phase(p)
        return Group(Text(phase, "bold"), com, nodes, Text(", ".join(rates), "dim"), Text("Ctrl-C stops", "dim"))


def _rms_mm(errors: Sequence[Array]) -> Array:
    return np.asarray(1e3 * np.sqrt(np.mean(np.square(errors), axis=0)))


def _phase(p: Prediction) -> str:
    names = {Phase.FLIGHT: "in the air", Phase.LEFT: "left support", Phase.RIGHT: "right support"}
    if p.support.phase != Phase.DOUBLE:
        return names[p.support.phase]
    share = p.support.left_share
    return "double support" + (f", left {100 * share:.0f} %" if share == share else "")


def _mm(com: Array) -> str:
    return _triple(1e3 * com)


def _triple(values: Array) -> str:
    return "(" + ", ".join(f"{value:.1f}" for value in values) + ")"
