# SPDX-License-Identifier: BSD-3-Clause
"""Estimate of COM, trunk and what pushes the robot, with covariances, from encoders, foot wrenches and IMU.

Beside the free run, which it does not touch. The filter is `kalman.py`, that of moments `moment.py`, that of the
trunk's rotation `rotation.py`; here is what the noise of the first two is:

- Steps of the encoders, found in their data, and how much of the rounding of the measured COM is white, by its third
  differences; the rest lasts.
- How far the apparent external force wanders, axis by axis, on one foot and on both, by its own corrections lately:
  soles that roll or slide, and forces that come and go, make the motion by the encoders another one than that by the
  forces. Where innovations are too large all the same, as at landings, the published covariance grows with them.
- Nominal variability (config/nominal.yaml): masses of the links and where they are, zeros of encoders and wrenches,
  gains and delays of wrenches, slope of the ground. What is constant cannot be seen in innovations, so it enters the
  published covariances beside those of the filter (as a Schmidt-Kalman filter considers it), not the filter.
"""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from ..base.compiled import all_finite
from ..base.types import Array, Estimate, Flags, Foot, Phase
from .ground import follow_ground
from .masses import masses_covariance
from .memory import BEGINS, CHANGES, GOES_ON, ROWS, SIZES, Noise, learn_posture, learn_steps, memory_of
from .moment import SIZE, follow, look, moment_of
from .trunk import TrunkFilter

if TYPE_CHECKING:
    from ..base.nominal import Nominal
    from ..effects.hooks import Now
    from ..robot.robot import Posture, Robot

GAP = 0.1  # [s] without a sample or a wrench after which it begins again
WALK = 0.1  # of the weight: how far an external force wanders in the root of a second, before it is known
FORCE = 0.001  # of the weight times the root of a second: force that neither sensors nor gains explain
LOST = 4.0  # times what the NIS should be: consistency is lost
FOUND = 2.0  # times: it is found again
_NO_GROUND = np.full((ROWS, 3), np.nan)
EVERY_NS = 20_000_000  # between new covariances of the measured COM, and new moments


class Observer:
    """The filter of one robot, sample by sample.

    Attributes:
        flags: INCONSISTENT where innovations are far larger than they should be.
        nis: mean of the last seconds [1]; 3 is expected.
        constants: (3, 3) of the covariance of the COM, what masses and zeros of encoders make of it [m^2].
    """

    def __init__(self, robot: Robot, gravity: float, nominal: Nominal) -> None:
        """Build the filter.

        Args:
            robot: its mass and columns.
            gravity: [m/s^2].
            nominal: how nominal robots differ.
        """
        widths = nominal.widths
        weight = robot.mass * gravity
        self._robot, self._nominal, self._weight = robot, nominal, weight
        gain, delay = widths["wrench_scale.scale.spread"], widths["wrench_delay.delay.spread"]
        self._noise = Noise(robot.mass, gravity, (FORCE * weight) ** 2, gain, delay, np.zeros(3))
        self._zero_variance = np.zeros(robot.model.nv)
        self._zero_variance[robot.idx_v] = widths["encoder_bias.bias.spread"] ** 2
        slope, mass = weight * widths["ground_slope.spread"], weight * widths["mass.spread"] / 3.0
        self._zeros = np.array([[widths[f"zero_{kind}{axis}.spread"] ** 2 for axis in "xyz"] for kind in "ft"])
        zeros = 2.0 * self._zeros[0]  # of two feet
        gains = (weight * widths["wrench_scale.together.spread"]) ** 2
        self._constant = zeros[0] + slope**2, zeros[1] + slope**2, zeros[2] + mass**2 + gains
        self._masses: Array | None = None  # (3, 3) [m^2] of the COM by those of the masses, base frame
        self._encoders = np.full((2, len(robot.joint_names)), np.inf)  # as in `learn_steps`
        self._block, self._ground_block = np.zeros(sum(SIZES)), np.zeros(sum(SIZES))
        self._memory = memory_of(self._block)
        self.constants = self._memory.constants
        self._sole = np.zeros((2, 3))  # as `follow_ground` has it
        self._extra = np.zeros(SIZE)
        self._moment = np.full((7, 3), np.nan)  # and its covariance, as `look` fills it in
        data = robot.model.createData()
        pin.computeCentroidalMap(robot.model, data, pin.neutral(robot.model))
        self._radius = float(np.sqrt(np.trace(data.Ag[3:, 3:6]) / (3.0 * robot.mass)))  # of gyration [m]
        self._trunk = TrunkFilter(robot, gravity, self._radius, nominal)
        self.reset()

    def reset(self) -> None:
        """Forget the past, but not the steps of the encoders."""
        for block in (self._block, self._ground_block):
            block[:], memory = 0.0, memory_of(block)
            memory.walks[:] = (WALK * self._weight) ** 2
            memory.constant[:] = self._constant
            memory.scalars[1:] = 3.0, np.nan
            memory.squares[:] = 1.0
        self._tilts = False  # whether the last sample knew how the sole tilts
        self._extra[:] = 0.0
        moment = moment_of(self._extra)
        moment.walks[:], moment.zeros[:] = (WALK * self._weight * self._radius) ** 2, self._zeros
        self._trunk.reset()
        self._foot = Foot.NONE
        self._stamp_ns = self._looked_ns = 0
        self.nis, self.flags = 3.0, Flags.OK

    def update(self, now: Now, measured: bool = True) -> Estimate:
        """Take one sample; without measured wrenches of both feet, only the rotation of the trunk is estimated."""
        sample, link, support, com, com_vel = now.sample, now.link, now.support, now.com, now.com_vel
        foot, aslant = support.support_foot, now.aslant
        dt, before = (sample.stamp_ns - self._stamp_ns) * 1e-9, self._foot
        self._stamp_ns = sample.stamp_ns
        learn_steps(self._encoders, sample.q)
        trunk = self._trunk.update(now, self._encoders[0])
        if not measured or sample.left_wrench is None or sample.right_wrench is None or not all_finite(com):
            self._foot = Foot.NONE  # it begins again
            return Estimate(trunk=trunk)
        self._foot, other = foot, foot.other
        self._noise.aslant[:] = 0.0 if aslant is None else self._weight * aslant
        what = BEGINS if before == Foot.NONE or not 0.0 < dt <= GAP else GOES_ON if foot == before else CHANGES
        since_ns = sample.stamp_ns - self._looked_ns
        due = since_ns >= EVERY_NS or what != GOES_ON
        if due:
            self._look(link, foot)
            self._looked_ns = sample.stamp_ns
        wrenches = sample.left_wrench, sample.right_wrench
        own, others = wrenches if foot == Foot.LEFT else wrenches[::-1]
        out = np.empty((ROWS, 3))  # one array: what compiled code gets is what takes the time here
        R, R_other, alone = link.R[foot], link.R[other], int(support.phase != Phase.DOUBLE)
        follow(
            self._block, self._extra, self._noise, (what, dt, alone), own, others, R, R_other, link.p[foot],
            link.p[other], com, com_vel, out,
        )  # fmt: skip
        if due:
            pin.computeCentroidalMap(self._robot.model, link.data, link.configuration)
            self._moment, step = np.empty((7, 3)), (what, 1e-9 * since_ns, alone)
            look(
                self._block, self._extra, self._noise, step, self._radius, link.data.Ag, self._robot.idx_v, sample.qd,
                link.base_in_sole, R, R_other, self._moment,
            )  # fmt: skip
        ground = _NO_GROUND
        if trunk.by_imu:
            ground = np.empty((ROWS, 3))
            R_trunk = link.orientation(self._robot.base_id)
            follow_ground(
                self._ground_block, self._sole, self._block, self._noise, (what if self._tilts else BEGINS, dt, alone),
                (own, others), (R, R_other, R_trunk), trunk.R, (com, com_vel), ground,
            )  # fmt: skip
        self._tilts = trunk.by_imu
        nis, moment = self._judge(), self._moment
        com_covariance, force_covariance = out[9:].reshape(6, 6), out[6:9]
        return Estimate(
            out[0],
            out[1],
            com_covariance,
            out[3:6],
            out[2],
            force_covariance,
            nis,
            moment[0],
            moment[1:],
            trunk,
            ground[1],
            ground[9:].reshape(6, 6)[3:, 3:],
        )

    def _look(self, link: Posture, foot: Foot) -> None:
        """How far off the measured COM is by its encoders, at this posture."""
        if self._masses is None:
            self._masses = masses_covariance(link, self._nominal)
        robot, memory = self._robot, self._memory
        learn_posture(
            memory.rounding, memory.constants, link.views, robot.sole_columns[foot], foot == Foot.LEFT,
            self._encoders[0], robot.idx_v, self._zero_variance, self._masses,
        )  # fmt: skip

    def _judge(self) -> float:
        """Say how consistent the innovations are; that of the last sample."""
        _, self.nis, nis = self._memory.scalars.tolist()
        if not isfinite(self.nis + self._ground_block[0]):
            self.reset()  # it begins again
        most = 3.0 * (FOUND if self.flags else LOST)
        self.flags = Flags.OK if self.nis < most else Flags.INCONSISTENT
        return float(nis)
