# SPDX-License-Identifier: BSD-3-Clause
"""What RViz and Foxglove show: COM ball, prediction, support foot and horizon, in `odom`."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from ...core.base.pose import quaternion
from ...core.base.types import Array, Foot, Prediction
from ...core.robot.robot import Robot
from ...messages import ODOM, header_to, ros_types

_MEASURED = ColorRGBA(r=0.12, g=0.47, b=0.71, a=1.0)
_PREDICTED = ColorRGBA(r=1.0, g=0.5, b=0.05, a=1.0)
_FOOT = ColorRGBA(r=0.5, g=0.5, b=0.5, a=0.6)
_BALL = 0.03  # [m] diameter
_THICK = 0.004  # [m] of the foot's plate and the horizon's line


class Markers:
    """Makes one MarkerArray of a prediction; what is not known is deleted from the display."""

    def __init__(self) -> None:
        self._soles: dict[Foot, Array] = {}
        self._types = ros_types()

    def begin(self, robot: Robot) -> None:
        """Take over the soles of a robot."""
        self._soles = robot.soles

    def of(self, prediction: Prediction) -> MarkerArray:
        """Measured and predicted COM, support foot and horizon."""
        T = prediction.T_odom_sole
        header = header_to(self._types, prediction.stamp_ns, ODOM)
        x, y, z, w = quaternion(T[:3, :3])
        sole = self._soles.get(prediction.support.support_foot)
        x0, x1, y0, y1 = (0.0, 0.0, 0.0, 0.0) if sole is None else sole.tolist()
        foot = _marker(header, "support_foot", 0, Marker.CUBE, _FOOT, (x1 - x0, y1 - y0, _THICK))
        middle = T[:3, :3] @ np.array([0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.0]) + T[:3, 3]
        foot.pose = Pose(position=_point(middle), orientation=Quaternion(x=x, y=y, z=z, w=w))
        if sole is None:
            foot.action = Marker.DELETE
        line = _marker(header, "horizon", 0, Marker.LINE_STRIP, _PREDICTED, (_THICK, 0.0, 0.0))
        places = [prediction.measured_com, *(each.com for each in prediction.horizons)]
        line.points = [_point(T[:3, :3] @ p + T[:3, 3]) for p in places if np.isfinite(p).all()]
        if len(line.points) < 2:
            line.action = Marker.DELETE
        balls = [
            _ball(header, "measured", _MEASURED, T, prediction.measured_com),
            _ball(header, "predicted", _PREDICTED, T, prediction.predicted_com),
        ]
        return MarkerArray(markers=[*balls, foot, line])


def _point(p: Array) -> Point:
    x, y, z = p.tolist()
    return Point(x=x, y=y, z=z)


def _marker(header: Header, name: str, number: int, kind: int, color: ColorRGBA, size: tuple) -> Marker:
    x, y, z = size
    marker = Marker(header=header, ns=name, id=number, type=kind, action=Marker.ADD, color=color)
    marker.scale = Vector3(x=x, y=y, z=z)
    marker.pose.orientation.w = 1.0
    return marker


def _ball(header: Header, name: str, color: ColorRGBA, T: Array, com: Array) -> Marker:
    marker = _marker(header, name, 0, Marker.SPHERE, color, (_BALL, _BALL, _BALL))
    if np.isfinite(com).all():
        marker.pose.position = _point(T[:3, :3] @ com + T[:3, 3])
    else:
        marker.action = Marker.DELETE
    return marker
