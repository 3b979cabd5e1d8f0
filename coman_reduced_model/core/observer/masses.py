# SPDX-License-Identifier: BSD-3-Clause
"""How far the COM of a robot may lie from that of the links of its URDF."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..base.types import Array

if TYPE_CHECKING:
    from ..base.nominal import Nominal
    from ..robot.robot import Posture


def masses_covariance(link: Posture, nominal: Nominal) -> Array:
    """Covariance (3, 3) [m^2] of the COM in the base frame, by masses of the links and where they are.

    Their widths are those of data sheets: walks hardly show masses, so that what was learnt from walks is too wide.
    The covariance hardly depends on the posture: that of one sample stands for all.
    """
    model, data = link.robot.model, link.data
    mass, place, height = (
        nominal.sheets.get(name, nominal.widths[name]) for name in ("mass.spread", "com.spread", "com_z.spread")
    )
    trunk = model.frames[link.robot.base_id].parentJoint
    out = np.zeros((3, 3))
    for body in range(1, model.njoints):
        inertia = model.inertias[body]
        share = inertia.mass / link.robot.mass
        lever = data.oMi[body].act(inertia.lever) - link.com
        out += share**2 * (place**2 * np.eye(3) + mass**2 * np.outer(lever, lever))
        if body == trunk:
            out += share**2 * (height**2 - place**2) * np.outer(link.up, link.up)
    return out
