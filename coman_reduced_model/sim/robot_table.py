# SPDX-License-Identifier: BSD-3-Clause
"""The figures of the virtual robot, in one table. `describe.py` makes the URDF and the MuJoCo model from it.

Another robot is one `dataclasses.replace(COMAN, ...)` away; `ROBOTS` holds some.

Sources: (a) the paper: lower body 17.3 kg, a leg 5.9 kg, waist section 5.5 kg, 0.671 m from foot to waist, waist
0.176 m wide and 0.110 m deep; (b) the public description of the later COMAN: lengths, limits, and
link masses, which are scaled here so that a leg weighs what the paper says; (c) our own estimates where neither
says anything: centres of mass, box-shaped links for the inertia, spring and damper of the joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from ..core.base.types import Array
from ..errors import ConfigError

SIDES = (("L", "l_", 1.0), ("R", "r_", -1.0))  # prefix of joints, prefix of frames, sign of y

_STIFF = {"HipSag": 3000.0, "HipLat": 3500.0, "HipYaw": 2500.0, "KneeSag": 180.0, "AnkSag": 200.0, "AnkLat": 3000.0}
_DAMPING = {"HipSag": 12.0, "HipLat": 12.0, "HipYaw": 8.0, "KneeSag": 4.0, "AnkSag": 4.0, "AnkLat": 8.0}


@dataclass(frozen=True)
class Link:
    """A body: a box of even density, but with its centre of mass as given.

    Of a leg: the left one; y is mirrored on the right. Origin: the joint that moves it.
    """

    mass: float  # [kg]
    com: tuple[float, float, float]  # [m]
    box: tuple[float, float, float]  # [m] edges, for the inertia and for pictures

    @property
    def inertia(self) -> Array:
        """Principal inertia (3,) about the centre of mass, along the axes of the link [kg m^2]."""
        x, y, z = np.square(self.box)
        return self.mass / 12.0 * np.array([y + z, x + z, x + y])


@dataclass(frozen=True)
class Joint:
    """One joint and what hangs on it, as `RobotTable.joints` lists them for both legs."""

    name: str
    axis: tuple[float, float, float]
    parent: str  # name of a body
    child: str
    offset: tuple[float, float, float]  # [m] from the origin of the parent
    link: Link
    limits: tuple[float, float]  # [rad]
    stiffness: float  # [Nm/rad] of the series spring
    damping: float  # [Nms/rad]


@dataclass(frozen=True)
class RobotTable:
    """A biped with six joints a leg: three in one point at the hip, knee, two in one point at the ankle.

    `base_link` lies midway between the hips. Leg dictionaries go by joint name without the side.
    """

    name: str = "coman"
    trunk: Link = Link(5.5, (-0.005, 0.0, 0.077), (0.110, 0.176, 0.154))  # (a), com (c)
    hip_width: float = 0.1452  # [m] (b)
    thigh: float = 0.2258  # [m] hip to knee (b)
    shank: float = 0.201  # [m] knee to ankle (b)
    ankle_height: float = 0.09  # [m] ankle to sole (b)
    leg_mass: float = 5.9  # [kg] (a); the masses of `links` are scaled to it
    links: dict[str, Link] = field(  # masses (b), com and box (c)
        default_factory=lambda: {
            "HipSag": Link(0.893, (-0.010, 0.004, 0.000), (0.10, 0.08, 0.08)),
            "HipLat": Link(1.025, (0.005, 0.006, -0.030), (0.09, 0.09, 0.11)),
            "HipYaw": Link(1.700, (0.003, 0.004, -0.140), (0.09, 0.08, 0.18)),
            "KneeSag": Link(1.410, (0.004, 0.002, -0.085), (0.08, 0.08, 0.18)),
            "AnkSag": Link(0.730, (-0.005, 0.000, 0.000), (0.09, 0.06, 0.07)),
            "AnkLat": Link(0.667, (0.020, 0.000, -0.060), (0.20, 0.10, 0.05)),
        }
    )
    limits: dict[str, tuple[float, float]] = field(  # [rad] left leg (b); HipLat is mirrored on the right
        default_factory=lambda: {
            "HipSag": (-1.920, 0.785),
            "HipLat": (-0.436, 1.047),
            "HipYaw": (-0.873, 0.873),
            "KneeSag": (-0.175, 1.920),
            "AnkSag": (-1.222, 1.222),
            "AnkLat": (-0.611, 0.611),
        }
    )
    stiffness: dict[str, float] = field(default_factory=_STIFF.copy)  # [Nm/rad] (c)
    damping: dict[str, float] = field(default_factory=_DAMPING.copy)  # [Nms/rad] (c)
    effort: float = 55.0  # [Nm] limit in the URDF only
    velocity: float = 8.2  # [rad/s] limit in the URDF only
    foot_back: float = 0.07  # [m] behind the ankle (b)
    foot_front: float = 0.13  # [m] ahead of the ankle (b)
    foot_width: float = 0.10  # [m] (b)
    sensor_below_ankle: float = 0.065  # [m] force/torque sensor (b)
    imu_height: float = 0.077  # [m] above base_link (c)
    friction: float = 0.8  # between sole and floor
    upper: tuple[Joint, ...] = ()  # joints above the legs, parents before children; they hang on base_link
    imu_turn: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [rad] roll, pitch, yaw of imu_link in base_link
    # Gait parameters that suit the robot: knees bent; ZMP ahead of the ankle, well inside the foot.
    gait: dict[str, float] = field(
        default_factory=lambda: {"com_height_m": 0.38, "zmp_offset_x_m": 0.02, "step_width_m": 0.1452}
    )

    @property
    def imu_mount(self) -> Rotation:
        """From imu_link to base_link."""
        return Rotation.from_euler("xyz", self.imu_turn)

    @property
    def mass(self) -> float:
        """Mass of the whole robot [kg]."""
        return self.trunk.mass + 2.0 * self.leg_mass + sum(joint.link.mass for joint in self.upper)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Left leg from hip to ankle, right leg, upper body: the order of all joint arrays of the virtual robot."""
        return tuple(joint.name for joint in self.joints())

    def joints(self) -> list[Joint]:
        """The tree, parents before children: both legs, then the upper body."""
        return [*self.leg_joints(), *self.upper]

    def leg_joints(self) -> list[Joint]:
        """The twelve joints of the legs, left leg first."""
        axes = {"Sag": (0.0, 1.0, 0.0), "Lat": (1.0, 0.0, 0.0), "Yaw": (0.0, 0.0, 1.0)}
        scale = self.leg_mass / sum(link.mass for link in self.links.values())
        joints = []
        for prefix, frame, side in SIDES:
            offsets = {
                "HipSag": (0.0, side * self.hip_width / 2.0, 0.0),
                "KneeSag": (0.0, 0.0, -self.thigh),
                "AnkSag": (0.0, 0.0, -self.shank),
            }
            parent = "base_link"
            for name, child in zip(self.links, ("hip", "upper_thigh", "thigh", "shank", "ankle", "foot"), strict=True):
                link, (low, high) = self.links[name], self.limits[name]
                com = (link.com[0], side * link.com[1], link.com[2])
                if side < 0.0 and not name.endswith("Sag"):
                    low, high = -high, -low
                joints.append(
                    Joint(
                        prefix + name,
                        axes[name[-3:]],
                        parent,
                        frame + child,
                        offsets.get(name, (0.0, 0.0, 0.0)),
                        replace(link, mass=scale * link.mass, com=com),
                        (low, high),
                        self.stiffness[name],
                        self.damping[name],
                    )
                )
                parent = frame + child
        return joints

    def frames(self) -> list[tuple[str, str, tuple[float, float, float]]]:
        """Frames without mass: name, body, offset [m]; only imu_link may be turned against its body (`imu_turn`)."""
        legs = [
            (frame + name, frame + "foot", (0.0, 0.0, -z))
            for _, frame, _ in SIDES
            for name, z in (("ft", self.sensor_below_ankle), ("sole", self.ankle_height))
        ]
        return [("imu_link", "base_link", (0.0, 0.0, self.imu_height)), *legs]

    def joint_array(self, values: dict[str, float]) -> Array:
        """(12,) for the legs, both alike, from values by joint name without the side."""
        return np.array([values[joint.name[1:]] for joint in self.leg_joints()])


COMAN = RobotTable()
# Robots that are not COMAN, to see what carries over: another size, other masses, other springs.
TALL = replace(
    COMAN,
    name="tall",
    trunk=Link(12.0, (0.01, 0.0, 0.13), (0.14, 0.22, 0.30)),
    hip_width=0.17,
    thigh=0.30,
    shank=0.28,
    ankle_height=0.10,
    leg_mass=8.5,
    stiffness={**_STIFF, "HipSag": 5000.0, "HipLat": 6000.0, "AnkLat": 5000.0, "KneeSag": 420.0, "AnkSag": 480.0},
    damping={**_DAMPING, "HipSag": 20.0, "HipLat": 20.0, "AnkLat": 14.0, "KneeSag": 9.0, "AnkSag": 9.0},
    foot_back=0.08,
    foot_front=0.15,
    foot_width=0.12,
    gait={"com_height_m": 0.56, "zmp_offset_x_m": 0.025, "step_width_m": 0.17},
)
SMALL = replace(
    COMAN,
    name="small",
    trunk=Link(3.2, (-0.01, 0.0, 0.06), (0.09, 0.14, 0.12)),
    hip_width=0.12,
    thigh=0.18,
    shank=0.18,
    ankle_height=0.06,
    leg_mass=2.6,
    stiffness={**_STIFF, "KneeSag": 80.0, "AnkSag": 70.0},
    damping={**_DAMPING, "KneeSag": 1.5, "AnkSag": 1.2},
    foot_back=0.06,
    foot_front=0.10,
    foot_width=0.08,
    sensor_below_ankle=0.04,
    gait={"com_height_m": 0.30, "zmp_offset_x_m": 0.015, "step_width_m": 0.12},
)


@dataclass(frozen=True)
class UpperBody:
    """How many joints the upper body has; the usual 12 make a robot of 24.

    Raises:
        ConfigError: a number is not possible.
    """

    waist: int = 3  # 1 to 3: yaw, pitch, roll
    arm: int = 4  # 3 to 6 of each: without the yaw of the shoulder; with one or two joints of the wrist
    neck: int = 1  # 1 to 3: yaw, pitch, roll

    def __post_init__(self) -> None:
        for name, low, high in (("waist", 1, 3), ("arm", 3, 6), ("neck", 1, 3)):
            if not low <= getattr(self, name) <= high:
                raise ConfigError(f"upper body: {name} = {getattr(self, name)!r}: allowed: {low} to {high} joints")


def with_upper_body(table: RobotTable, body: UpperBody | None = None) -> RobotTable:
    """The robot with a waist, two arms, and a head: half a trunk heavier, however many joints.

    The trunk becomes the pelvis. Springs are stiffer by what the robot is heavier, and the COM is higher.
    """
    body = body or UpperBody()
    mass, (depth, width, height) = table.trunk.mass, table.trunk.box
    arm = 0.9 * (table.thigh + table.shank)
    joints: list[Joint] = []

    def chain(parent: str, at: Array, names: Sequence[str], last: str, link: Link, between: float = 0.0) -> None:
        """Joints that meet in one point of the parent, and the link that they move: masses are shares of the trunk's.

        Small links `between` the joints take their share of the link's mass.
        """
        masses = [between] * (len(names) - 1)
        links = [Link(mass * share, (0.0, 0.0, 0.0), (0.05, 0.05, 0.05)) for share in masses]
        links.append(replace(link, mass=mass * (link.mass - sum(masses))))
        offset = (float(at[0]), float(at[1]), float(at[2]))
        for k, (name, each) in enumerate(zip(names, links, strict=True), start=1):
            child = last if k == len(names) else f"{last}_{k}"
            joints.append(_upper(name, parent, child, offset, each))
            parent, offset = child, (0.0, 0.0, 0.0)

    def turns(name: str, number: int) -> list[str]:
        return [f"{name}{axis}" for axis in ("Yaw", "Sag", "Lat")[:number]]

    above = np.array([0.0, 0.0, height])
    torso = Link(0.60, (0.0, 0.0, 0.6 * height), (depth, 1.1 * width, 1.3 * height))
    chain("base_link", 0.6 * above, turns("Waist", body.waist), "torso", torso, 0.04)
    chain("torso", 1.3 * above, turns("Neck", body.neck), "head", Link(0.08, (0.0, 0.0, 0.05), (0.1, 0.1, 0.1)), 0.01)
    elbow, half = np.array([0.0, 0.0, -0.5 * arm]), Link(0.12, (0.0, 0.0, -0.25 * arm), (0.05, 0.05, 0.5 * arm))
    for side, frame, y in SIDES:
        shoulder = [f"{side}{name}" for name in ("ShSag", "ShLat", "ShYaw")[: min(body.arm - 1, 3)]]
        chain("torso", np.array([0.0, 0.7 * y * width, 1.1 * height]), shoulder, f"{frame}upper_arm", half, 0.03)
        wrist = [f"{side}{name}" for name in ("WrYaw", "WrSag")[: body.arm - 4]] if body.arm > 4 else []
        hand = Link(0.015 if wrist else 0.0, (0.0, 0.0, -0.03), (0.03, 0.05, 0.06))
        chain(f"{frame}upper_arm", elbow, [f"{side}Elbow"], f"{frame}forearm", replace(half, mass=0.05 - hand.mass))
        if wrist:
            chain(f"{frame}forearm", elbow, wrist, f"{frame}hand", hand, 0.005)
    whole = replace(table, name=f"{table.name}_whole", trunk=replace(table.trunk, mass=0.5 * mass), upper=tuple(joints))
    heavier = whole.mass / table.mass
    return replace(
        whole,
        stiffness={name: 1.1 * heavier * value for name, value in table.stiffness.items()},
        damping={name: 1.1 * heavier * value for name, value in table.damping.items()},
        gait={**table.gait, "com_height_m": table.gait["com_height_m"] + _com_height(whole) - _com_height(table)},
    )


def _upper(name: str, parent: str, child: str, offset: tuple[float, float, float], link: Link) -> Joint:
    """A joint of the upper body, with a stiff drive."""
    axes = {"Lat": (1.0, 0.0, 0.0), "Sag": (0.0, 1.0, 0.0), "bow": (0.0, 1.0, 0.0), "Yaw": (0.0, 0.0, 1.0)}
    stiffness, damping = (3000.0, 15.0) if "Waist" in name else (100.0, 0.5) if "Wr" in name else (600.0, 3.0)
    return Joint(name, axes[name[-3:]], parent, child, offset, link, (-2.6, 2.6), stiffness, damping)


def _com_height(table: RobotTable) -> float:
    """Height of the COM above base_link [m], legs straight and arms hanging."""
    heights, moment = {"base_link": 0.0}, table.trunk.mass * table.trunk.com[2]
    for joint in table.joints():
        heights[joint.child] = heights[joint.parent] + joint.offset[2]
        moment += joint.link.mass * (heights[joint.child] + joint.link.com[2])
    return moment / table.mass


ROBOTS = {robot.name: robot for robot in (COMAN, TALL, SMALL)}
