# SPDX-License-Identifier: BSD-3-Clause
"""The pendulum's state from the measured COM and ZMP, for predictions ahead without a reference.

p'' = w^2 (p - z) is unstable: noise and delay of the ZMP grow with the horizon, and its future is not known. So z is a
state as well, which returns under the COM,

    p'' = w^2 (p - z)    z' = (p - z) / tau + noise,

and a Kalman filter takes in the COM by kinematics and the ZMP by the foot sensors as it was `delay` before. Its
constants were chosen on the first half of a recording of a walking iCub, for horizons of 0.1 to 0.4 s;
`bench/pendulum.py` judges them on the second. With them z stays close to p: what the ZMP shows is mostly the velocity.
"""

from __future__ import annotations

import numpy as np

from ..base.compiled import apply, compiled, mul
from ..base.types import Array

#                   tau [s]  noise of z'  of v'  of the ZMP  delay [s]; noises against that of the COM, 1
CONSTANTS = np.array([(0.00295, 1.17, 32.7, 0.585, 0.1875), (0.00738, 23.46, 316.5, 0.118, 0.0)])  # fore-aft, lateral
_LONGEST = 0.25  # [s] between two samples: after more it starts again


class ZmpFilter:
    """Follows COM, velocity and ZMP along x and y of the support sole."""

    def __init__(self, constants: Array = CONSTANTS) -> None:
        """`constants` (2, 5): a row an axis, see `CONSTANTS`."""
        self._constants = constants
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._stamp_ns = 0
        self._T = np.eye(4)
        self._state = np.zeros((2, 3))
        self._P = np.zeros((2, 3, 3))

    def update(self, stamp_ns: int, T_odom_sole: Array, com: Array, zmp: Array, gravity: float) -> None:
        """Take in a sample: COM and ZMP (3,) in the support sole [m], whose pose is T_odom_sole (4, 4)."""
        dt = (stamp_ns - self._stamp_ns) * 1e-9
        if not 0.0 < dt < _LONGEST:
            self._state[:] = np.array([com[:2], np.zeros(2), com[:2]]).T
            self._P[:] = np.diag((1.0, 1e4, 1e3))
        else:
            _update(
                dt, self._state, self._P, self._T, T_odom_sole, com, zmp, gravity / max(com[2], 0.05), self._constants
            )
        self._stamp_ns, self._T = stamp_ns, T_odom_sole

    def ahead(self, com: Array, horizons: Array, gravity: float) -> Array:
        """COM (k, 3) [m] at horizons (k,) [s]; the height of the measured one (3,) stays."""
        return _ahead(self._state, com, horizons, gravity / max(com[2], 0.05), self._constants)


@compiled
def _motion(w2: float, tau: float, t: float) -> Array:
    """Transition (3, 3) of p, v, z over t [s]: a series over a part of it, squared."""
    A = np.zeros((3, 3))
    A[0, 1], A[1, 0], A[1, 2], A[2, 0], A[2, 2] = 1.0, w2, -w2, 1.0 / tau, -1.0 / tau
    halvings = max(0, int(np.ceil(np.log2(10.0 * t / tau))))
    A *= t / 2.0**halvings
    F, term = np.eye(3), np.eye(3)
    for k in range(1, 7):
        term = mul(term, A) / k
        F += term
    for _ in range(halvings):
        F = mul(F, F)
    return F


@compiled
def _update(
    dt: float, state: Array, P: Array, T_old: Array, T: Array, com: Array, zmp: Array, w2: float, constants: Array
) -> None:
    # The support sole may be another one. Its axes differ by a small yaw: the variances stay.
    R = mul(T[:3, :3].T.copy(), T_old[:3, :3].copy())
    moved = apply(T[:3, :3].T.copy(), T_old[:3, 3] - T[:3, 3])
    before = state.copy()
    for a in range(2):
        for k in range(3):
            state[a, k] = R[a, 0] * before[0, k] + R[a, 1] * before[1, k] + (0.0 if k == 1 else moved[a])
        tau, noise_z, noise_v, noise_zmp, delay = constants[a]
        F = _motion(w2, tau, dt)
        state[a] = apply(F, state[a])
        P[a] = mul(mul(F, P[a]), F.T)
        P[a, 1, 1] += noise_v**2 * dt
        P[a, 2, 2] += noise_z**2 * dt
        H = np.array((1.0, 0.0, 0.0))
        measured, variance = com[a], 1.0
        for _ in range(2):
            PH = apply(P[a], H)
            gain = PH / (H.dot(PH) + variance)
            state[a] += gain * (measured - H.dot(state[a]))
            P[a] -= np.outer(gain, PH)
            H[0], H[2] = -delay / tau, 1.0 + delay / tau
            measured, variance = zmp[a], noise_zmp**2


@compiled
def _ahead(state: Array, com: Array, horizons: Array, w2: float, constants: Array) -> Array:
    out = np.empty((horizons.shape[0], 3))
    for h in range(horizons.shape[0]):
        for a in range(2):
            out[h, a] = _motion(w2, constants[a, 0], horizons[h])[0].dot(state[a])
        out[h, 2] = com[2]
    return out
