# SPDX-License-Identifier: BSD-3-Clause
"""Soles that give way under the moment of the ground, by formulas and on robots that walk on them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from diagnose_tools import standing

from coman_reduced_model.core.base.types import Foot
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.diagnose.data.masks import masks
from coman_reduced_model.diagnose.data.recording import load
from coman_reduced_model.diagnose.inference.case import Case, examine, prepare
from coman_reduced_model.diagnose.inference.prior import prior_variance
from coman_reduced_model.diagnose.physics.balance import evaluate
from coman_reduced_model.diagnose.physics.hypotheses import unknowns
from coman_reduced_model.diagnose.physics.motion import sunk, turned, yielding_of
from coman_reduced_model.diagnose.physics.soles import softness
from coman_reduced_model.sim.contact import Contact
from coman_reduced_model.sim.worlds.run import record_world
from coman_reduced_model.sim.worlds.world import World

SOLES = {"firm": Contact(), "soft": Contact(solref=(0.0215, 1.0), solimp=(0.8, 0.95, 0.0022, 0.5, 2.0))}


def bearing(world, x: float, y: float, share: np.ndarray) -> np.ndarray:
    """(n, 6) Wrench of the left foot that bears shares (n,) of the weight at x, y [m] from the centre of its sole."""
    x0, x1, y0, y1 = world.robot.soles[Foot.LEFT]
    x, y = x + 0.5 * (x0 + x1), y + 0.5 * (y0 + y1)
    return world.robot.mass * world.gravity * share[:, None] * np.array([0.0, 0.0, 1.0, y, -x, 0.0])


def test_a_foot_turns_by_where_it_bears_and_by_the_shape_of_its_sole():
    world = standing()[1].changed(softness=1e-4)
    weight, share = world.robot.mass * world.gravity, np.array([1.0, 0.5])
    x0, x1, y0, y1 = world.robot.soles[Foot.LEFT]
    at_centre, ahead, aside = (
        turned(world, Foot.LEFT, bearing(world, *at, share), share) for at in ((0.0, 0.0), (0.02, 0.0), (0.0, 0.02))
    )
    assert at_centre == pytest.approx(0.0, abs=1e-12)
    assert ahead[:, 1] == pytest.approx(-1e-4 * 0.02 * weight, rel=0.02)  # half of the load at the same place
    assert aside[:, 0] == pytest.approx(1e-4 * ((x1 - x0) / (y1 - y0)) ** 2 * 0.02 * weight, rel=0.02)
    ground, moment = world.changed(tilting=1e-3, softness=0.0), np.array([[0.0, 0.0, 0.0, 1.0, 2.0, 0.0]])
    assert turned(ground, Foot.LEFT, moment, np.array([0.3])) == pytest.approx(1e-3 * moment[:, 3:5])


def test_a_sole_that_bears_at_its_ends_sinks_by_how_much_it_turns():
    """Two springs k, half the foot's length from its centre: 1 / (2 k) down, 1 / (2 k (L/2)^2) about y."""
    world, k = standing()[1], 1e4
    x0, x1, *_ = world.robot.soles[Foot.LEFT]
    soft = world.changed(softness=1.0 / (2.0 * k * (0.5 * (x1 - x0)) ** 2), sinking=1e-6)
    force = np.array([[0.0, 0.0, 100.0, 0.0, 0.0, 0.0]])
    assert sunk(soft, Foot.LEFT, force) == pytest.approx(100.0 / (2.0 * k) + 1e-4)


def test_a_foot_that_takes_over_the_load_where_it_bears_does_not_turn():
    """Its moment grows, but so does the pressure on its sole."""
    recording, world = standing()
    where, world = masks(recording, world), world.changed(softness=1e-4)
    motion = evaluate(recording, world, where).motion
    left = 0.5 + 0.3 * np.sin(2.0 * np.pi * recording.t)
    shares = {Foot.LEFT: left, Foot.RIGHT: 1.0 - left}
    taken_over = {foot: bearing(world, 0.05, 0.0, share) for foot, share in shares.items()}
    swayed = dict.fromkeys(shares, taken_over[Foot.LEFT])
    still, turns = (
        np.abs(yielding_of(world, wrench, motion, where.ticks, share)[0][Foot.LEFT][:, 4]).max()
        for wrench, share in ((taken_over, left), (swayed, np.full(len(left), 0.5)))
    )
    assert still < 0.05 * turns


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], tuple[Case, float]]:
    """A robot that walks on soles, and by how much a sole turns about y for a moment by how it turns about x, in truth.

    About x it turns further, which shows it best.
    """
    known: dict[str, tuple[Case, float]] = {}

    def call(soles: str) -> tuple[Case, float]:
        if soles not in known:
            folder = tmp_path_factory.mktemp(soles)
            record_world(World(contact=SOLES[soles], gait="test2", duration_s=6.0), folder / "walk")
            truth = np.load(folder / "walk.truth.npz")
            alone = (truth["right_wrench"][:, 2] < 5.0) & (truth["left_wrench"][:, 2] > 100.0) & (truth["t"] > 1.0)
            sole = truth["T_left"][alone]
            roll = np.arctan2(sole[:, 2, 1], sole[:, 2, 2])
            slope = np.polyfit(truth["left_wrench"][alone, 3], roll, 1)[0]
            recording, machine = load(folder / "walk", Config())
            prepared = prepare(recording, machine, Config())
            x0, x1, y0, y1 = machine.soles[Foot.LEFT]
            unknown = unknowns(prepared[0], prepared[1])
            case = examine(prepared, unknown, np.zeros(len(unknown)))
            known[soles] = case, -float(slope) * ((y1 - y0) / (x1 - x0)) ** 2
        return known[soles]

    return call


@pytest.mark.slow
@pytest.mark.parametrize("soles", SOLES)
def test_soft_soles_are_known_before_anything_is_compared(walked, soles):
    case, true = walked(soles)
    assert case.state.world.softness == pytest.approx(true, rel=0.4)


@pytest.mark.parametrize("laws", ["tilt", "feet", "force", "moment"])
def test_each_law_alone_finds_how_soft_the_soles_are(walked, laws):
    """Along a motion whose soles do not rock, forces and moments would find soles of the wrong sign."""
    case, true = walked("soft")
    (i,) = (k for k, each in enumerate(case.evidence.unknowns) if each.name == "softness@soles")
    variance = prior_variance(case.evidence.unknowns)
    variance[i] *= 100.0
    more = case.said_by((laws,), {}).posterior(np.zeros(len(variance)), variance).x[i]
    assert 0.4 < (case.state.world.softness + more) / true < 2.5


def test_where_nothing_shows_them_soles_are_hard():
    recording, world = standing()
    where = masks(recording, world)
    assert softness(recording, world, where, evaluate(recording, world, where)) == pytest.approx(0.0, abs=1e-9)
