# SPDX-License-Identifier: BSD-3-Clause
"""Kinematics of the robot by Pinocchio: COM, soles and Jacobians, for any URDF with two legs.

Everything is computed with the root link of the URDF at the origin and then expressed in the frame of a sole, which is
assumed flat on the ground. Frames: `base` is the root link, `sole` the named sole. `robot.base_frame` names the trunk,
whose axes may be others: loads on it are in these, and its z is what leans.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from ...errors import RobotError
from ..base.types import Array, Foot
from .configuration import LegConfig, RobotConfig
from .force_sensor import sensor_origin
from .posture import Posture, compact
from .sole import outline, shape_points

_MOST_FRAMES = 64  # that are kept: a broken driver may name another every time
_LEG_NAMES = {Foot.LEFT: "left", Foot.RIGHT: "right"}


class Robot:
    """A URDF and the two legs in it.

    Attributes:
        root: name of the root link.
        config: with the joints of the legs, where the configuration leaves them out.
        joint_names: joints with one degree of freedom, in the order of the model; the order of all joint arrays.
        legs: indices of the joints of each leg in `joint_names`, hip to ankle.
        leg_columns: their columns in Jacobians.
        sole_columns: columns of all joints between the root link and each sole.
        shapes: outermost points (n, 3) of the collision shapes of each foot, in the frame of its sole [m].
        soles: x of the back and the front edge, y of the right and the left edge (4,) of each sole in its frame [m]: of
            these shapes, or else as long and wide as the configuration says.
    """

    def __init__(self, urdf: str, config: RobotConfig, source: str = "robot_description") -> None:
        """Build the model from URDF text.

        Raises:
            RobotError: the URDF cannot be read, has no mass, or lacks a joint or frame of the configuration.
        """
        self.urdf = urdf
        self.model = build_model(urdf, source)
        if not self.mass > 0.0:
            raise RobotError(f"{source}: the URDF has no mass (sum of all links {self.mass:g} kg)")
        self.root = next(frame.name for frame in self.model.frames if frame.type == pin.FrameType.BODY)
        joints = [
            (name, joint)
            for name, joint in zip(self.model.names[1:], self.model.joints[1:], strict=True)
            if joint.nv == 1
        ]
        self.joint_names = tuple(name for name, _ in joints)
        self.idx_v = np.array([joint.idx_v for _, joint in joints], dtype=np.intp)
        simple = [(i, joint.idx_q) for i, (_, joint) in enumerate(joints) if joint.nq == 1]
        self._continuous = [(i, joint.idx_q) for i, (_, joint) in enumerate(joints) if joint.nq == 2]
        self._from = np.array([i for i, _ in simple], dtype=np.intp)
        self._to = np.array([idx for _, idx in simple], dtype=np.intp)
        self._all = compact(self._to)
        self.base_id = self._frame(config.base_frame, "robot.base_frame", source)
        self.sole_ids: dict[Foot, int] = {}
        self.legs: dict[Foot, Array] = {}
        self.leg_columns: dict[Foot, Array] = {}
        self.sole_columns: dict[Foot, Array] = {}
        for foot, name in _LEG_NAMES.items():
            sole_frame = getattr(config, name).sole_frame
            self.sole_ids[foot] = self._frame(sole_frame, f"robot.{name}.sole_frame", source)
        self._refuse_one_leg(config, source)
        for foot, name in _LEG_NAMES.items():
            leg: LegConfig = getattr(config, name)
            chain = self._chain(foot)
            if not leg.joints:
                leg = replace(leg, joints=chain)
                config = replace(config, **{name: leg})  # type: ignore[arg-type]
            self.legs[foot] = self._leg(name, leg, chain, source)
            self.leg_columns[foot] = self.idx_v[self.legs[foot]]
            below = self.model.supports[self.model.frames[self.sole_ids[foot]].parentJoint]
            self.sole_columns[foot] = np.array([self.model.joints[j].idx_v for j in list(below)[2:]], dtype=np.intp)
        self.config = config
        x, y = 0.5 * config.foot_length, 0.5 * config.foot_width
        try:
            self.shapes = {foot: shape_points(urdf, self.model, sole) for foot, sole in self.sole_ids.items()}
        except (ValueError, TypeError):  # Pinocchio's for vectors of another length is a TypeError
            raise RobotError(
                f"{source}: a collision shape of a foot lacks numbers, or has others than wanted"
            ) from None
        outlines = {foot: outline(points) for foot, points in self.shapes.items()}
        self.soles = {f: np.array([-x, x, -y, y]) if o is None else o for f, o in outlines.items()}
        self._wrench_maps: dict[tuple[Foot, str], tuple[Array, Array]] = {}
        self._sensor_frames: dict[str, int | None] = {}
        self._sensors = {foot: sensor_origin(urdf, self.model, sole) for foot, sole in self.sole_ids.items()}

    def _frame(self, name: str, key: str, source: str) -> int:
        if not self.model.existFrame(name, pin.FrameType.BODY):
            known = ", ".join(frame.name for frame in self.model.frames if frame.type == pin.FrameType.BODY)
            raise RobotError(f"{source}: no frame {name!r} ({key}); links of the URDF: {known[:300]}")
        return int(self.model.getFrameId(name, pin.FrameType.BODY))

    def _refuse_one_leg(self, config: RobotConfig, source: str) -> None:
        chains = {foot: self._chain(foot) for foot in reversed(_LEG_NAMES)}
        above = {self.model.names[j] for j in self.model.supports[self.model.frames[self.base_id].parentJoint]}
        for foot, chain in chains.items():
            name = _LEG_NAMES[foot]
            if not chain:
                raise RobotError(
                    f"{source}: robot.{name}.sole_frame: {getattr(config, name).sole_frame!r} is not on a leg of its "
                    "own: no movable joint moves it and not the other sole"
                )
            if above.intersection(chain):
                raise RobotError(
                    f"{source}: robot.base_frame: {config.base_frame!r} is on the {name} leg, below "
                    f"{chain[0]!r}: wanted a link of the trunk"
                )

    def _chain(self, foot: Foot) -> tuple[str, ...]:
        """The movable joints that move a sole and not the other one, from the hip on."""
        below, other = (list(self.model.supports[self.model.frames[i].parentJoint]) for i in
                        (self.sole_ids[foot], self.sole_ids[foot.other]))  # fmt: skip
        return tuple(self.model.names[j] for j in below if j not in other and self.model.joints[j].nv == 1)

    def _leg(self, side: str, leg: LegConfig, chain: tuple[str, ...], source: str) -> Array:
        key = f"robot.{side}.joints"
        for name in leg.joints:
            if name not in self.joint_names:
                raise RobotError(
                    f"{source}: no movable joint {name!r} ({key}); "
                    f"joints of the URDF: {', '.join(self.joint_names)[:300]}"
                )
        if chain != leg.joints:
            raise RobotError(
                f"{source}: {key}: the joints that move {leg.sole_frame!r} and not the other sole are "
                f"{', '.join(chain)}, not {', '.join(leg.joints)}"
            )
        for kind in ("stiffness", "damping"):  # where the configuration leaves the joints out, it cannot count them
            if len(values := getattr(leg, kind)) != len(chain):
                raise RobotError(
                    f"{source}: robot.{side}.{kind}: {len(values)} values for {len(chain)} joints: {', '.join(chain)}"
                )
        return np.array([self.joint_names.index(name) for name in leg.joints], dtype=np.intp)

    @property
    def mass(self) -> float:
        """Of all links [kg]."""
        return float(pin.computeTotalMass(self.model))

    @property
    def sole_length(self) -> float:
        """Of the soles in the mean [m]."""
        return float(np.mean([front - back for back, front, *_ in self.soles.values()]))

    @property
    def mimic_joints(self) -> tuple[str, ...]:
        """Joints that follow others by the URDF (<mimic>); free in the model, so that messages must give them."""
        found = [str(joint.get("name")) for joint in ElementTree.fromstring(self.urdf.strip()).iterfind("joint[mimic]")]
        return tuple(name for name in found if name in self.joint_names)

    def sensor_frame(self, name: str) -> int | None:
        """The frame of an IMU: `robot.base_frame` if the URDF lacks it; None if it is neither on the root nor trunk."""
        if name not in self._sensor_frames:
            if len(self._sensor_frames) >= _MOST_FRAMES:
                self._sensor_frames.clear()
            self._sensor_frames[name] = self._sensor_frame(name.lstrip("/"))
        return self._sensor_frames[name]

    def _sensor_frame(self, name: str) -> int | None:
        if not self.model.existFrame(name, pin.FrameType.BODY):
            return self.base_id
        found = int(self.model.getFrameId(name, pin.FrameType.BODY))
        bodies = (1, self.model.frames[self.base_id].parentJoint)
        return found if self.model.frames[found].parentJoint in bodies else None

    def copy(self) -> Robot:
        """The same robot with a model of its own, whose inertias may be changed."""
        robot = copy(self)
        robot.model = self.model.copy()
        return robot

    def posture(self) -> Posture:
        """A workspace for one posture; link and motor side each hold one."""
        return Posture(self)

    def wrench_to_sole(self, foot: Foot, frame_id: str, force: Array, torque: Array) -> Array:
        """A wrench on the foot, given in any frame fixed to it, as (6,) force [N], torque [Nm] in its sole frame.

        Raises:
            RobotError: the frame does not exist or is not fixed to that foot.
        """
        try:
            R, p = self._wrench_maps[foot, frame_id]
        except KeyError:
            R, p = self._wrench_maps[foot, frame_id] = self._wrench_map(foot, frame_id)
        wrench = np.empty(6)
        wrench[:3] = R @ force
        wrench[3:] = R @ torque
        wrench[3] += p[1] * wrench[2] - p[2] * wrench[1]
        wrench[4] += p[2] * wrench[0] - p[0] * wrench[2]
        wrench[5] += p[0] * wrench[1] - p[1] * wrench[0]
        return wrench

    def sensor_position(self, foot: Foot) -> Array:
        """(3,) of the force sensor of a foot in its sole frame [m].

        The origin of the frame of its wrenches, unless that is the sole's; then as the URDF has it, or else the sole.
        """
        for (of, _), (_, p) in self._wrench_maps.items():
            if of == foot and p.any():
                return p
        named = self._sensors[foot]
        return np.zeros(3) if named is None else named

    def _wrench_map(self, foot: Foot, frame_id: str) -> tuple[Array, Array]:
        name = frame_id.lstrip("/")
        if not self.model.existFrame(name, pin.FrameType.BODY):
            raise RobotError(
                f"the wrench of the {_LEG_NAMES[foot]} foot is in frame {frame_id!r}, which the URDF lacks"
            )
        sole = self.model.frames[self.sole_ids[foot]]
        frame = self.model.frames[self.model.getFrameId(name, pin.FrameType.BODY)]
        if frame.parentJoint != sole.parentJoint:
            raise RobotError(
                f"the wrench of the {_LEG_NAMES[foot]} foot is in frame {frame_id!r}, which is not fixed to that foot"
            )
        M = sole.placement.actInv(frame.placement)
        return M.rotation.copy(), M.translation.copy()

    def scatter(self, q: Array, out: Array) -> None:
        """Write joint positions (nj,) into a configuration vector of the model, in place."""
        if self._continuous:
            out[self._to] = q[self._from]
            for i, idx in self._continuous:
                out[idx], out[idx + 1] = np.cos(q[i]), np.sin(q[i])
        else:
            out[self._all] = q

    def gather(self, configuration: Array) -> Array:
        """Joint positions (nj,) [rad] of a configuration vector of the model: what `scatter` wrote."""
        q = np.empty(len(self.joint_names))
        q[self._from] = configuration[self._to]
        for i, idx in self._continuous:
            q[i] = np.arctan2(configuration[idx + 1], configuration[idx])
        return q


def build_model(urdf: str, source: str) -> pin.Model:
    """The model of a URDF, its root link free.

    Raises:
        RobotError: the URDF cannot be read.
    """
    text = urdf.strip()
    if not text:
        raise RobotError(f"{source}: the URDF is empty")
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise RobotError(
            f"{source}: the URDF has a document type or entities, which could fill the memory; remove them"
        )
    try:  # checked here, because urdfdom writes its complaints to the terminal
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise RobotError(f"{source}: the URDF is not XML: {error}") from None
    if root.tag != "robot" or root.find("link") is None:
        raise RobotError(f"{source}: not a URDF: wanted <robot> with links, found <{root.tag}>")
    children = {child.get("link") for child in root.iterfind("joint/child")}
    roots = [str(link.get("name")) for link in root.iterfind("link") if link.get("name") not in children]
    if len(roots) != 1:
        raise RobotError(
            f"{source}: a URDF has one root link, this one {len(roots)}: {', '.join(roots)[:300] or 'a loop'}"
        )
    try:
        # A free-flyer root, because Pinocchio drops the root link's mass from the COM of a fixed base.
        return pin.buildModelFromXML(text, pin.JointModelFreeFlyer())
    except Exception as error:  # urdfdom's complaints reach Python as several types
        reason = " ".join(str(error).split())[:200]
        raise RobotError(f"{source}: the URDF cannot be read: {reason}{_without_limits(root)}") from None


def _without_limits(root: ElementTree.Element) -> str:
    """Joints that lack what a URDF must say of them, which is the usual reason and is printed elsewhere only."""
    names = [
        str(joint.get("name"))
        for joint in root.iterfind("joint")
        if joint.get("type") in ("revolute", "prismatic")
        and not {"effort", "velocity"} <= set(() if (limit := joint.find("limit")) is None else limit.keys())
    ]
    return f" (<limit> with effort and velocity is missing: {', '.join(names)[:200]})" if names else ""
