# SPDX-License-Identifier: BSD-3-Clause
"""What the predictor drives: an equation of motion with a free run and predictions ahead.

`PointMass` (the paper), `Pendulum` (`reference: none`) and `TrunkModel` (effect `trunk_rotation`) are three.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

import numpy as np

from ..base.types import Array, Flags, Foot, Sample, SupportState
from ..robot.robot import Posture


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
    landed: bool  # the support foot is the one that has just landed, not the one of the last single support

    @property
    def foot(self) -> Foot:
        """The support foot."""
        return self.support.support_foot


@dataclass(slots=True)
class Push:
    """What acts on the robot besides gravity and springs; effects add to force, moment and trunk."""

    posture: Posture  # of the model, not of the measurement
    R_odom_sole: Array  # (3, 3) orientation of the support sole, by the model
    force: Array = field(default_factory=lambda: np.zeros(3))  # at the COM of all links, support sole axes [N]
    moment: Array = field(default_factory=lambda: np.zeros(3))  # about the COM [Nm]; the point mass ignores it
    # Force [N] on the trunk, moment [Nm] about the origin of the URDF's root link, in its axes.
    trunk: Array = field(default_factory=lambda: np.zeros(6))


class Dynamics(ABC):
    """One model of the robot: call `prepare` for each sample, then what the free run needs, then `ahead`.

    Attributes:
        reference, reference_vel: (3,) COM of the rigid robot at the last sample [m], [m/s]; NaN if there is none.
        state: (6,) COM and velocity of the free run in the support sole; None while there is none.
        tilt: (2,) roll and pitch of the trunk in the free run [rad]; NaN if the model knows none.
        flags: what else is to be said of the last sample.
    """

    def __init__(self) -> None:
        self.reference = self.reference_vel = np.full(3, np.nan)
        self.state: Array | None = None
        self.tilt = np.full(2, np.nan)
        self.flags = Flags.OK

    @abstractmethod
    def prepare(self, now: Now) -> bool:
        """Set up the equation of motion at this sample; False if an input of it is missing."""

    @abstractmethod
    def switch(self, now: Now, T_odom_sole: Array) -> None:
        """The support changed; tell the free run in the new sole, T_odom_sole (4, 4) being the pose of the old one.

        The predicted COM in odom stays continuous. May end the free run (state None).
        """

    @abstractmethod
    def restart(self, now: Now) -> None:
        """Begin the free run from the measurement."""

    @abstractmethod
    def advance(self, now: Now) -> None:
        """Bring the free run to this sample, by plan or motors, support phase and switching times alone."""

    @abstractmethod
    def ahead(self, now: Now, horizons: Array) -> Array:
        """COM (k, 3) [m] at horizons (k,) ascending [s] from the measured state."""

    def stop(self) -> None:
        """End the free run: an input is missing."""
        self.state = None

    def reset(self) -> None:
        """Forget the past."""
        self.stop()
