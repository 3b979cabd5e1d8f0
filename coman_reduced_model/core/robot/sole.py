# SPDX-License-Identifier: BSD-3-Clause
"""The size of a sole, from the collision geometry of its foot."""

from __future__ import annotations

import os
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from ..base.types import Array

_GROUND = 0.01  # [m] above its lowest point, up to which a foot touches the ground
_SMALLEST = 0.01  # [m] an outline that is shorter or narrower is a point or an edge, no sole
_TURN = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
_RIM = np.column_stack((np.cos(_TURN), np.sin(_TURN)))


def shape_points(urdf: str, model: pin.Model, sole: int) -> Array:
    """Outermost points (n, 3) [m], in the frame `sole`, of the foot's boxes, cylinders and spheres.

    Meshes are left out, for what a robot is must not depend on the files of a machine: see `mesh_points`.

    Raises:
        ValueError: a shape has numbers that are none.
    """
    found = [np.empty((0, 3))]
    for link, placement in _links_of_the_foot(ElementTree.fromstring(urdf.strip()), model, sole):
        for collision in link.iterfind("collision"):
            origin, geometry = collision.find("origin"), collision.find("geometry")
            place = {} if origin is None else origin.attrib
            xyz, rpy = (np.array(place.get(key, "0 0 0").split(), dtype=float) for key in ("xyz", "rpy"))
            at = placement * pin.SE3(pin.rpy.rpyToMatrix(rpy), xyz)
            for shape in () if geometry is None else geometry:
                found.append(_points(shape, at))
    points = np.concatenate(found)
    if not np.isfinite(points).all():
        raise ValueError("not finite")
    return points


def mesh_points(urdf: str, model: pin.Model, sole: int, folder: Path) -> Array:
    """The same of the foot's meshes; empty without them or their files.

    Args:
        urdf: its text.
        model: of it.
        sole: frame.
        folder: of the URDF's file, from which the files of meshes are looked for.
    """
    root = ElementTree.fromstring(urdf.strip())
    of_foot = [link for link, _ in _links_of_the_foot(root, model, sole)]
    for link in root.iterfind("link"):
        for collision in link.findall("collision"):
            mesh = collision.find("geometry/mesh")
            file = None if mesh is None or link not in of_foot else _mesh_file(str(mesh.get("filename")), folder)
            if mesh is None or file is None:
                link.remove(collision)
            else:
                mesh.set("filename", str(file))
    try:
        geometry = pin.buildGeomFromUrdfString(
            model, ElementTree.tostring(root, encoding="unicode"), pin.GeometryType.COLLISION
        )
    except Exception:  # a file that is no mesh: whatever its reader says
        return np.empty((0, 3))
    in_sole = model.frames[sole].placement.inverse()
    found = [np.empty((0, 3))]
    for each in geometry.geometryObjects:
        M = in_sole * each.placement
        found.append(np.asarray(each.geometry.vertices()) @ M.rotation.T + M.translation)
    return np.concatenate(found)


def outline(points: Array) -> Array | None:
    """Edges (4,) [m] of a sole: x of back and front, y of right and left, of the points (n, 3) that touch the ground.

    None where these span no area.
    """
    if not len(points):
        return None
    touching = points[points[:, 2] <= points[:, 2].min() + _GROUND]  # of points far off, the lowest at least
    low, high = touching.min(axis=0), touching.max(axis=0)
    if min(high[:2] - low[:2]) < _SMALLEST:
        return None
    return np.array([low[0], high[0], low[1], high[1]])


def _links_of_the_foot(
    root: ElementTree.Element, model: pin.Model, sole: int
) -> list[tuple[ElementTree.Element, pin.SE3]]:
    """The links that are fixed to a sole, each with its placement in the frame of that."""
    frame, found = model.frames[sole], []
    for link in root.iterfind("link"):
        name = str(link.get("name"))
        if model.existFrame(name, pin.FrameType.BODY):
            other = model.frames[model.getFrameId(name, pin.FrameType.BODY)]
            if other.parentJoint == frame.parentJoint:
                found.append((link, frame.placement.actInv(other.placement)))
    return found


def _points(shape: ElementTree.Element, at: pin.SE3) -> Array:
    if shape.tag == "box":
        half = 0.5 * np.array(shape.get("size", "0 0 0").split(), dtype=float)
        return np.array([at.act(half * (2.0 * np.array(corner) - 1.0)) for corner in np.ndindex(2, 2, 2)])
    radius = float(shape.get("radius", "0"))
    if shape.tag == "cylinder":
        z = 0.5 * float(shape.get("length", "0"))
        rims = [np.column_stack((radius * _RIM, np.full(len(_RIM), end))) for end in (-z, z)]
        return np.concatenate(rims) @ at.rotation.T + at.translation
    if shape.tag == "sphere":  # it touches the ground in a point
        return np.array([at.translation - [0.0, 0.0, radius]])
    return np.empty((0, 3))


def _mesh_file(name: str, folder: Path) -> Path | None:
    """The file of a mesh: beside the URDF or below, in a package that holds it, or in one of the environment.

    A URDF is input: it names no file elsewhere, not by ``..``, an absolute path or a link.
    """
    if not name.startswith("package://"):
        return _inside(folder, name.removeprefix("file://"))
    package, _, rest = name.removeprefix("package://").partition("/")
    above = [folder.absolute(), *folder.absolute().parents]
    shares = [Path(prefix) / "share" for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
    places = [each for each in above if each.name == package]
    places += [each / package for each in (*above, *shares) if package not in ("", ".", "..")]
    return next((path for place in places if (path := _inside(place, rest))), None)


def _inside(folder: Path, name: str) -> Path | None:
    """A file of a folder or below it; None if there is no such file, or it is elsewhere."""
    try:
        path = (folder / name).resolve()
        return path if path.is_relative_to(folder.resolve()) and path.is_file() else None
    except (OSError, ValueError, RuntimeError):  # names too long, with zeros, links in a circle
        return None
