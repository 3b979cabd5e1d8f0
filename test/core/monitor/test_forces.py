# SPDX-License-Identifier: BSD-3-Clause
"""Residual force of a robot in motion: equals the negative external force, whatever the motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from coman_reduced_model.core.base.types import Foot
from coman_reduced_model.core.monitor.forces import Feet, ForceBalance

MASS, GRAVITY = 30.0, 9.81
EDGES = np.array([-0.06, 0.12, -0.045, 0.045])  # [m]
T0, DT = 1_700_000_000_000_000_000, 0.01
NONE = (0.0, 0.0, 0.0)
NO_IMU = np.full((3, 3), np.nan)


@dataclass
class Motion:
    """A body that moves by sines above two soles, all of it in the world."""

    seed: int = 0
    push: tuple[float, ...] = NONE  # [N] on the body
    rock: float = 0.0  # [rad] by which the left sole rocks about its outer edge
    yaw: float = 0.0  # [rad] of the right sole

    def __post_init__(self):
        rng = np.random.default_rng(self.seed)
        self.amplitude, self.rate, self.shift = rng.uniform(0.4, 1.0, 9), rng.uniform(2.0, 9.0, 9), rng.uniform(0, 6, 9)

    def sines(self, t):
        return self.amplitude * np.sin(self.rate * t + self.shift)

    def soles(self, t):
        rock = Rotation.from_euler("x", self.rock * np.sin(8.0 * t))
        edge = np.array([0.0, EDGES[3], 0.0])
        left = rock.as_matrix(), np.array([0.0, 0.1, 0.0]) + edge - rock.apply(edge)
        return {
            Foot.LEFT: left,
            Foot.RIGHT: (Rotation.from_euler("z", self.yaw).as_matrix(), np.array([0.1, -0.1, 0.0])),
        }

    def com(self, t):
        """Carried along by the sole that rocks."""
        R, p = self.soles(t)[Foot.LEFT]
        return R @ (np.array([0.05, -0.05, 0.5]) + 0.02 * self.sines(t)[:3]) + p

    def look(self, t, share):
        """Soles, COM and wrenches in a base frame that turns and moves, and the rotation of the base."""
        sines, h = self.sines(t), 1e-4
        base, at = Rotation.from_euler("xyz", 0.1 * sines[3:6]).as_matrix(), 0.03 * sines[6:]
        soles = self.soles(t)
        rate = (self.com(t + h) - 2.0 * self.com(t) + self.com(t - h)) / h**2
        force = MASS * (rate + [0.0, 0.0, GRAVITY]) - self.push
        wrenches = []
        for foot, part in ((Foot.LEFT, share), (Foot.RIGHT, 1.0 - share)):
            f = part * soles[foot][0].T @ force
            x, y = 0.03, EDGES[3] if self.rock and foot is Foot.LEFT else 0.01
            wrenches.append(np.array([*f, y * f[2], -x * f[2], 0.0]))
        poses = [each for R, p in soles.values() for each in (np.asfortranarray(base.T @ R), base.T @ (p - at))]
        return Feet(*poses, base.T @ (self.com(t) - at), *wrenches), base


def watch(motion, start=-1.2, end=0.6, share=lambda t: 1.0, forces=None, imu=True):
    """The force balance from start to end [s]."""
    forces = forces or ForceBalance(MASS, GRAVITY, np.array([EDGES, EDGES]))
    stamps = [T0 + round(1e9 * DT * k) for k in range(round(start / DT), round(end / DT) + 1)]
    for stamp in stamps:
        t = (stamp - T0) * 1e-9
        feet, turned = motion.look(t, share(t))
        foot = Foot.LEFT if share(t) > 0.5 else Foot.RIGHT
        forces.look(stamp, foot, feet, turned if imu else NO_IMU)
    return forces, lambda since, until: forces.residual(T0 + round(1e9 * since), T0 + round(1e9 * until))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("push", [NONE, (6.0, -4.0, 3.0)])
def test_external_force_is_found_in_any_motion(seed, push):
    """To 0.2 % of the weight, while its COM accelerates by a hundred newtons."""
    forces, over = watch(Motion(seed, push))
    assert forces.uses_imu
    for since in (0.02, 0.1, 0.2):
        np.testing.assert_allclose(over(since, since + 0.3), np.negative(push), atol=0.6)


def test_foot_that_rocks_on_its_edge_is_no_external_force():
    """With an IMU; with the sole taken as level the error is tens of newtons."""
    motion = Motion(rock=0.05)
    _, over = watch(motion)
    np.testing.assert_allclose(over(0.1, 0.4), NONE, atol=0.6)
    forces, over = watch(motion, imu=False)
    assert not forces.uses_imu and np.abs(over(0.1, 0.4)[1]) > 10.0


@pytest.mark.parametrize("imu", [True, False])
def test_step_is_no_external_force_and_axes_are_those_of_the_support_sole(imu):
    push, yaw = (6.0, -4.0, 3.0), 0.4
    _, over = watch(Motion(1, push, yaw=yaw), share=lambda t: float(np.interp(t, [0.25, 0.35], [1.0, 0.0])), imu=imu)
    along = Rotation.from_euler("z", -yaw).apply(np.negative(push))
    for since in (0.1, 0.2, 0.3):
        np.testing.assert_allclose(over(since, since + 0.3), along, atol=0.6)


def test_robot_that_shakes_at_nearly_the_rate_of_the_looks_feels_no_external_force():
    """As forces count at each sample; at the looks alone it would be 5 times a second."""
    forces, motion = ForceBalance(MASS, GRAVITY, np.array([EDGES, EDGES])), Motion()
    for k in range(-600, 301):
        stamp = T0 + 2_000_000 * k
        feet, turned = motion.look(0.002 * k, 1.0)
        feet.left[2] += 60.0 * np.sin(2.0 * np.pi * 95.0 * 0.002 * k)
        if k % 5:
            forces.feel(stamp, feet.left, feet.right)
        else:
            forces.look(stamp, Foot.LEFT, feet, turned)
    for since in (0.02, 0.1, 0.2):
        residual = forces.residual(T0 + round(1e9 * since), T0 + round(1e9 * (since + 0.3)))
        np.testing.assert_allclose(residual, NONE, atol=0.6)


def test_residual_is_nan_where_looks_are_missing():
    forces, over = watch(Motion(), end=0.4)
    assert np.isfinite(over(0.0, 0.4)).all() and np.isnan(over(-1.5, 0.4)).all()
    _, over = watch(Motion(), 0.5, 0.9, forces=forces)  # 0.1 s without a look
    assert np.isnan(over(0.3, 0.6)).all() and np.isfinite(over(0.5, 0.9)).all()
    _, over = watch(Motion(), 0.91, 6.0, forces=forces)  # longer than the memory
    assert np.isnan(over(1.0, 6.0)).all() and np.isfinite(over(4.0, 6.0)).all()
    forces.reset()
    assert np.isnan(over(4.0, 6.0)).all()


def test_imu_is_used_once_it_has_proved_reliable():
    def imu(look, motion, end, forces=None, start=0.0):
        forces = forces or ForceBalance(MASS, GRAVITY, np.array([EDGES, EDGES]))
        for k in range(round(start / DT), round(end / DT)):
            feet, turned = motion.look(k * DT, 1.0)
            turned = look(k, turned)
            forces.look(T0 + round(1e9 * DT * k), Foot.LEFT, feet, turned)
        return forces, forces.residual(T0 + round(1e9 * (end - 0.3)), T0 + round(1e9 * (end - DT)))

    push, upside_down = (6.0, -4.0, 3.0), np.diag([1.0, -1.0, -1.0])
    looks = {
        "seldom": lambda k, turned: turned if k % 3 == 0 else NO_IMU,
        "upside down": lambda k, turned: upside_down @ turned,
    }
    for look in looks.values():  # as without one
        forces, found = imu(look, Motion(push=push), 3.0)
        assert not forces.uses_imu
        np.testing.assert_allclose(found, np.negative(push), atol=0.6)
    forces, _ = imu(lambda k, turned: turned, Motion(push=push), 0.9)
    assert not forces.uses_imu
    forces, found = imu(lambda k, turned: turned, Motion(push=push), 2.0, forces, 0.9)
    assert forces.uses_imu and np.isfinite(found).all()
    forces, found = imu(lambda k, turned: NO_IMU, Motion(push=push), 4.0, forces, 2.0)  # it is lost
    assert forces.uses_imu and np.isnan(found).all()
    forces, found = imu(lambda k, turned: NO_IMU, Motion(push=push), 13.0, forces, 4.0)
    assert not forces.uses_imu
    np.testing.assert_allclose(found, np.negative(push), atol=0.6)


def test_in_the_air_the_residual_is_nan():
    """Also with a sensor offset of 3 N."""
    motion, (forces, over) = Motion(), watch(Motion(), end=0.3)
    feet, turned = motion.look(0.31, 1.0)
    offset = np.array([0.0, 0.0, 3.0, 0.0, 0.0, 0.0])
    forces.look(T0 + 310_000_000, Foot.LEFT, feet._replace(left=offset, right=np.zeros(6)), turned)
    assert np.isnan(over(0.1, 0.31)).all()
    _, over = watch(motion, 0.32, 0.7, forces=forces)
    assert np.isfinite(over(0.34, 0.7)).all()
