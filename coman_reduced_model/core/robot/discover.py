# SPDX-License-Identifier: BSD-3-Clause
"""Find the legs of a URDF by its kinematics: the mirrored pair of chains that ends lowest at the neutral posture.

z of the root link is taken as up. Names do not find legs: they choose among frames of one foot that are as low.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pinocchio as pin

from ...errors import RobotError
from ..base.types import Array
from .robot import build_model

_JOINTS = 3  # of a leg, at least
_LEVEL = 0.995  # z of a sole's z axis: up within 6 degrees
_ALIKE = 0.02  # of a leg's length: differences that mirrored legs and frames at one height may have
_NAMES = ("sole", "foot", "ankle")
_BY_HAND = "give them by --left FRAME --right FRAME"


@dataclass(frozen=True)
class Chain:
    """One leg: a sole frame and the movable joints between it and the base, from the hip on."""

    sole_frame: str
    joints: tuple[str, ...]


@dataclass(frozen=True)
class Legs:
    """Both legs, the trunk (by default the link that they hang on), and their length at the neutral posture [m]."""

    base_frame: str
    left: Chain
    right: Chain
    length: float
    notes: tuple[str, ...] = ()  # what looks wrong or is not part of the model, a line each


def find_legs(urdf: str, source: str, base: str = "", left: str = "", right: str = "") -> Legs:
    """The legs of a URDF; what is given by name is taken as it is.

    Raises:
        RobotError: the URDF cannot be read, has no such frame, or no pair of legs stands out.
    """
    tree = _Tree(urdf, source)
    if bool(left) != bool(right):
        raise RobotError(f"{source}: one sole frame is given: {_BY_HAND}")
    pair = (tree.frame(left), tree.frame(right)) if left else _lowest_pair(tree)
    first, second = tree.apart(*pair)
    if not first or not second:
        raise RobotError(f"{source}: {left!r} and {right!r} are not on two legs: no joint moves one of them alone")
    notes = [] if left else _odd_names(tree, pair)
    if not left and tree.y_of_other(*pair) > 0.0:
        pair = pair[1], pair[0]
    base_frame = base or tree.names[tree.common_link(*pair)]
    chains = [Chain(tree.names[f], tree.movable(each)) for f, each in zip(pair, tree.apart(*pair), strict=True)]
    if base and set(tree.support(tree.frame(base))).intersection((*first, *second)):
        raise RobotError(f"{source}: {base!r} is on a leg: wanted a link of the trunk (--base)")
    notes += _not_modelled(tree, pair)
    return Legs(base_frame, chains[0], chains[1], tree.length(*pair), tuple(notes))


class _Tree:
    """Links of a URDF at the neutral posture, z up."""

    def __init__(self, urdf: str, source: str) -> None:
        self.model, self.source = build_model(urdf, source), source
        data = self.model.createData()
        pin.framesForwardKinematics(self.model, data, pin.neutral(self.model))
        self.poses = list(data.oMf)
        self.joint_poses = list(data.oMi)
        self.names = [frame.name for frame in self.model.frames]
        self.links = [i for i, frame in enumerate(self.model.frames) if frame.type == pin.FrameType.BODY]

    def frame(self, name: str) -> int:
        """Index of a link.

        Raises:
            RobotError: there is none of that name.
        """
        if not self.model.existFrame(name, pin.FrameType.BODY):
            raise RobotError(f"{self.source}: no frame {name!r}; links: {', '.join(map(self._name, self.links))[:300]}")
        return int(self.model.getFrameId(name, pin.FrameType.BODY))

    def _name(self, index: int) -> str:
        return self.names[index]

    def support(self, frame: int) -> list[int]:
        """Joints from the root to a frame, the free root among them."""
        return list(self.model.supports[self.model.frames[frame].parentJoint])

    def apart(self, one: int, other: int) -> tuple[list[int], list[int]]:
        """The joints that move one of two frames alone."""
        first, second = self.support(one), self.support(other)
        return [j for j in first if j not in second], [j for j in second if j not in first]

    def movable(self, joints: list[int]) -> tuple[str, ...]:
        return tuple(self.model.names[j] for j in joints if self.model.joints[j].nv == 1)

    def height(self, frame: int) -> float:
        return float(self.poses[frame].translation[2])

    def length(self, one: int, other: int) -> float:
        """From the hip's height to that of the soles [m]."""
        (first, *_), _ = self.apart(one, other)
        return float(self.joint_poses[first].translation[2]) - self.height(one)

    def mirrored(self, one: int, other: int) -> bool:
        """Whether two frames end chains of equal joints and lengths, apart from each other and at one height."""
        first, second = self.apart(one, other)
        if not _JOINTS <= len(first) == len(second):
            return False
        tolerance = _ALIKE * max(self.length(one, other), 0.05)
        lengths = [self._lengths(joints, frame) for joints, frame in ((first, one), (second, other))]
        distance = np.linalg.norm(self.poses[one].translation - self.poses[other].translation)
        return bool(
            abs(self.height(one) - self.height(other)) < tolerance < distance
            and np.abs(lengths[0] - lengths[1]).max() < tolerance
        )

    def _lengths(self, joints: list[int], frame: int) -> Array:
        at = [self.joint_poses[j].translation for j in joints] + [self.poses[frame].translation]
        return np.linalg.norm(np.diff(at, axis=0), axis=1)

    def y_of_other(self, one: int, other: int) -> float:
        """Lateral position of another sole in the frame of one [m]: negative if that one is the left."""
        return float(self.poses[one].actInv(self.poses[other]).translation[1])

    def common_link(self, one: int, other: int) -> int:
        """The last link on the way from the root that both frames hang on, with z up."""
        ways = []
        for frame in (one, other):
            way = [frame]
            while way[-1] != self.model.frames[way[-1]].parentFrame and way[-1]:
                way.append(self.model.frames[way[-1]].parentFrame)
            ways.append(way)
        common = [i for i in ways[0] if i in ways[1] and i in self.links]
        upright = [i for i in common if self.poses[i].rotation[2, 2] > _LEVEL]
        if not upright:
            raise RobotError(f"{self.source}: no link with z up that both legs hang on: give one by --base FRAME")
        return upright[0]


def _lowest_pair(tree: _Tree) -> tuple[int, int]:
    """The sole frames of the mirrored pair of legs that ends lowest.

    Raises:
        RobotError: there is none, or several.
    """
    level = [i for i in tree.links if tree.poses[i].rotation[2, 2] > _LEVEL]
    pairs = [pair for pair in combinations(level, 2) if tree.mirrored(*pair)]
    if not pairs:
        raise RobotError(
            f"{tree.source}: no legs found (a mirrored pair of chains of {_JOINTS} joints or more, ending in frames "
            f"with z up): {_BY_HAND}"
        )
    lowest = min(pairs, key=lambda pair: tree.height(pair[0]) + tree.height(pair[1]))
    reach = _ALIKE * tree.length(*lowest)
    ground = tree.height(lowest[0])
    low = [pair for pair in pairs if max(map(tree.height, pair)) < ground + 2.0 * reach]
    feet = {frozenset(joints[0] for joints in tree.apart(*pair)): pair for pair in low}
    if len(feet) > 1:
        names = "; ".join(f"{tree.names[a]} and {tree.names[b]}" for a, b in feet.values())
        raise RobotError(f"{tree.source}: several pairs of legs end equally low ({names[:200]}): {_BY_HAND}")
    return min(low, key=lambda pair: _rank(tree, pair))


def _rank(tree: _Tree, pair: tuple[int, int]) -> tuple[int, bool, int, float]:
    """Few joints (a toe is no sole), names that mirror each other, sole before foot, below the ankle."""
    one, other = (tree.names[i] for i in pair)
    first, _ = tree.apart(*pair)
    kind = next((i for i, word in enumerate(_NAMES) if word in one.lower()), len(_NAMES))
    ankle = tree.joint_poses[first[-1]].translation[:2]
    aside = float(np.linalg.norm(tree.poses[pair[0]].translation[:2] - ankle))
    return len(first), _bare(one) != _bare(other), kind, aside


_SIDES = re.compile(
    r"(?i:left|right|(?<![a-z])[lr](?![a-z])|^[lr](?=foot|sole|leg|ankle))|^[LR](?=[A-Z])|(?<=[a-z])[LR]$"
)


def _bare(name: str) -> str:
    return _SIDES.sub("", name).lower()


def _odd_names(tree: _Tree, pair: tuple[int, int]) -> list[str]:
    """A note where the names of the soles say that left is right."""
    left, right = pair if tree.y_of_other(*pair) < 0.0 else (pair[1], pair[0])
    words = [(_SIDES.search(tree.names[i]) or [""])[0][:1].lower() for i in (left, right)]
    if words != ["r", "l"]:
        return []
    return [
        f"{tree.names[left]!r} is to the left of {tree.names[right]!r} by the axes of the soles: do their x axes point "
        "forward? if the names are right, give them by --left and --right"
    ]


def _not_modelled(tree: _Tree, pair: tuple[int, int]) -> list[str]:
    """Joints beyond the soles, and soles that are not level."""
    notes = []
    for frame in pair:
        end = tree.model.frames[frame].parentJoint
        toes = [j for j in range(1, tree.model.njoints) if end in list(tree.model.supports[j])[:-1]]
        if toes:
            names = ", ".join(tree.movable(toes))
            notes.append(f"beyond {tree.names[frame]!r}: {names}: moves its mass, but bears no load in the model")
        if tree.poses[frame].rotation[2, 2] <= _LEVEL:
            notes.append(f"{tree.names[frame]!r} has not z up at the neutral posture, as a sole must")
    return notes
