# SPDX-License-Identifier: BSD-3-Clause
"""Signals on the grid of a recording: smoothed, their rates, lags and noise, and how far torques stretch springs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter1d

from ...core.base import delays
from ...core.base.compiled import compiled
from ...core.base.types import Array, Booleans
from .recording import RATE, Recording
from .world import World

SMOOTHING = 0.02  # [s] standard deviation of the Gaussian: half amplitude at 9 Hz, nothing left above 20
BARELY = 0.008  # [s] standard deviation of the Gaussian before a sign is taken, or a slip, which is smoothed then
FAST = 1.0 + 1.0 / np.sqrt(5.0) - 2.0 / np.sqrt(3.0)  # of smoothed white noise, what smoothing twice as much leaves out
SOFTEST = 0.2  # tangent of a softening spring at its softest, over that at rest
NOISY = 0.05  # of a joint's torques, from which on the noise of their sensor matters for derivatives


class Smoothed:
    """Smoothed arrays, and what is made of them, remembered: most hypotheses leave most arrays as they are."""

    def __init__(self, before: Smoothed | None = None) -> None:
        self._known: dict[tuple[Any, ...], tuple[Array, Any]] = {} if before is None else dict(before._known)

    def __call__(self, values: Array) -> Array:
        return self._made(("smooth", id(values)), values, smooth)

    def complete(self, values: Array) -> Booleans:
        """(k,) which columns of smoothed values (n, k) have no gap."""
        return self._made(("complete", id(values)), values, _complete)

    def stretch(self, world: World, j: int, torques: Array) -> Array:
        """(n,) [rad] of the spring of joint j under smoothed torques (n, nj) at RATE."""
        law = float(world.stiffness[j]), float(world.damping[j]), float(world.cubic[j])
        return self._made((j, *law), torques, lambda each: spring_stretch(world, j, each[:, j]))

    def slipped(self, world: World, j: int, torques: Array) -> Array:
        """(n,) [rad], smoothed: what lost motion adds to the spring of joint j, of torques (n, nj) at RATE."""
        law = tuple(float(each[j]) for each in (world.lost, world.slips_at, world.stiffness, world.damping))
        key = "slipped", j, *law
        return self._made(key, torques, lambda each: smooth(slipped(world, j, barely_smooth(each[:, j]))))

    def rubbing(self, q: Array, creep: Array) -> Array:
        """(n, nj) -1..1, smoothed: friction of joints at q (n, nj), as a share of itself; creep (nj,) [rad/s]."""
        key = "rubbing", creep.tobytes()
        return self._made(key, q, lambda each: smooth(np.tanh(rate_of(barely_smooth(each)) / creep)))

    def _made(self, key: tuple[Any, ...], of: Array, make: Callable[[Array], Any]) -> Any:
        found = self._known.get(key)
        if found is None or found[0] is not of:
            found = self._known[key] = (of, make(of))
        return found[1]


def _complete(values: Array) -> Booleans:
    return np.asarray(np.isfinite(values).all(axis=0))


def smooth(values: Array) -> Array:
    """Values (n, k) without what is faster than the balance can follow."""
    return np.asarray(gaussian_filter1d(values, SMOOTHING * RATE, axis=0, mode="nearest"))


def barely_smooth(values: Array) -> Array:
    """Values (n, k) whose sign or rate is asked for before they are smoothed: without most of the counts."""
    return np.asarray(gaussian_filter1d(values, BARELY * RATE, axis=0, mode="nearest"))


def rate_of(values: Array) -> Array:
    """Of values (n, ...) at RATE, by central differences."""
    return np.gradient(values, 1.0 / RATE, axis=0)


def lagged(values: Array, time_constant: float) -> Array:
    """First-order lag along the first axis; a negative time constant leads (for difference quotients around zero)."""
    return delays.lagged(values, time_constant, RATE)


def spring_stretch(world: World, j: int, torque: Array) -> Array:
    """Between motor and link (n,) [rad], of spring and damper, for a torque (n,) at RATE."""
    k, d, cubic = (float(each[j]) for each in (world.stiffness, world.damping, world.cubic))
    x = lagged(torque, d / k) / k
    if cubic:  # what it adds, so that the smallest one is no other way to compute the same
        bent, without = (bent_stretch(np.ascontiguousarray(torque), k, d, each, 1.0 / RATE) for each in (cubic, 0.0))
        x = x + bent - without
    return np.asarray(x)


def slipped(world: World, j: int, torque: Array) -> Array:
    """(n,) [rad] that lost motion adds to the stretch of joint j's spring, for a torque (n,) at RATE."""
    k, d, held = float(world.stiffness[j]), float(world.damping[j]), float(world.slips_at[j])
    torque = np.ascontiguousarray(torque)
    half = 0.5 * float(world.lost[j])
    with_it, without = (_lost_stretch(torque, k, d, each, held, 1.0 / RATE) for each in (half, 0.0))
    return np.asarray(with_it - without)


@compiled
def _lost_stretch(torque: Array, k: float, d: float, half: float, held: float, dt: float) -> Array:
    """Stretch (n,) [rad] of a spring k in series with a slip within +-half, and a damper d beside both.

    The slip moves while the spring bears `held` [Nm] or more, as an element of Prandtl, and stays when the torque
    falls. Backward Euler. Where it was at first is not known: taken to begin opposite to its first slip.
    """
    out = np.empty(len(torque))
    slip, x, drag = 0.0, torque[0] / k, 0.0
    for i in range(len(torque)):
        if abs(torque[i]) > held:
            slip = -half if torque[i] > 0.0 else half
            break
    for i in range(len(torque)):
        pull = torque[i] + drag * x
        x = (pull + k * slip) / (k + drag)
        over = k * (x - slip)
        if abs(over) > held:  # it slips, at the end of its way at the latest
            x = (pull - np.copysign(held, over)) / drag if drag > 0.0 else np.copysign(1e9, over)
            slip = min(max(x - np.copysign(held, over) / k, -half), half)
            if abs(slip) == half:
                x = (pull + k * slip) / (k + drag)
        out[i] = x
        drag = d / dt
    return out


@compiled
def bent_stretch(torque: Array, k: float, d: float, cubic: float, dt: float) -> Array:
    """Stretch (n,) of a spring k x (1 + cubic x^2) with a damper d beside it, under a torque (n,) [Nm] every dt [s].

    The straight spring is under the torque that the bend leaves it, linear between samples: exact without a bend, as
    `lagged` is, of second order with one. A softening spring goes on straight where its tangent has fallen to a fifth.
    Newton's method begins at the straight spring each time: from there it does not overshoot to the other side.
    """
    straight = np.sqrt((1.0 - SOFTEST) / (-3.0 * cubic)) if cubic < 0.0 else 1e9
    T = max(d / k, 0.0)
    a = np.exp(-dt / T) if T > 0.0 else 0.0
    b = T / dt * (1.0 - a)
    out = np.empty(len(torque))
    x = u = 0.0
    for i in range(len(torque)):
        now, before = (1.0, 0.0) if i == 0 else (1.0 - b, a * x + (b - a) * u)
        x = before + now * torque[i] / k
        for _ in range(200):
            at = min(max(x, -straight), straight)
            slope = 3.0 * cubic * at**2
            bend = cubic * at**3 + slope * (x - at)
            step = (x - before - now * (torque[i] / k - bend)) / (1.0 + now * slope)
            x -= step
            if abs(step) < 1e-15:
                break
        u = (x - before) / now  # what the bend leaves of torque / k
        out[i] = x
    return out


def without_noise(recording: Recording, world: World) -> Recording:
    """The same motion without the quantisation of the link encoders, and torques without most of their noise.

    Motor side minus stretched springs if both are known, else smoothed twice as much. Where a torque sensor is noisy
    and the link encoder shows the spring's torque better, the encoder shows both but for the slow part.
    """
    wrench = {foot: _twice_smooth(values) for foot, values in recording.wrench.items()}
    recording = recording.changed(wrench=wrench, up=None if recording.up is None else _twice_smooth(recording.up))
    q = _twice_smooth(recording.q)
    if recording.tau is None:
        return recording.changed(q=q)
    noise = white(recording.tau[:: recording.stride])
    tau = believed(recording.tau, noise, recording.stride)
    if recording.motor_q is None:
        return recording.changed(q=q, tau=tau)
    stretch = recording.motor_q - recording.q
    coarse = encoder_noise(recording) * world.stiffness
    known = np.isfinite(world.stiffness + recording.tau.sum(axis=0) + recording.motor_q.sum(axis=0))
    for j in np.flatnonzero(known):
        noisy = noise[j] > max(NOISY * float(np.std(recording.tau[:, j])), 2.0 * coarse[j])
        if noisy and not (world.play[j] or world.cubic[j]):
            x = _twice_smooth(stretch[:, j])
            torque = world.stiffness[j] * x + world.damping[j] * rate_of(x)
            tau[:, j] = torque + _slow(recording.tau[:, j] - torque)
            q[:, j] = recording.motor_q[:, j] - x
        else:
            bent = spring_stretch(world, int(j), tau[:, j])
            more = beyond_noise(stretch[:, j] - bent, coarse[j] / world.stiffness[j])
            q[:, j] = recording.motor_q[:, j] - bent - more
    return recording.changed(q=q, tau=tau)


def _twice_smooth(values: Array) -> Array:
    return np.asarray(gaussian_filter1d(values, 2.0 * SMOOTHING * RATE, axis=0, mode="nearest"))


def _slow(values: Array) -> Array:
    return np.asarray(gaussian_filter1d(values, 0.5 * RATE, mode="nearest"))


def beyond_noise(gap: Array, noise: float) -> Array:
    """What of a gap (n,) between a sensor and a law the sensor is believed: what is slow, and what noise does not make.

    Args:
        gap: sensor minus law.
        noise: standard deviation of the sensor's.
    """
    slow = _slow(gap)
    fast = _twice_smooth(gap) - slow
    return np.asarray(slow + (1.0 - noise_share(fast, noise)) * fast)


def believed(values: Array, noise: Array, stride: int) -> Array:
    """Values (n, k) of sensors: what is slow, and what of the rest their noise does not make, as it is once smoothed.

    Args:
        noise: (k,) standard deviation of the white noise of samples, which are `stride` values apart.
    """
    slow = _twice_smooth(values)
    fast = values - slow
    left = np.sqrt(FAST) * once_smooth(noise, stride)
    return np.asarray(slow + (1.0 - noise_share(smooth(fast), left)) * fast)


def once_smooth(noise: Array, stride: int) -> Array:
    """Standard deviation of what `smooth` leaves of white noise (k,) of samples, which are `stride` values apart."""
    return np.asarray(noise * np.sqrt(stride / (2.0 * np.sqrt(np.pi) * SMOOTHING * RATE)))


def encoder_noise(recording: Recording) -> Array:
    """(nj,) [rad] standard deviation in what both encoders say of a spring's stretch: of rounding, or white if more."""
    assert recording.motor_q is not None
    stretch = recording.motor_q - recording.q
    return np.asarray(np.maximum(recording.count / np.sqrt(12.0), white(stretch[:: recording.stride])))


def noise_share(gap: Array, noise: float | Array) -> Array:
    """Share (k,) of the squares of gaps (n, k) that noise of a standard deviation (k,) explains; 1 at most."""
    return np.asarray(np.minimum(1.0, np.square(noise) / np.maximum(np.mean(gap**2, axis=0), 1e-18)))


def white(values: Array) -> Array:
    """Standard deviation (k,) of the white noise of a signal (n, k): by its fastest part but for impacts."""
    fast = values - gaussian_filter1d(values, 1.0, axis=0)
    gain = 0.70  # root of the sum of squares of the kernel: what is left of white noise
    return np.asarray(1.4826 * np.median(np.abs(fast), axis=0) / gain)
