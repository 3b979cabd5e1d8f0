# SPDX-License-Identifier: BSD-3-Clause
"""Where the URDF has the force sensor of a foot."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from ..base.types import Array


def sensor_origin(urdf: str, model: pin.Model, sole: int) -> Array | None:
    """Position (3,) [m], in the frame `sole`, of the force-torque sensor on its foot; None: the URDF names none.

    A sensor names the joint that it measures (`parent` or, in Gazebo, `reference`); of several on a foot, the first.
    """
    root = ElementTree.fromstring(urdf.strip())
    sensors = [(each, each.find("parent")) for each in root.iterfind("sensor")]
    named = [parent.get("joint", "") for each, parent in sensors if _is_wrench(each) and parent is not None]
    for element in root.iterfind("gazebo"):
        if any(_is_wrench(each) for each in element.iterfind("sensor")):
            named.append(element.get("reference", ""))
    foot = model.frames[sole]
    for name in named:
        if not model.existFrame(name):
            continue
        frame = model.frames[model.getFrameId(name)]
        if frame.parentJoint == foot.parentJoint:
            return np.array(foot.placement.actInv(frame.placement).translation)
    return None


def _is_wrench(sensor: ElementTree.Element) -> bool:
    return sensor.get("type") in ("force_torque", "force_torque_sensor")
