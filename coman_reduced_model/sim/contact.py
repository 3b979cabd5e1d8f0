# SPDX-License-Identifier: BSD-3-Clause
"""How soles meet the floor, and the shape of the floor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from ..core.base.types import Foot
from ..errors import ConfigError

CONES = {"elliptic": mujoco.mjtCone.mjCONE_ELLIPTIC, "pyramidal": mujoco.mjtCone.mjCONE_PYRAMIDAL}
TILED_M = 2.4  # [m] edge of the square about the start that tiles cover


@dataclass(frozen=True)
class Contact:
    """Contact of soles and floor.

    The defaults are a hard floor that is still many steps of the integrator: soles sink in by 0.1 mm (harder, and edges
    chatter), and a standing foot hardly creeps.

    Raises:
        ConfigError: a value is not possible.
    """

    cone: str = "elliptic"  # of friction: elliptic or pyramidal
    impratio: float = 10.0  # how much stiffer friction is than the normal direction; low: soles creep under load
    noslip_iterations: int = 0  # of MuJoCo's solver against creep
    solref: tuple[float, float] = (0.007, 1.0)  # time constant [s] and damping ratio of MuJoCo's contact
    solimp: tuple[float, float, float, float, float] = (0.95, 0.99, 0.001, 0.5, 2.0)
    friction: float = 0.0  # coefficient of sliding; 0: that of the robot's table
    torsional: float = 0.02  # [m] friction about the vertical over the normal force
    modulus: float = 3e6  # [Pa] of the floor in Drake, a layer of 10 mm
    dissipation: float = 1000.0  # [s/m] of Hunt and Crossley, in Drake

    def __post_init__(self) -> None:
        if self.cone not in CONES:
            raise ConfigError(f"contact: cone = {self.cone!r}: allowed: {', '.join(CONES)}")
        if not (self.impratio > 0.0 and self.solref[0] > 0.0 and self.friction >= 0.0 and self.torsional >= 0.0):
            raise ConfigError("contact: impratio, solref: allowed: positive; friction, torsional: not negative")
        if not (1e4 <= self.modulus <= 1e9 and self.dissipation >= 0.0):
            raise ConfigError("contact: modulus: allowed: 1e4 to 1e9 Pa; dissipation: not negative")
        if not 0 <= self.noslip_iterations <= 100:
            raise ConfigError(f"contact: noslip_iterations = {self.noslip_iterations}: allowed: 0 to 100")

    def set_options(self, option: Any) -> None:
        """Set what MuJoCo has once for the whole model."""
        option.cone = CONES[self.cone]
        option.impratio = self.impratio
        option.noslip_iterations = self.noslip_iterations

    def of_geom(self, friction: float) -> dict[str, Any]:
        """Arguments of a geom that touches; `friction` of the robot's table, where the contact has none of its own."""
        return {
            "friction": [self.friction or friction, self.torsional, 0.0001],
            "solref": list(self.solref),
            "solimp": list(self.solimp),
            "condim": 4,
        }


def raised(model: mujoco.MjModel) -> tuple[float, list[tuple[Any, Any]]]:
    """How high tiles stand out of the floor at most [m]; lowest and highest corner (3,) [m] of kerb and platforms."""
    corners = {
        model.geom(i).name: (model.geom_pos[i] - model.geom_size[i], model.geom_pos[i] + model.geom_size[i])
        for i in range(model.ngeom)
        if model.geom_bodyid[i] == 0 and model.geom_type[i] == mujoco.mjtGeom.mjGEOM_BOX
    }
    tiles = [high[2] for name, (_, high) in corners.items() if name.startswith("tile_")]
    return max(tiles, default=0.0), [each for name, each in corners.items() if not name.startswith("tile_")]


@dataclass(frozen=True)
class Floor:
    """Shape of the floor. Slope, kerb and platform are known to those who plan the walk; hidden ones are disturbances.

    Raises:
        ConfigError: a value is not possible.
    """

    tile_height: float = 0.0  # [m] between the lowest and the highest possible tile; 0: a plane
    tile_size: float = 0.15  # [m] edge of a square tile
    seed: int = 0  # of the heights
    roll: float = 0.0  # [rad] of the floor about x: it goes down to the right
    pitch: float = 0.0  # [rad] about y: it goes down ahead
    kerb: float = 0.0  # [m] by which the floor under the left foot is higher
    platform: float = 0.0  # [m] by which it is higher between edges: the robot steps up and down
    # [m] x of the edges, first and last under the left foot, first and last under the right foot: between the soles of
    # steps of 12 cm. A sole that stands on an edge would turn.
    edges: tuple[float, float, float, float] = (0.28, 0.77, 0.405, 0.92)

    def __post_init__(self) -> None:
        if not 0.0 <= self.tile_height <= 0.02:
            raise ConfigError(f"floor: tile_height = {self.tile_height:g}: allowed: 0 to 0.02 m")
        if not 0.05 <= self.tile_size <= 1.0:
            raise ConfigError(f"floor: tile_size = {self.tile_size:g}: allowed: 0.05 to 1 m")
        if not (abs(self.roll) <= 0.3 and abs(self.pitch) <= 0.3 and 0.0 <= self.kerb <= 0.1):
            raise ConfigError("floor: allowed: roll and pitch -0.3 to 0.3 rad, kerb 0 to 0.1 m")
        left, left_end, right, right_end = self.edges
        if not (0.0 <= self.platform <= 0.1 and left < left_end and right < right_end):
            raise ConfigError("floor: allowed: platform 0 to 0.1 m, edges that begin before they end")
        if (self.kerb > 0.0) + (self.tile_height > 0.0) + (self.platform > 0.0) > 1:
            raise ConfigError("floor: allowed: kerb, platform or tile_height")

    @property
    def down(self) -> Any:
        """(3,) direction of gravity in the axes of the floor."""
        turn = Rotation.from_euler("xyz", [self.roll, self.pitch, 0.0])
        return turn.inv().apply([0.0, 0.0, -1.0])

    def height(self, foot: Foot, x: float) -> float:
        """[m] under a foot that stands at x [m], as planned."""
        first, last = self.edges[:2] if foot == Foot.LEFT else self.edges[2:]
        return (self.kerb if foot == Foot.LEFT else 0.0) + (self.platform if first < x < last else 0.0)

    def heights(self) -> Any:
        """Tops of the tiles (n, n) [m], about zero."""
        n = int(np.ceil(TILED_M / self.tile_size))
        return self.tile_height * np.random.default_rng([31, self.seed]).uniform(-0.5, 0.5, (n, n))

    def add_to(self, world: mujoco.MjsBody, geom: dict[str, Any]) -> None:
        """Add the plane, and tiles that stand out of it; `geom`: arguments of the contact."""
        below = [0.0, 0.0, -0.5 * self.tile_height]
        world.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, pos=below, size=[10, 10, 0.1], **geom)
        if self.kerb:
            size = [5.0, 5.0, 0.5 * self.kerb]
            world.add_geom(name="kerb", type=mujoco.mjtGeom.mjGEOM_BOX, pos=[0.0, size[1], size[2]], size=size, **geom)
        if self.platform:
            for name, y, first, last in (("left", 5.0, *self.edges[:2]), ("right", -5.0, *self.edges[2:])):
                size = [0.5 * (last - first), 5.0, 0.5 * self.platform]
                at = [0.5 * (first + last), y, size[2]]
                world.add_geom(name=f"platform_{name}", type=mujoco.mjtGeom.mjGEOM_BOX, pos=at, size=size, **geom)
        if self.tile_height == 0.0:
            return
        heights, thick = self.heights(), 0.05
        start = -0.5 * self.tile_size * len(heights)
        for (i, j), height in np.ndenumerate(heights):
            centre = [start + (i + 0.5) * self.tile_size, start + (j + 0.5) * self.tile_size, float(height) - thick]
            world.add_geom(
                name=f"tile_{i}_{j}",
                type=mujoco.mjtGeom.mjGEOM_BOX,
                pos=centre,
                size=[0.5 * self.tile_size, 0.5 * self.tile_size, thick],
                **geom,
            )
