# SPDX-License-Identifier: BSD-3-Clause
"""What the predictor drives: an equation of motion with a free run and predictions ahead.

`PointMass` (the paper), `Pendulum` (`reference: none`) and `TrunkModel` (option `trunk_rotation`) are three.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from ..base.types import Array, Flags
from ..effects.hooks import Now
from .reference import Plan


class Dynamics(ABC):
    """One model of the robot: call `prepare` for each sample, then what the free run needs, then `ahead`.

    Attributes:
        reference, reference_vel: (3,) COM of the rigid robot at the last sample [m], [m/s]; NaN if there is none.
        state: (6,) COM and velocity of the free run in the support sole; None while there is none.
        tilt: (2,) roll and pitch of the trunk in the free run [rad]; NaN if the model knows none.
        flags: what else is to be said of the last sample.
        lag_ns: how long ago it was where it is now, in the stride before, from which what is said ahead follows;
            0: it repeats none.
        stepping: else: what is said ahead follows from how the plan moves COM and feet.
    """

    def __init__(self) -> None:
        self.reference = self.reference_vel = np.full(3, np.nan)
        self.state: Array | None = None
        self.tilt = np.full(2, np.nan)
        self.flags = Flags.OK
        self.lag_ns, self.stepping = 0, False

    @property
    def repeating(self) -> bool:
        """Whether what is said ahead follows from the last stride."""
        return self.lag_ns > 0

    @property
    def aslant_landings(self) -> int:
        """How many feet landed on ground that is not known, as far as the model looks at landings."""
        return 0

    @abstractmethod
    def prepare(self, now: Now) -> bool:
        """Set up the equation of motion at this sample; False if an input of it is missing."""

    @abstractmethod
    def switch(self, now: Now, T_odom_sole: Array) -> None:
        """The support changed; express the free run in the new sole, T_odom_sole (4, 4) being the pose of the old one.

        The predicted COM in odom stays continuous. May end the free run (state None).
        """

    @abstractmethod
    def restart(self, now: Now) -> None:
        """Begin the free run from the measurement."""

    @abstractmethod
    def advance(self, now: Now) -> None:
        """Bring the free run to this sample, by plan or motors, support phase and switching times alone."""

    @abstractmethod
    def ahead(self, now: Now, com: Array, com_vel: Array, plan: Plan, horizons: Array) -> Array:
        """COM (k, 3) [m] at horizons (k,) ascending [s], from COM and velocity (3,) as they are now [m], [m/s]."""

    def deflections(self, now: Now, horizons: int) -> Array:
        """Deflections now and at the horizons of the last `ahead`, (1 + k, 3 + m); NaN: the model does not know.

        Of the COM in the axes of the support sole [m] and of the m joints of the legs [rad], the left leg's first.
        """
        out = np.full((1 + horizons, 3 + sum(len(leg) for leg in now.link.robot.legs.values())), np.nan)
        out[0, :3] = now.com - self.reference
        return out

    def stop(self) -> None:
        """End the free run: an input is missing."""
        self.state = None

    def reset(self) -> None:
        """Forget the past."""
        self.stop()
