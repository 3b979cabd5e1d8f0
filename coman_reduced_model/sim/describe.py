# SPDX-License-Identifier: BSD-3-Clause
"""From the table of figures to the URDF and to the MuJoCo model: two descriptions, made independently of each other."""

from __future__ import annotations

from xml.etree import ElementTree as ET

import mujoco
from scipy.spatial.transform import Rotation

from .contact import Contact, Floor
from .robot_table import Link, RobotTable

TIME_STEP = 0.0005  # [s]; stiff harmonic drives on light feet swing with up to 1000 rad/s


def _numbers(*values: float) -> str:
    return " ".join(f"{round(value, 12):.12g}" for value in values)


def urdf(table: RobotTable) -> str:
    """URDF text of the robot: links, joints, sole frames, sensor frames, boxes to look at."""
    robot = ET.Element("robot", name=table.name)
    robot.append(ET.Comment(" Made from coman_reduced_model/sim/robot_table.py; change it there. BSD-3-Clause "))

    def add_link(name: str, link: Link) -> ET.Element:
        element = ET.SubElement(robot, "link", name=name)
        inertial = ET.SubElement(element, "inertial")
        ET.SubElement(inertial, "origin", xyz=_numbers(*link.com), rpy="0 0 0")
        ET.SubElement(inertial, "mass", value=_numbers(link.mass))
        ixx, iyy, izz = (_numbers(value) for value in link.inertia)
        ET.SubElement(inertial, "inertia", ixx=ixx, iyy=iyy, izz=izz, ixy="0", ixz="0", iyz="0")
        visual = ET.SubElement(element, "visual")
        ET.SubElement(visual, "origin", xyz=_numbers(*link.com), rpy="0 0 0")
        ET.SubElement(ET.SubElement(visual, "geometry"), "box", size=_numbers(*link.box))
        return element

    def add_joint(name: str, kind: str, parent: str, child: str, offset: tuple[float, float, float]) -> ET.Element:
        element = ET.SubElement(robot, "joint", name=name, type=kind)
        ET.SubElement(element, "parent", link=parent)
        ET.SubElement(element, "child", link=child)
        ET.SubElement(element, "origin", xyz=_numbers(*offset), rpy="0 0 0")
        return element

    add_link("base_link", table.trunk)
    for joint in table.joints():
        link = add_link(joint.child, joint.link)
        if joint.child.endswith("foot"):
            collision = ET.SubElement(link, "collision")
            size, centre = foot_box(table)
            ET.SubElement(collision, "origin", xyz=_numbers(*centre), rpy="0 0 0")
            ET.SubElement(ET.SubElement(collision, "geometry"), "box", size=_numbers(*size))
        element = add_joint(joint.name, "revolute", joint.parent, joint.child, joint.offset)
        ET.SubElement(element, "axis", xyz=_numbers(*joint.axis))
        lower, upper = (_numbers(limit) for limit in joint.limits)
        effort, velocity = _numbers(table.effort), _numbers(table.velocity)
        ET.SubElement(element, "limit", lower=lower, upper=upper, effort=effort, velocity=velocity)
    for name, body, offset in table.frames():
        ET.SubElement(robot, "link", name=name)
        fixed = add_joint(f"{name}_fixed", "fixed", body, name, offset)
        if name == "imu_link":
            fixed.find("origin").set("rpy", _numbers(*table.imu_turn))  # type: ignore[union-attr]
    ET.indent(robot)
    return '<?xml version="1.0"?>\n' + ET.tostring(robot, encoding="unicode") + "\n"


def _quaternion(turn: tuple[float, float, float]) -> list[float]:
    """w, x, y, z of roll, pitch, yaw [rad], as in a URDF."""
    x, y, z, w = Rotation.from_euler("xyz", turn).as_quat()
    return [float(w), float(x), float(y), float(z)]


def foot_box(table: RobotTable) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Size of the box that touches the floor and its centre seen from the ankle [m]."""
    height = table.ankle_height - table.sensor_below_ankle  # the plate below the sensor
    centre = ((table.foot_front - table.foot_back) / 2.0, 0.0, height / 2.0 - table.ankle_height)
    return (table.foot_front + table.foot_back, table.foot_width, height), centre


def mujoco_spec(table: RobotTable, contact: Contact | None = None, floor: Floor | None = None) -> mujoco.MjSpec:
    """MuJoCo model of the robot on a floor, still editable; names of bodies and joints are those of the URDF.

    The series spring and damper of a joint are one actuator whose force is k (ctrl - q) - d q'. With
    ctrl = motor + (d / k) motor' this is equation (2), k (motor - q) + d (motor' - q'); the integrator
    takes the damping implicitly.
    """
    spec = mujoco.MjSpec()
    spec.modelname = table.name
    option = spec.option
    option.timestep = TIME_STEP
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    contact = contact or Contact()
    contact.set_options(option)
    touching = contact.of_geom(table.friction)
    (floor or Floor()).add_to(spec.worldbody, touching)

    def add_body(parent: mujoco.MjsBody, name: str, offset: tuple[float, float, float], link: Link) -> mujoco.MjsBody:
        body = parent.add_body(name=name, pos=offset)
        body.explicitinertial, body.mass, body.ipos, body.inertia = True, link.mass, link.com, link.inertia
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=link.com,
            size=[edge / 2.0 for edge in link.box],
            contype=0,
            conaffinity=0,
            group=1,
            rgba=[0.7, 0.7, 0.75, 1.0],
        )
        return body

    base = add_body(
        spec.worldbody, "base_link", (0.0, 0.0, table.thigh + table.shank + table.ankle_height), table.trunk
    )
    base.add_freejoint(name="base")
    bodies = {"base_link": base}
    for joint in table.joints():
        body = bodies[joint.child] = add_body(bodies[joint.parent], joint.child, joint.offset, joint.link)
        body.add_joint(name=joint.name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=joint.axis)
        spring = spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        spring.gaintype, spring.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
        set_spring(spring, joint.stiffness, joint.damping)
        if joint.child.endswith("foot"):
            size, centre = foot_box(table)
            body.add_geom(
                name=joint.child,
                type=mujoco.mjtGeom.mjGEOM_BOX,
                pos=centre,
                size=[edge / 2.0 for edge in size],
                rgba=[0.2, 0.2, 0.25, 1.0],
                **touching,
            )
    for name, body, offset in table.frames():
        turn = table.imu_turn if name == "imu_link" else (0.0, 0.0, 0.0)
        bodies[body].add_site(name=name, pos=offset, quat=_quaternion(turn))
    return spec


def set_spring(actuator: mujoco.MjsActuator, stiffness: float, damping: float) -> None:
    """Makes an actuator of `mujoco_spec` a spring [Nm/rad] and damper [Nms/rad]."""
    actuator.gainprm[0] = stiffness
    actuator.biasprm[:3] = [0.0, -stiffness, -damping]
