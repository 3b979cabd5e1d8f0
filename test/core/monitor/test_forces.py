# SPDX-License-Identifier: BSD-3-Clause
"""The force balance of a robot in motion: what pushes it is found, whatever it does, and nothing else."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from coman_reduced_model.core.base.types import Foot
from coman_reduced_model.core.monitor.forces import Forces

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
        """Posture in a base frame that turns and moves, wrenches of both soles, how the base is turned."""
        sines, h = self.sines(t), 1e-4
        base, at = Rotation.from_euler("xyz", 0.1 * sines[3:6]).as_matrix(), 0.03 * sines[6:]
        soles = self.soles(t)
        posture = SimpleNamespace(
            R={foot: base.T @ R for foot, (R, _) in soles.items()},
            p={foot: base.T @ (p - at) for foot, (_, p) in soles.items()},
            com=base.T @ (self.com(t) - at),
        )
        rate = (self.com(t + h) - 2.0 * self.com(t) + self.com(t - h)) / h**2
        force = MASS * (rate + [0.0, 0.0, GRAVITY]) - self.push
        wrenches = []
        for foot, part in ((Foot.LEFT, share), (Foot.RIGHT, 1.0 - share)):
            f = part * soles[foot][0].T @ force
            x, y = 0.03, EDGES[3] if self.rock and foot is Foot.LEFT else 0.01
            wrenches.append(np.array([*f, y * f[2], -x * f[2], 0.0]))
        return posture, *wrenches, base


def watch(motion, start=-1.2, end=0.6, share=lambda t: 1.0, forces=None, imu=True):
    """The force balance from start to end [s]."""
    forces = forces or Forces(MASS, GRAVITY, np.array([EDGES, EDGES]))
    stamps = [T0 + round(1e9 * DT * k) for k in range(round(start / DT), round(end / DT) + 1)]
    for stamp in stamps:
        t = (stamp - T0) * 1e-9
        posture, left, right, turned = motion.look(t, share(t))
        foot = Foot.LEFT if share(t) > 0.5 else Foot.RIGHT
        forces.look(stamp, foot, posture, left, right, turned if imu else NO_IMU)
    return forces, lambda since, until: forces.over(T0 + round(1e9 * since), T0 + round(1e9 * until))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("push", [NONE, (6.0, -4.0, 3.0)])
def test_what_pushes_is_found_whatever_the_robot_does(seed, push):
    """To 0.2 % of the weight, while its COM is thrown about by a hundred newtons."""
    forces, over = watch(Motion(seed, push))
    assert forces.by_imu
    for since in (0.02, 0.1, 0.2):
        np.testing.assert_allclose(over(since, since + 0.3), np.negative(push), atol=0.6)


def test_a_foot_that_rocks_on_its_edge_is_no_push():
    """By the IMU; who takes the sole for level sees tens of newtons."""
    motion = Motion(rock=0.05)
    _, over = watch(motion)
    np.testing.assert_allclose(over(0.1, 0.4), NONE, atol=0.6)
    forces, over = watch(motion, imu=False)
    assert not forces.by_imu and np.abs(over(0.1, 0.4)[1]) > 10.0


@pytest.mark.parametrize("imu", [True, False])
def test_steps_are_no_push_and_axes_are_those_of_the_support_sole(imu):
    push, yaw = (6.0, -4.0, 3.0), 0.4
    _, over = watch(Motion(1, push, yaw=yaw), share=lambda t: float(np.interp(t, [0.25, 0.35], [1.0, 0.0])), imu=imu)
    along = Rotation.from_euler("z", -yaw).apply(np.negative(push))
    for since in (0.1, 0.2, 0.3):
        np.testing.assert_allclose(over(since, since + 0.3), along, atol=0.6)


def test_what_was_not_seen_is_not_known():
    forces, over = watch(Motion(), end=0.4)
    assert np.isfinite(over(0.0, 0.4)).all() and np.isnan(over(-1.5, 0.4)).all()
    _, over = watch(Motion(), 0.5, 0.9, forces=forces)  # 0.1 s without a look
    assert np.isnan(over(0.3, 0.6)).all() and np.isfinite(over(0.5, 0.9)).all()
    _, over = watch(Motion(), 0.91, 6.0, forces=forces)  # as much as is remembered
    assert np.isnan(over(1.0, 6.0)).all() and np.isfinite(over(4.0, 6.0)).all()
    forces.reset()
    assert np.isnan(over(4.0, 6.0)).all()


def test_an_imu_counts_once_it_can_be_relied_upon():
    def imu(look, motion, end, forces=None, start=0.0):
        forces = forces or Forces(MASS, GRAVITY, np.array([EDGES, EDGES]))
        for k in range(round(start / DT), round(end / DT)):
            posture, left, right, turned = motion.look(k * DT, 1.0)
            turned = look(k, turned)
            forces.look(T0 + round(1e9 * DT * k), Foot.LEFT, posture, left, right, turned)
        return forces, forces.over(T0 + round(1e9 * (end - 0.3)), T0 + round(1e9 * (end - DT)))

    push, upside_down = (6.0, -4.0, 3.0), np.diag([1.0, -1.0, -1.0])
    looks = {
        "seldom": lambda k, turned: turned if k % 3 == 0 else NO_IMU,
        "upside down": lambda k, turned: upside_down @ turned,
    }
    for look in looks.values():  # as without one
        forces, found = imu(look, Motion(push=push), 3.0)
        assert not forces.by_imu
        np.testing.assert_allclose(found, np.negative(push), atol=0.6)
    forces, _ = imu(lambda k, turned: turned, Motion(push=push), 0.9)
    assert not forces.by_imu
    forces, found = imu(lambda k, turned: turned, Motion(push=push), 2.0, forces, 0.9)
    assert forces.by_imu and np.isfinite(found).all()
    forces, found = imu(lambda k, turned: NO_IMU, Motion(push=push), 4.0, forces, 2.0)  # it is lost
    assert forces.by_imu and np.isnan(found).all()
    forces, found = imu(lambda k, turned: NO_IMU, Motion(push=push), 13.0, forces, 4.0)
    assert not forces.by_imu
    np.testing.assert_allclose(found, np.negative(push), atol=0.6)


def test_in_the_air_nothing_is_known():
    """Nor with a sensor that says 3 N there."""
    motion, (forces, over) = Motion(), watch(Motion(), end=0.3)
    posture, left, right, turned = motion.look(0.31, 1.0)
    offset = np.array([0.0, 0.0, 3.0, 0.0, 0.0, 0.0])
    forces.look(T0 + 310_000_000, Foot.LEFT, posture, offset, 0.0 * right, turned)
    assert np.isnan(over(0.1, 0.31)).all()
    _, over = watch(motion, 0.32, 0.7, forces=forces)
    assert np.isfinite(over(0.34, 0.7)).all()
