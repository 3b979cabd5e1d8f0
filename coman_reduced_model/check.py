# SPDX-License-Identifier: BSD-3-Clause
"""What a recording holds and what looks wrong in it, in a few lines: before anything is predicted or diagnosed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from .bag.session import Session
from .core.base.types import Phase
from .core.evaluation.statistics import RunStatistics
from .progress import Progress

_IN_THE_AIR = 0.95  # of the time: no robot flies for so long


@dataclass(frozen=True)
class Checked:
    """A recording that has been gone through.

    Attributes:
        robot: name, mass [kg], joints of the legs and joints that no message lists, that the URDF lacks,
            and that follow others (<mimic>).
        streams: by name, as in `summary.json`.
        weight: mean of the vertical forces of both feet over the robot's weight; None without wrenches.
        phases: seconds in each support phase.
        seconds: of the recording that samples cover.
        rejected: messages by stream and reason, each with the last sentence.
        wrench_source: whether wrenches are measured (sensors) or computed from torques or contacts.
        wrong: what looks wrong and what to look at, a sentence for each cause.
    """

    robot: dict[str, Any]
    streams: dict[str, Any]
    weight: float | None
    phases: dict[str, float]
    seconds: float
    rejected: dict[str, tuple[int, str]]
    wrong: tuple[str, ...]
    wrench_source: str = "sensors"


def check_bag(session: Session, progress: Progress | None = None) -> Checked:
    """Go through a recording as a prediction would, without predictions ahead.

    Raises:
        BagError: the recording cannot be read.
    """
    statistics = RunStatistics(session.config.streams.restart_gap)
    for prediction in session.predictions(progress):
        statistics.add(prediction)
    run, status, robot = statistics.summary(), session.pipeline.status(), session.robot
    unlisted, wrong = set(status.unlisted_joints), list(session.warnings)
    if not wrong and run["phases_s"].get(Phase.FLIGHT.name, 0.0) > _IN_THE_AIR * run["duration_s"]:
        wrong.append("wrenches: by them neither foot carries the robot: not connected, or does it hang in the air?")
    if seen := sorted(unlisted & set(robot.mimic_joints)):
        wrong.append(
            f"joint_states: without {', '.join(seen)}, which <mimic> other joints in the URDF: held at zero, for "
            "the model does not use <mimic>"
        )
    return Checked(
        robot={
            "name": session.config.robot.name,
            "mass_kg": robot.mass,
            "leg_joints": [*robot.config.leg_joints],
            "joints": len(robot.joint_names),
            "unlisted": sorted(unlisted),
            "unknown": sorted(status.extra_joints),
            "mimic": sorted(robot.mimic_joints),
        },
        streams={
            name: {
                "received": each.received,
                "rate_hz": each.rate_hz,
                "needed": each.expected,
            }
            for name, each in status.streams.items()
        },
        weight=session.pipeline.plausibility.carried,
        phases={phase.name: run["phases_s"].get(phase.name, 0.0) for phase in Phase},
        seconds=run["duration_s"],
        rejected={reason: (count, status.last_rejection[reason]) for reason, count in status.rejected.items()},
        wrong=tuple(wrong),
        wrench_source=session.config.streams.wrench_source,
    )
