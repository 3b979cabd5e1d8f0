# SPDX-License-Identifier: BSD-3-Clause
"""The configuration of a robot: frames, legs and their series springs."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..base.parameter import par


@dataclass(frozen=True)
class LegConfig:
    """One leg: its chain of joints and the series springs in them."""

    sole_frame: str = par("", "", "URDF frame of the sole: x forward, z up, origin on the ground")
    joints: tuple[str, ...] = par(
        (), "", "joints of the leg from the hip to the ankle; left out: those that move its sole alone", kind="strs"
    )
    stiffness: tuple[float, ...] = par((), "Nm/rad", "series stiffness of each joint, in the same order", 1e-3, 1e7)
    damping: tuple[float, ...] = par((), "Nms/rad", "damping of each joint, in the same order", 0.0, 1e5)


@dataclass(frozen=True)
class RobotConfig:
    """Which robot it is: a URDF and the legs in it."""

    name: str = par("coman", "", "name for titles and reports")
    urdf: str = par("", "", "URDF file, relative to this file; empty: the robot_description of bag or topic")
    base_frame: str = par(
        "base_link", "", "URDF frame of the trunk, in which loads on it are; any link that is on no leg"
    )
    left: LegConfig = field(
        default_factory=lambda: LegConfig(
            "l_sole",
            ("LHipSag", "LHipLat", "LHipYaw", "LKneeSag", "LAnkSag", "LAnkLat"),
            (3000.0, 3500.0, 2500.0, 180.0, 200.0, 3000.0),
            (12.0, 12.0, 8.0, 4.0, 4.0, 8.0),
        )
    )
    right: LegConfig = field(
        default_factory=lambda: LegConfig(
            "r_sole",
            ("RHipSag", "RHipLat", "RHipYaw", "RKneeSag", "RAnkSag", "RAnkLat"),
            (3000.0, 3500.0, 2500.0, 180.0, 200.0, 3000.0),
            (12.0, 12.0, 8.0, 4.0, 4.0, 8.0),
        )
    )
    foot_length: float = par(0.2, "m", "length of the sole, where the URDF has no shapes of the foot", 0.01, 1.0)
    foot_width: float = par(0.1, "m", "width of the sole, likewise", 0.01, 1.0)
    gravity: float = par(9.81, "m/s^2", "acceleration of gravity", 0.1, 30.0)

    @property
    def leg_joints(self) -> tuple[str, ...]:
        """Names of the joints of the left leg, then of the right one."""
        return (*self.left.joints, *self.right.joints)
