# SPDX-License-Identifier: BSD-3-Clause
"""The series springs of both legs in joint space: constants of the configuration, and what effects make of them.

Both models take their springs from here, so that an effect on a spring is written once.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np

from ..base.types import Array, Foot
from ..effects.catalogue import Effect
from ..effects.hooks import LegSprings
from ..robot.configuration import RobotConfig


class Springs:
    """What the configuration says of both legs, and the effects on it.

    Attributes:
        stiffness, damping: (n,) nominal of the joints of each leg [Nm/rad], [Nms/rad].
        matrices: the same as diagonal matrices (n, n).
        nominal: whether no effect acts on them.
        gravity_stiffness: whether gravity changes the stiffness; each model adds that to its own springs.
    """

    def __init__(self, config: RobotConfig, effects: Sequence[Effect], gravity_stiffness: bool) -> None:
        # Most effects leave the springs alone: calling them for nothing would cost time at the rate of the sensors.
        self._effects = [e for e in effects if type(e).springs is not Effect.springs]
        self.stiffness = {Foot.LEFT: np.array(config.left.stiffness), Foot.RIGHT: np.array(config.right.stiffness)}
        self.damping = {Foot.LEFT: np.array(config.left.damping), Foot.RIGHT: np.array(config.right.damping)}
        self.nominal = not self._effects
        self.gravity_stiffness = gravity_stiffness
        self._joints = {Foot.LEFT: config.left.joints, Foot.RIGHT: config.right.joints}
        self.matrices = {
            foot: (np.diag(self.stiffness[foot]), np.diag(self.damping[foot])) for foot in (Foot.LEFT, Foot.RIGHT)
        }

    def of_effects(self, effects: Sequence[Effect]) -> Springs:
        """The same springs with other effects on them."""
        made = copy(self)
        made._effects = [e for e in effects if type(e).springs is not Effect.springs]
        return made

    def leg(
        self, foot: Foot, J: Array, com: Array, load: float, deflection: Array, rate: Array, motor_rate: Array
    ) -> LegSprings:
        """The springs of a leg; arguments as in `LegSprings`."""
        joints, (K_q, D_q) = self._joints[foot], self.matrices[foot]
        leg = LegSprings(
            foot, joints, J, K_q.copy(), D_q.copy(), np.zeros(len(joints)), com, load, deflection, rate, motor_rate
        )
        for effect in self._effects:
            effect.springs(leg)
        return leg
