# SPDX-License-Identifier: BSD-3-Clause
"""Channels of the monitor: names, units, nominal noise, and the kinds of support phases that show them.

`spring/JOINT`    motor - link - torque / k + (d / k) d(motor - link)/dt; torque measured, else from statics [rad]
`stiffness/JOINT`  component of that residual along the spring deflection by the measured torque in the phase [rad]
`torque/JOINT`    measured torque minus the torque that balances ground forces and weight [Nm]
`drag/JOINT`      mean of that residual along the displacement of the joint: friction, or a one-sided error [Nm]
`late/FOOT`       delay of the foot sensor against the joint torques, shrunk towards zero at low excitation [s]
`force/AXIS`      residual force: foot forces + weight - m a (monitor/forces.py), level axes, x of the support sole [N]
`moment/AXIS`     moment of the foot forces about the COM, in the support sole frame [Nm]
`feet/z, roll, pitch`  right sole in the frame of the left one in double support; zero on level ground [m, rad]
`feet/slide_x, slide_y`  displacement of the right sole against the left one during a double support [m]
`tilt/roll, pitch`  inclination of the support sole by IMU and kinematics; zero on level ground [rad]
`landing/z`       impulse of a landing beyond that of the load that the foot carries afterwards [Ns]
`unloaded/FOOT/AXIS`  reading of the sensor of the swing foot [N, Nm]
`plan/x, y`       COM by the motor positions minus the COM of com/reference (`reference: motor`) [m]
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

KINDS = ("left", "right", "double support after left", "double support after right", "standing")
LEFT, RIGHT, AFTER_LEFT, AFTER_RIGHT, STANDING = range(5)  # their indices
FLAT_SOLE_LAWS = ("torque", "drag", "force", "moment", "feet", "tilt")  # hold while the support sole lies flat
SPRING_LAWS = ("spring", "stiffness")  # hold for each spring alone, in any gait
WRENCH_LAWS = ("torque", "drag", "late", "force", "moment", "landing", "unloaded")  # depend on the foot wrenches
AXES = tuple(f"{kind}{axis}" for kind in "ft" for axis in "xyz")  # of a wrench
# Channels that do not depend on the joints, in this order after `spring` and `torque` of all joints.
COMMON = (
    *(f"{law}/{axis}" for law in ("force", "moment") for axis in "xyz"),
    *("feet/z", "feet/roll", "feet/pitch", "feet/slide_x", "feet/slide_y", "tilt/roll", "tilt/pitch"),
    *(f"unloaded/{foot}/{axis}" for foot in ("left", "right") for axis in AXES),
    *("plan/x", "plan/y", "landing/z"),
)


class Row(NamedTuple):
    """Nominal variability of a channel. Units: weights for N, weight times COM height for Nm, mass times m/s for Ns."""

    unit: str
    single: float  # noise: usual standard deviation of a phase mean from phase to phase, in single support
    double: float  # the same in double support
    by_robot: float  # standard deviation of the logarithm of the noise, from one robot to the next
    by_channel: float  # the same, from one channel of a law to another of the same robot
    drift: float  # standard deviation of the drift from one phase of a kind to the next, as a share of the noise
    robots: float  # standard deviation of the value from one nominal robot to the next; 0: not known
    by_load: float  # the same by the load of a spring, as a share of its deflection
    usual: float  # value that is usual for a robot
    usual_load: float  # deflection [rad] at which it is
    usual_slope: float  # of that value over the deflection


# Channels that not all kinds of phases show, by law or by law and foot.
_SHOWN_IN = {
    "force": (LEFT, RIGHT, STANDING),
    "feet": (AFTER_LEFT, AFTER_RIGHT, STANDING),
    "unloaded/left": (RIGHT,),
    "unloaded/right": (LEFT,),
    "landing": (AFTER_LEFT, AFTER_RIGHT),
    "stiffness": (LEFT, RIGHT, AFTER_LEFT, AFTER_RIGHT),
    "late/left": (LEFT, AFTER_LEFT, AFTER_RIGHT),
    "late/right": (RIGHT, AFTER_LEFT, AFTER_RIGHT),
}


def channel_names(joints: list[str]) -> tuple[str, ...]:
    """Names of the channels of a robot with these leg joints, those of the left leg first."""
    return (
        *(f"{law}/{joint}" for law in ("spring", "torque") for joint in joints),
        *COMMON,
        *(f"{law}/{joint}" for law in ("drag", "stiffness") for joint in joints),
        *("late/left", "late/right"),
    )


def law_of(name: str) -> str:
    """The law of a channel: the first part of its name."""
    return name.partition("/")[0]


def row_of(name: str, table: Iterable[str]) -> str:
    """The row for a channel in the section `monitor` of a file of nominal variability: its own, or that of its law."""
    law = law_of(name)
    return name if name in table else f"unloaded/{name[-2]}" if law == "unloaded" else law


def read_row(row: Mapping[str, Any]) -> Row:
    """A row of that section."""
    return Row(str(row["unit"]), *(float(row.get(name, 0.0)) for name in Row._fields[1:]))


def shown(names: tuple[str, ...]) -> NDArray[np.bool_]:
    """Whether a kind of phase shows a channel (kinds, n)."""
    out = np.ones((len(KINDS), len(names)), dtype=bool)
    for i, name in enumerate(names):
        kinds = _SHOWN_IN.get(law_of(name)) or _SHOWN_IN.get("/".join(name.split("/")[:2]))
        if kinds is not None:
            out[:, i] = np.isin(range(len(KINDS)), kinds)
    return out


def of_laws(names: tuple[str, ...], laws: tuple[str, ...]) -> NDArray[np.bool_]:
    """Which channels (n,) belong to these laws."""
    return np.array([law_of(name) in laws for name in names])
