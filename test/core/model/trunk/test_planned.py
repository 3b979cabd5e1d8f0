# SPDX-License-Identifier: BSD-3-Clause
"""The steps of the plan as the motors' future, where no stride is repeated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from coman_reduced_model.bag.session import Session
from coman_reduced_model.core.base.types import PlannedSteps
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.resources import bag_path

OFF_S = 3.0  # a walk has set off, and no stride has been repeated


def predicted(name, change=lambda steps, since: steps, until=np.inf):
    """The judge, and seconds and kind of the predictions of a shipped walk whose plan's steps are changed."""
    kinds, first = [], None
    with Session(bag_path(name), Config()) as session:
        predictor = session.pipeline.predictor
        for sample in session.samples():
            first = sample.stamp_ns if first is None else first
            since = (sample.stamp_ns - first) * 1e-9
            if since > until:
                break
            if sample.reference is not None:
                plan = sample.reference
                sample = replace(sample, reference=replace(plan, steps=change(plan.steps, since)))
            predictor.update(sample)
            kinds.append((since, predictor.dynamics.repeating, predictor.dynamics.stepping))
        return predictor.judge, np.array(kinds)


@pytest.mark.parametrize("name", ["test1", "test2"])
def test_while_it_sets_off_the_planned_steps_take_much_of_the_error_off(name):
    known, kinds = predicted(name, until=OFF_S)
    unknown, without = predicted(name, lambda steps, since: None, until=OFF_S)
    walks = kinds[:, 0] > 1.0
    assert kinds[walks, 2].mean() > 0.9 and not without[:, 2].any() and not kinds[:, 1].any()
    for axis in (0, 2):
        assert known.rmse()["0.2"]["model"][axis] < 0.8 * unknown.rmse()["0.2"]["model"][axis]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["test1", "test2"])
def test_what_is_published_over_a_whole_walk_is_better_with_planned_steps_and_than_any_simpler_prediction(name):
    judge, _ = predicted(name)
    without, _ = predicted(name, lambda steps, since: None)
    for axis in (0, 2):
        assert judge.skill()["0.2"][axis] > max(without.skill()["0.2"][axis] + 0.05, 0.4)


def spaced(steps: PlannedSteps, every: int, points: int) -> PlannedSteps:
    """The preview with points farther apart (`every` as many), the last one repeated."""
    at = np.minimum(every * np.arange(1, points + 1) - 1, len(steps.com) - 1)
    return replace(steps, dt=every * steps.dt, com=steps.com[at], soles=steps.soles[at], phase=steps.phase[at])


@pytest.mark.parametrize(("every", "used"), [(3, True), (5, False)])
def test_points_too_far_apart_are_not_used(every, used):
    judge, kinds = predicted("test1", lambda steps, since: spaced(steps, every, 25), until=OFF_S)
    assert (kinds[kinds[:, 0] > 1.0, 2].mean() > 0.3) == used
    without, _ = predicted("test1", lambda steps, since: None, until=OFF_S)
    assert judge.rmse()["0.2"]["published"][0] < 1.1 * without.rmse()["0.2"]["published"][0]


@pytest.mark.parametrize("dt", [1e-12, 1e-10, 3e9, 1e300])
def test_a_preview_of_any_interval_ends_in_no_traceback(dt):
    _, kinds = predicted("test1", lambda steps, since: replace(steps, dt=dt), until=1.0)
    assert len(kinds) > 150 and not kinds[:, 2].any()


def test_planned_feet_that_turn_are_taken_from_the_beginning():
    """From 2 s on all soles are planned turned by half a radian, at the same places."""
    turn = np.array([0.0, 0.0, np.sin(0.25), np.cos(0.25)])

    def turned(steps: PlannedSteps, since: float) -> PlannedSteps:
        soles = steps.soles.copy()
        soles[:, 3:7] = soles[:, 10:14] = turn if since > 2.0 else [0.0, 0.0, 0.0, 1.0]
        return replace(steps, soles=soles)

    _, kinds = predicted("test1", turned, until=2.1)
    stepping = kinds[:, 2] > 0
    assert stepping[(kinds[:, 0] > 1.5) & (kinds[:, 0] < 2.0)].all() and not stepping[kinds[:, 0] > 2.05].any()


def test_where_the_plan_has_other_feet_than_it_had_it_is_taken_from_the_beginning():
    """From 2 s on the next steps are 50 mm longer: what was planned before is forgotten, and soon known again."""

    def longer(steps: PlannedSteps, since: float) -> PlannedSteps:
        if since < 2.0:
            return steps
        soles, com = steps.soles.copy(), steps.com + [0.05, 0.0, 0.0]
        soles[:, [0, 7]] += 0.05
        return replace(steps, soles=soles, com=com)

    _, kinds = predicted("test1", longer, until=OFF_S)
    since, stepping = kinds[:, 0], kinds[:, 2] > 0
    assert stepping[(since > 1.5) & (since < 2.0)].all()
    lost = since[(since > 2.0) & ~stepping]
    assert 0.02 < lost.max() - 2.0 < 0.3


def test_a_plan_that_stands_leaves_the_deflection_as_it_is():
    """Neither fading nor simulated: one of both would move the COM of a robot that is at rest."""
    judge, kinds = predicted("stand", until=1.5)
    assert not kinds[:, 2].any()
    rmse = judge.rmse()["0.2"]
    for axis in (0, 2):  # y is not integrated by default
        assert rmse["model"][axis] == pytest.approx(rmse["deflected"][axis], rel=0.05)
