# SPDX-License-Identifier: BSD-3-Clause
"""Whether torques of loaded legs have the sign and unit of those that bear the forces under the feet."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..base.input_warning import InputWarning, WarningKind
from ..base.stream_names import JOINTS
from ..base.types import Array

_LOADED = 15  # looks at torques of a loaded leg, before a warning
_AGREE = 0.8  # correlation from which two measurements are of the same thing
_AGREE_WELL = 0.95  # of all torques, once those of single joints are reversed
_BEARS = 0.2  # of the torques of the joint that bears most: a joint with less is not judged by itself
_FACTOR = 5.0  # between them, from which one is in another unit


class TorqueSigns:
    """Compares measured torques with those that statics asks for; what agrees reversed or scaled does so clearly."""

    def __init__(self, joint_names: Sequence[str]) -> None:
        self._names = tuple(joint_names)
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._loaded = 0
        # By joint, products of torques: those that statics asks for squared, with those measured, those squared.
        self._products = np.zeros((3, len(self._names)))

    def look(self, joints: Array, needed: Array, measured: Array) -> None:
        """Take torques (n,) [Nm] of a loaded leg, whose joints have these indices; NaN where none is measured."""
        known = np.isfinite(measured)
        self._products[:, joints[known]] += np.array([needed**2, needed * measured, measured**2])[:, known]
        self._loaded += 1

    def warnings(self) -> list[InputWarning]:
        """Present warnings."""
        needed, both, measured = self._products.sum(axis=1)
        if self._loaded < _LOADED:
            return []
        if abs(both) <= _AGREE * np.sqrt(needed * measured):
            return self._of_single_torques()
        factor = both / needed
        seen = f"{JOINTS}: torques are {factor:.3g} times those that bear the forces under the feet"
        if not 1.0 / _FACTOR < abs(factor) < _FACTOR:
            return [InputWarning(WarningKind.UNIT, JOINTS, f"{seen}: in another unit? wanted are Nm")]
        if factor < 0.0:
            return [InputWarning(WarningKind.SIGN, JOINTS, f"{seen}: wrong sign? wanted is what drives the joint")]
        return self._of_single_torques()

    def _of_single_torques(self) -> list[InputWarning]:
        """Of joints that bear a good part of the load, where with their signs reversed all torques agree well."""
        needed, both, measured = self._products
        bearing = (needed > _BEARS**2 * needed.max()) & (measured > _BEARS**2 * measured.max())
        reversed_ = bearing & (both < -_AGREE * np.sqrt(needed * measured))
        then = np.where(reversed_, -both, both).sum()
        if not reversed_.any() or then < _AGREE_WELL * np.sqrt(needed.sum() * measured.sum()):
            return []
        names = ", ".join(self._names[k] for k in np.flatnonzero(reversed_))
        text = f"{JOINTS}: torques of {names} are against those that bear the forces under the feet: wrong sign?"
        return [InputWarning(WarningKind.SIGN, JOINTS, text)]
