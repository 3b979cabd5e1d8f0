# SPDX-License-Identifier: BSD-3-Clause
"""The picture of the README: what springs do to the COM of a walk, and what the models say of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from rosbags.highlevel import AnyReader


def draw(default: Path, paper: Path, target: Path) -> None:
    """What springs do to the COM, and what the models say of it: 4 s in mid-walk, deflection from the motors' COM."""
    curves = {}
    for name, folder in (("default", default), ("paper", paper)):
        curves[name] = deflections(folder / "predictions")
    figure = Figure((9.0, 4.2), layout="constrained")
    axes = figure.subplots(2, 1, sharex=True)
    for axis, column, direction in zip(axes, (0, 2), ("fore-aft x", "vertical z"), strict=True):
        times, measured, predicted = curves["default"]
        shown = (times > 4.0) & (times < 8.0)
        axis.plot(times[shown], measured[shown, column], color="#1a1c21", linewidth=1.8, label="measured")
        axis.plot(times[shown], predicted[shown, column], "--", color="#d55e00", linewidth=1.6, label="default model")
        times, _, predicted = curves["paper"]
        shown = (times > 4.0) & (times < 8.0)
        axis.plot(
            times[shown], predicted[shown, column], ":", color="#0072b2", linewidth=1.4, label="the paper's model"
        )
        axis.axhline(0.0, color="#5b606b", linewidth=0.8, label="rigid robot")
        axis.set_ylabel(f"{direction} [mm]")
        axis.grid(color="#d9dce3", linewidth=0.6)
    limit = np.nanmax(np.abs(measured[:, 0]))
    axes[0].set_ylim(-2.2 * limit, 2.2 * limit)
    axes[1].set_xlabel("time [s]")
    axes[0].legend(ncols=4, fontsize="small", loc="upper center")
    figure.suptitle("COM against where the motors, without springs, would put it (bags/test2)", fontsize="medium")
    figure.savefig(target, dpi=110, metadata={"Software": None})


def deflections(bag: Path) -> tuple[Any, Any, Any]:
    """Time (n,) [s], measured and predicted minus reference COM (n, 3) [mm] of a bag of predictions."""
    times, measured, predicted = [], [], []
    with AnyReader([bag]) as reader:
        chosen = [connection for connection in reader.connections if connection.topic == "/com/prediction"]
        for connection, stamp, raw in reader.messages(chosen):
            message = reader.deserialize(raw, connection.msgtype)
            reference, found, said = (
                np.array([point.x, point.y, point.z])
                for point in (message.reference_position, message.measured_position, message.predicted_position)
            )
            times.append(stamp)
            measured.append(1e3 * (found - reference))
            predicted.append(1e3 * (said - reference))
    return (np.array(times) - times[0]) * 1e-9, np.array(measured), np.array(predicted)
