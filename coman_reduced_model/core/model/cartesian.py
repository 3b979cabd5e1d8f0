# SPDX-License-Identifier: BSD-3-Clause
"""The paper's model: one point mass held by the Cartesian spring-damper of the support leg (14)-(23).

`Model.terms` assembles m p'' = K (p_r - p) + D (p_r' - p') + m g for one posture and phase; `PointMass` integrates it.
Effects from the configuration change the joint springs, or push.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..base.compiled import compiled
from ..base.types import Array, Foot, Integers, Phase, SupportState
from ..config.schema import Config
from ..effects.catalogue import Effect
from ..robot.leg import add_gravity_stiffness
from ..robot.robot import Posture, Robot
from .springs import Springs
from .stiffness import spring_damper

XY = np.array([0, 1])
_NOTHING = np.zeros(3)


@dataclass(slots=True)
class Terms:
    """The equation of motion M p'' = force - D p' - K p in the frame of the support sole.

    M, K, D are (3, 3), in kg, N/m and Ns/m, tuning coefficients and load shares included; force (3,) [N] holds all
    that does not depend on the state: K p_r + D p_r' + m g.
    """

    M: Array
    K: Array
    D: Array
    force: Array
    axes: Integers  # (n,) indices of the integrated coordinates; the others follow the reference and are not felt
    near_singular: bool = False


class Model:
    """Assembles the terms of the paper's model plus the configured effects."""

    def __init__(self, robot: Robot, config: Config, effects: Sequence[Effect] = ()) -> None:
        """Take what does not change from sample to sample; effects and robot come from `build_effects`."""
        self.robot = robot
        self.config = config
        self.mass = robot.mass
        self.gravity = config.robot.gravity
        self._M = self.mass * np.eye(3)
        self.effects = effects
        self.springs = Springs(config.robot, self.effects, config.uses("gravity_stiffness"))
        c = config.model
        # (20), (21): rows are the forces in x, y, z, columns the deflections that cause them.
        self._tuning_K = np.array([[c.a1, 1.0, c.c1], [1.0, 1.0, 1.0], [c.c2, 1.0, c.a2]])
        self._tuning_D = np.array([[c.b1, 1.0, c.e1], [1.0, 1.0, 1.0], [c.e2, 1.0, c.b2]])
        self.turning = config.turning
        self._limit = c.singular_limit
        self._rows = 3 if c.stiffness == "condensed" else 6
        self.axes = np.array([0, 1, 2] if config.uses("lateral_compliance") else [0, 2])
        # A deflection that is not integrated is not felt either: without its column K p_r would pull all the same.
        ignored = [axis for axis in range(3) if axis not in self.axes]
        self._tuning_K[:, ignored] = self._tuning_D[:, ignored] = 0.0
        self._before = self._scaled(c.share_x_before, c.share_z_before)
        self._after = self._scaled(c.share_x_after, c.share_z_after)

    def leg_stiffness(
        self,
        posture: Posture,
        foot: Foot,
        load: float,
        deflection: Array | None = None,
        rate: Array | None = None,
        motor_rate: Array | None = None,
    ) -> tuple[Array, Array, Array, bool]:
        """K, D (3, 3) of one leg in the axes of its sole, untuned: the linear blocks of (12), (13).

        Args:
            posture: the robot, refreshed.
            foot: which leg.
            load: weight that the leg carries [N], for effects of gravity.
            deflection, rate: (n,) of its joints [rad], [rad/s], for springs that are not linear; default: what the
                load does to them, and zero.
            motor_rate: (n,) of its motors [rad/s], for friction; default: zero.

        Returns:
            K [N/m], D [Ns/m], force (3,) [N] of springs that pull without a deflection of the COM, whether the posture
            is near singular.
        """
        J, springs, torque = posture.leg_jacobian(foot), self.springs, None
        K_q, D_q = springs.matrices[foot]
        still = np.zeros(J.shape[1])
        if not springs.nominal:
            leg = springs.leg(
                foot,
                J,
                posture.R[foot].T @ (posture.com - posture.p[foot]),
                load,
                -load * J[2] / springs.stiffness[foot] if deflection is None else deflection,
                still if rate is None else rate,
                still if motor_rate is None else motor_rate,
            )
            K_q, D_q, torque = leg.K_q, leg.D_q, leg.torque
        if springs.gravity_stiffness:
            K_q = K_q.copy()
            add_gravity_stiffness(J, load, still, K_q, still)  # at no deflection it adds no torque
        J = J[: self._rows]
        K, D, singular = self._spring_damper(posture, foot, J, K_q, D_q)
        bias = _NOTHING
        if torque is not None and np.count_nonzero(torque):  # K_c J K_q^-1 torque; J^-T torque where J can be inverted
            bias = -(K @ (J @ np.linalg.solve(K_q, torque)))[:3]
        return K[:3, :3], D[:3, :3], bias, singular

    def joints_by_com(self, posture: Posture, foot: Foot) -> Array:
        """How far the joints of a leg turn (n, 3) [rad/m] for a motion of the COM in sole axes, by nominal springs.

        K_q^-1 J^T K_c: of all motions of the joints that move the COM so, that of least energy.
        """
        J = posture.leg_jacobian(foot)[: self._rows]
        K, _, _ = self._spring_damper(posture, foot, J, *self.springs.matrices[foot])
        return np.asarray(J.T @ K[:, :3] / self.springs.stiffness[foot][:, None])

    def _spring_damper(
        self, posture: Posture, foot: Foot, J: Array, K_q: Array, D_q: Array
    ) -> tuple[Array, Array, bool]:
        """`spring_damper` with the length of the leg as it stands."""
        r = posture.com - posture.p[foot]
        return spring_damper(J, K_q, D_q, float(r.dot(r)) ** 0.5, self._limit)

    def terms(
        self,
        posture: Posture,
        support: SupportState,
        references: dict[Foot, tuple[Array, Array]],
        landed: bool,
        deflections: dict[Foot, tuple[Array | None, Array | None, Array]] | None = None,
    ) -> Terms:
        """The equation of motion for one sample.

        Args:
            posture: the robot whose Jacobians count, refreshed.
            support: phase, support foot and load share; the support foot must be LEFT or RIGHT.
            references: for each loaded foot its reference COM position and velocity (3,) [m], [m/s], in the frame
                of the *support* sole.
            landed: in double support: the support foot is the one that has just landed in front, before its own
                single support; else it is the one behind, after it (22), (23).
            deflections: of the joints of each loaded leg, their rates, and those of the motors, where they are known.

        Returns:
            Terms in the frame of the support sole.
        """
        foot = support.support_foot
        weight = self.mass * self.gravity
        double = support.phase == Phase.DOUBLE
        both = double and self.config.model.double_support == "both_legs"
        share = self.share(support, landed) if double else 1.0
        known = deflections or {}
        K, D, bias, singular = self.leg_stiffness(
            posture, foot, weight * share if both else weight, *known.get(foot, ())
        )
        scale_K, scale_D = self._divided(share, landed) if double and not both else (self._tuning_K, self._tuning_D)
        K, D, force = _pulled(K, D, scale_K, scale_D, *references[foot])
        terms = Terms(self._M, K, D, force, self.axes, singular)
        if bias is not _NOTHING:
            force += bias
        if both:
            K, D, bias, singular = self.leg_stiffness(
                posture, foot.other, weight * (1.0 - share), *known.get(foot.other, ())
            )
            R, _ = posture.sole_to_sole(foot, foot.other)
            K, D, more = _pulled(R @ K @ R.T, R @ D @ R.T, scale_K, scale_D, *references[foot.other])
            terms.K += K
            terms.D += D
            force += more + R @ bias
            terms.near_singular |= singular
        force[2] -= weight
        return terms

    def pendulum(self, height: float, zmp: Array) -> Terms:
        """The LIPM driven by the measured ZMP, for a robot without reference: p'' = (g / z_c) (p - p_zmp).

        Args:
            height: z_c, of the COM above the sole [m].
            zmp: (3,) in the frame of the support sole [m].

        Returns:
            Terms for x and y; the height stays as it is.
        """
        K = np.diag(np.full(3, -self.mass * self.gravity / max(height, 0.05)))
        return Terms(self._M, K, np.zeros((3, 3)), K @ zmp, XY)

    def share(self, support: SupportState, landed: bool) -> float:
        """Share of the weight on the support foot in double support, 0.05..1.

        That of the configuration for a foot that has just landed or is about to leave; with `shares: measured` that of
        the wrenches, half where it is not known.
        """
        if self.config.model.shares == "constant":
            return self.config.model.share_z_before if landed else self.config.model.share_z_after
        share = support.left_share if support.support_foot == Foot.LEFT else 1.0 - support.left_share
        return min(1.0, max(0.05, share)) if share == share else 0.5

    def _divided(self, share: float, landed: bool) -> tuple[Array, Array]:
        """Factors (3, 3) of K and D in double support, with the shares that the configuration wants."""
        if self.config.model.shares == "measured":
            return self._scaled(share, share)
        return self._before if landed else self._after

    def _scaled(self, x: float, z: float) -> tuple[Array, Array]:
        """Tuning coefficients over the shares of the support leg in x (and y) and z, (22) and (23)."""
        divisors = np.array([[x], [x], [z]])
        return self._tuning_K / divisors, self._tuning_D / divisors


def _pulled(K: Array, D: Array, scale_K: Array, scale_D: Array, p_r: Array, v_r: Array) -> tuple[Array, Array, Array]:
    """The leg's K and D times their factors, and the force K p_r + D v_r of the reference."""
    K_s, D_s, force = np.empty((3, 3)), np.empty((3, 3)), np.zeros(3)
    _pull(K, D, scale_K, scale_D, p_r, v_r, K_s, D_s, force)
    return K_s, D_s, force


@compiled
def _pull(
    K: Array, D: Array, scale_K: Array, scale_D: Array, p_r: Array, v_r: Array, K_s: Array, D_s: Array, force: Array
) -> None:
    for i in range(3):
        for j in range(3):
            K_s[i, j], D_s[i, j] = K[i, j] * scale_K[i, j], D[i, j] * scale_D[i, j]
            force[i] += K_s[i, j] * p_r[j] + D_s[i, j] * v_r[j]
