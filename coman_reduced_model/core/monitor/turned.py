# SPDX-License-Identifier: BSD-3-Clause
"""Wrenches turned about the vertical: the ZMP goes where the motion of the COM does not ask for it.

The ZMP is sum_k s_k (p_k + c_k), with load share s_k, place p_k and CoP c_k of each foot k, along the ground, in the
frame of the support sole. By the COM it is x - (z / g) x'', with x where gravity points from the COM to the ground. A
wrench turned by an angle turns its c_k alike and nothing else. With vectors along the ground as complex numbers a
quarter of a turn is a factor of i, and each hypothesis (both turned alike, or one of them) is one quadratic form of
the same products.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..base.input_warning import InputWarning, WarningKind
from ..base.pose import LEVEL
from ..base.stream_names import WRENCHES
from ..base.types import Array, Foot, Sample
from ..measured.odometry import FootOdometry
from ..measured.slope import Slope
from ..robot.robot import Posture, Robot

_WINDOW = 5  # looks, 0.1 s: over which the acceleration of the COM is taken
_WINDOWS = 10  # on a foot before a warning: 1 s
_STEADY = 0.02  # [m] between COM and ZMP by the acceleration, from which a window counts less
_LOADED = 0.5  # of the weight on both feet together: less is no support
_ZEROED = 0.2  # of the weight, by which both feet together may be off on average: else a ZMP by them says nothing
_SMALL = 0.012  # [m] RMS distance of both ZMPs, below which nothing is said
_BETTER = 0.55  # of that distance is left at most with the wrenches turned back
_ANGLES = ("", "90 degrees counterclockwise", "180 degrees", "90 degrees clockwise")  # of what is measured, from above
_TURNS = [(0, 0), *((a, b) for k in (1, 2, 3) for a, b in ((k, k), (k, 0), (0, k)))]  # quarters, left and right
_BACK = 1j ** -np.arange(4)  # that turn it back


class Turned:
    """Products of what the ZMP is by the COM and by both feet, over windows in which the support foot is one."""

    def __init__(self, robot: Robot, weight: float) -> None:
        """The robot, and its weight [N]."""
        self.weight, self._gravity = weight, robot.config.gravity
        self._odometry, self._slope = FootOdometry(), Slope(robot)
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._windows = dict.fromkeys(WRENCHES, 0)  # by support foot, as the following
        self._weights = dict.fromkeys(WRENCHES, 0.0)
        self._products = {foot: np.zeros((3, 3), dtype=complex) for foot in WRENCHES}
        self._total, self._samples = 0.0, 0  # of both vertical forces [N] as they are read, in all samples
        self._odometry.reset()
        self._slope.reset()
        self._begin(Foot.NONE)

    def _begin(self, foot: Foot) -> None:
        self._foot, self._looks, self._mean = foot, 0, np.zeros(3, dtype=complex)

    def update(self, posture: Posture, sample: Sample, wrenches: Mapping[Foot, Array], read: float) -> None:
        """Take a look: the posture of the joints, and the wrenches (6,) of both feet without what is known of zeros.

        Args:
            sample: by whose IMU or plan a slope is known.
            read: sum of both vertical forces as the sensors read them [N].
        """
        total = float(sum(wrench[2] for wrench in wrenches.values()))
        self._total += read
        self._samples += 1
        foot = Foot.LEFT if wrenches[Foot.LEFT][2] >= wrenches[Foot.RIGHT][2] else Foot.RIGHT
        down = self._down(posture, sample, foot)
        if total < _LOADED * self.weight or min(wrench[2] for wrench in wrenches.values()) < -0.1 * total:
            self._begin(Foot.NONE)
            return
        if foot is not self._foot:
            self._begin(foot)
        com, com_vel = posture.com_in_sole(foot)
        R, p = posture.sole_to_sole(foot, foot.other)
        share = wrenches[foot.other][2] / total
        turn = complex(R[0, 0], R[1, 0])
        asked = complex(com[0], com[1]) - share * complex(p[0], p[1]) - com[2] / down[2] * complex(down[0], down[1])
        own, other = (complex(-wrenches[each][4], wrenches[each][3]) / total for each in (foot, foot.other))
        feet = (own, turn * other) if foot == Foot.LEFT else (turn * other, own)
        velocity = complex(com_vel[0], com_vel[1])
        if self._looks == 0:
            self._since, self._first = sample.stamp_ns, velocity
        self._mean += np.array([asked, *feet])
        self._looks += 1
        if self._looks < _WINDOW:
            return
        seconds = 1e-9 * (sample.stamp_ns - self._since)
        look = self._mean / self._looks
        lead = com[2] / self._gravity * (velocity - self._first) / seconds
        look[0] -= lead
        weight = 1.0 / (1.0 + abs(lead / _STEADY) ** 2)  # what the limbs do to the ZMP grows with it
        self._products[foot] += weight * np.outer(look, look.conj())
        self._windows[foot] += 1
        self._weights[foot] += weight
        self._begin(foot)

    def _down(self, posture: Posture, sample: Sample, foot: Foot) -> Array:
        """(3,) direction of gravity in the axes of the sole of the support foot, as far as IMU or plan say."""
        T = self._odometry.update(foot, *(x for each in WRENCHES for x in (posture.R[each], posture.p[each])))
        self._slope.update(sample, posture, foot, T)
        return T[:3, :3].T @ self._slope.down if self._slope.tilted else LEVEL

    def _distance(self, turns: tuple[int, int], feet: Sequence[Foot] = tuple(WRENCHES)) -> float:
        """RMS distance [m] of both ZMPs, with what is measured turned back; of windows with these support feet."""
        w = np.array([1.0, *(-_BACK[k] for k in turns)])
        squares = sum((w @ self._products[foot] @ w.conj()).real for foot in feet)
        return float(np.sqrt(max(squares, 0.0) / max(sum(self._weights[foot] for foot in feet), 1e-9)))

    def warnings(self) -> list[InputWarning]:
        """Present warnings; none where the sensors are so far from zero that they do not bear the weight."""
        if abs(self._total - self._samples * self.weight) > _ZEROED * self._samples * self.weight:
            return []
        turns = min(_TURNS[1:], key=self._distance)
        feet = [foot for foot, k in zip(WRENCHES, turns, strict=True) if k]  # a foot in the air shows nothing
        measured, least = self._distance(_TURNS[0], feet), self._distance(turns, feet)
        if min(self._windows[foot] for foot in feet) < _WINDOWS or measured < _SMALL or least > _BETTER * measured:
            return []
        named = {name: _ANGLES[k] for name, k in zip(WRENCHES.values(), turns, strict=True) if k}
        who = "wrenches" if len(named) == 2 else next(iter(named))
        text = (
            f"{who}: turned about the vertical, by {next(iter(named.values()))} seen from above? so the ZMP is "
            f"{1e3 * measured:.0f} mm from where the COM asks for it, turned back {1e3 * least:.0f} mm; wanted are the "
            "axes of the header's frame_id"
        )
        return [InputWarning(WarningKind.TURNED, "", text)]
