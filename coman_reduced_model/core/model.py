# SPDX-License-Identifier: BSD-3-Clause
"""The paper's model: one point mass held by the Cartesian spring-damper of the support leg (14)-(23).

`Model.terms` assembles m p'' = K (p_r - p) + D (p_r' - p') + m g for one posture and phase; the predictor
integrates it. Effects from the configuration change the joint springs or the assembled terms.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .compiled import compiled
from .config import Config
from .effects import active_effects
from .robot import Posture, Robot
from .stiffness import height_hessian, spring_damper
from .types import Array, Foot, Phase, SupportState

XY = np.array([0, 1])


@dataclass(slots=True)
class LegSprings:
    """One loaded leg in joint space; effects change it before it is seen from the COM.

    Joints run from the hip to the ankle; n of them.
    """

    foot: Foot
    joints: tuple[str, ...]
    J: Array  # (6, n) Jacobian of (8), sole to the frame at the COM, in sole axes
    K_q: Array  # (n, n) [Nm/rad]
    D_q: Array  # (n, n) [Nms/rad]
    load: float  # [N] weight that the leg carries

    def height_hessian(self) -> Array:
        """(n, n) second derivative of the COM height by the joint angles [m/rad^2]."""
        return height_hessian(self.J)


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
    axes: Array  # (n,) indices of the integrated coordinates; the others follow the reference and are not felt
    near_singular: bool = False


class Model:
    """Assembles the terms of the paper's model plus the configured effects."""

    def __init__(self, robot: Robot, config: Config) -> None:
        """Take what does not change from sample to sample.

        Raises:
            ConfigError: an effect names a joint that the legs do not have.
        """
        self.robot = robot
        self.config = config
        self.mass = robot.mass
        self.gravity = config.robot.gravity
        self._M = self.mass * np.eye(3)
        self.effects = active_effects(config.effects, robot)
        self.legs = {}
        for foot, leg in ((Foot.LEFT, config.robot.left), (Foot.RIGHT, config.robot.right)):
            self.legs[foot] = (leg.joints, np.diag(leg.stiffness), np.diag(leg.damping))
        c = config.model
        # (20), (21): rows are the forces in x, y, z, columns the deflections that cause them.
        self._tuning_K = np.array([[c.a1, 1.0, c.c1], [1.0, 1.0, 1.0], [c.c2, 1.0, c.a2]])
        self._tuning_D = np.array([[c.b1, 1.0, c.e1], [1.0, 1.0, 1.0], [c.e2, 1.0, c.b2]])
        self.turning = any(effect.name == "trunk_rotation" for effect in self.effects)
        self._rows = 3 if c.stiffness == "condensed" else 6
        self.axes = np.array(sorted({0, 2}.union(*(effect.axes for effect in self.effects))))
        # A deflection that is not integrated is not felt either: without its column K p_r would pull all the same.
        ignored = [axis for axis in range(3) if axis not in self.axes]
        self._tuning_K[:, ignored] = self._tuning_D[:, ignored] = 0.0
        self._before = self._scaled(c.share_x_before, c.share_z_before)
        self._after = self._scaled(c.share_x_after, c.share_z_after)

    def leg_stiffness(self, posture: Posture, foot: Foot, load: float) -> tuple[Array, Array, bool]:
        """K, D (3, 3) of one leg in the axes of its sole, untuned: the linear blocks of (12), (13).

        Args:
            posture: the robot, refreshed.
            foot: which leg.
            load: weight that the leg carries [N], for effects of gravity.

        Returns:
            K [N/m], D [Ns/m], whether the posture is near singular.
        """
        joints, K_q, D_q = self.legs[foot]
        J = posture.leg_jacobian(foot)
        if self.effects:
            leg = LegSprings(foot, joints, J, K_q.copy(), D_q.copy(), load)
            for effect in self.effects:
                effect.springs(leg)
            K_q, D_q = leg.K_q, leg.D_q
        r = posture.com - posture.p[foot]
        length = float(r @ r) ** 0.5
        K, D, singular = spring_damper(J[: self._rows], K_q, D_q, length, self.config.model.singular_limit)
        return K[:3, :3], D[:3, :3], singular

    def terms(
        self, posture: Posture, support: SupportState, references: dict[Foot, tuple[Array, Array]], landed: bool
    ) -> Terms:
        """The equation of motion for one sample.

        Args:
            posture: the robot whose Jacobians count, refreshed.
            support: phase, support foot and load share; the support foot must be LEFT or RIGHT.
            references: for each loaded foot its reference COM position and velocity (3,) [m], [m/s], in the frame
                of the *support* sole.
            landed: in double support: the support foot is the one that has just landed in front, before its own
                single support; else it is the one behind, after it (22), (23).

        Returns:
            Terms in the frame of the support sole.
        """
        foot = support.support_foot
        weight = self.mass * self.gravity
        double = support.phase == Phase.DOUBLE
        both = double and self.config.model.double_support == "both_legs"
        share = self.share(support) if double else 1.0
        K, D, singular = self.leg_stiffness(posture, foot, weight * share if both else weight)
        p_r, v_r = references[foot]
        if both:
            terms = self._both_legs(posture, foot, share, K, D, references, singular)
        else:
            scale_K, scale_D = self._divided(share, landed) if double else (self._tuning_K, self._tuning_D)
            K, D, force = _pull(K, D, scale_K, scale_D, p_r, v_r)
            terms = Terms(self._M, K, D, force, self.axes, singular)
        terms.force[2] -= weight
        for effect in self.effects:
            effect.terms(terms)
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

    def share(self, support: SupportState) -> float:
        """Share of the weight on the support foot, 0.05..1; half where it is not known."""
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

    def _both_legs(
        self,
        posture: Posture,
        foot: Foot,
        share: float,
        K: Array,
        D: Array,
        references: dict[Foot, tuple[Array, Array]],
        singular: bool,
    ) -> Terms:
        """Both legs in parallel, told in the frame of the support sole: K = K_left + K_right."""
        weight = self.mass * self.gravity
        K_o, D_o, singular_o = self.leg_stiffness(posture, foot.other, weight * (1.0 - share))
        R, _ = posture.sole_to_sole(foot, foot.other)
        K, D = K * self._tuning_K, D * self._tuning_D
        K_o, D_o = (R @ K_o @ R.T) * self._tuning_K, (R @ D_o @ R.T) * self._tuning_D
        p_r, v_r = references[foot]
        p_o, v_o = references[foot.other]
        force = K @ p_r + D @ v_r + K_o @ p_o + D_o @ v_o
        return Terms(self._M, K + K_o, D + D_o, force, self.axes, singular or singular_o)


@compiled
def _pull(K: Array, D: Array, scale_K: Array, scale_D: Array, p_r: Array, v_r: Array) -> tuple[Array, Array, Array]:
    """The leg's K and D times their factors, and the force K p_r + D v_r of the reference."""
    K_s, D_s, force = np.empty((3, 3)), np.empty((3, 3)), np.zeros(3)
    for i in range(3):
        for j in range(3):
            K_s[i, j], D_s[i, j] = K[i, j] * scale_K[i, j], D[i, j] * scale_D[i, j]
            force[i] += K_s[i, j] * p_r[j] + D_s[i, j] * v_r[j]
    return K_s, D_s, force
