# SPDX-License-Identifier: BSD-3-Clause
"""What the hooks of effects get and change: one sample, the springs of a leg, what pushes the robot."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..base.pose import LEVEL
from ..base.types import Array, Foot, Phase, Sample, SupportState
from ..robot.robot import Posture

STANDS = 1.0  # [s] after which a phase is part of no step


@dataclass(slots=True)
class LegSprings:
    """One loaded leg in joint space; effects change K_q, D_q and torque in place, before they are seen from the COM.

    The springs pull back with `torque + K_q d + D_q d'` for deflections d (link minus motor). A law that is not linear
    is given by its tangent: K_q its slope at `deflection`, torque what its value there is more than K_q deflection.
    Joints run from the hip to the ankle; n of them.
    """

    foot: Foot
    joints: tuple[str, ...]
    J: Array  # (6, n) velocity of the COM frame [linear; angular] by the joints, the sole held still, in sole axes
    K_q: Array  # (n, n) [Nm/rad]
    D_q: Array  # (n, n) [Nms/rad]
    torque: Array  # (n,) [Nm]
    com: Array  # (3,) COM in the sole frame [m]
    load: float  # [N] weight that the leg carries
    deflection: Array  # (n,) [rad] link minus motor now, of the free run
    rate: Array  # (n,) [rad/s]
    motor_rate: Array  # (n,) [rad/s] speed of the motors after the reduction; the links turn at motor_rate + rate


@dataclass(slots=True)
class Now:
    """One sample as the models see it; points in the frame of the support sole, which is LEFT or RIGHT."""

    sample: Sample
    support: SupportState
    dt: float  # [s] since the last sample; <= 0 or long at the first one
    link: Posture
    com: Array  # (3,) measured [m]
    com_vel: Array  # (3,) [m/s]
    zmp: Array | None  # (3,) measured [m]
    T_odom_sole: Array  # (4, 4)
    began_ns: int  # stamp at which the phase began, or, if that is the last one's, the time of the support foot
    stance: Foot  # of the last single support; NONE: there has been none
    down: Array  # (3,) direction of gravity in odom, as far as it is known
    tilt: Array  # (2,) measured roll and pitch of the trunk about x, y of the sole [rad]; NaN where no model needs it
    lifting: float  # [N] that a foot bears at most that lifts
    restarts: bool  # the free run begins again: a step ends

    @property
    def foot(self) -> Foot:
        """The support foot."""
        return self.support.support_foot

    @property
    def aslant(self) -> Array | None:
        """(3,) direction of gravity less that on level ground, in the axes of the sole; None: the ground is level."""
        return None if self.down is LEVEL else self.T_odom_sole[:3, :3].T @ (self.down - LEVEL)

    @property
    def standing(self) -> bool:
        """Whether the robot, on one foot or on both, has not stepped for longer than a step takes, or not at all."""
        return self.support.phase_time > STANDS or (self.stance == Foot.NONE and self.support.phase == Phase.DOUBLE)

    @property
    def landed(self) -> bool:
        """Whether the support foot is the one that has just landed, not the one of the last single support."""
        return self.stance not in (Foot.NONE, self.foot)


@dataclass(slots=True)
class Push:
    """What acts on the robot besides gravity and springs; effects add to force, moment and trunk."""

    posture: Posture  # of the model, not of the measurement
    R_odom_sole: Array  # (3, 3) orientation of the support sole, by the model
    force: Array = field(default_factory=lambda: np.zeros(3))  # at the COM of all links, support sole axes [N]
    moment: Array = field(default_factory=lambda: np.zeros(3))  # about the COM [Nm]; the point mass ignores it
    # Force [N] on the trunk, moment [Nm] about the origin of the URDF's root link, in its axes.
    trunk: Array = field(default_factory=lambda: np.zeros(6))
