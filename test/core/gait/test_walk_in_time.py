# SPDX-License-Identifier: BSD-3-Clause
"""A walk in time: where it ends and begins again."""

from __future__ import annotations

import pytest

from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.gait import walk as walks
from coman_reduced_model.core.gait.walk import Walk
from coman_reduced_model.errors import ConfigError


@pytest.mark.parametrize("repeats", [True, False])
def test_whether_a_walk_repeats_may_change_while_it_lasts(repeats):
    walk = Walk(Config().replaced({"gait.repeat": not repeats}))
    walk.start(10**9)
    walk.change(Config().replaced({"gait.repeat": repeats}))
    assert walk.go_on(10**9 + round(1e9 * walk.plan.duration_s)) == repeats


@pytest.mark.parametrize(("single", "double", "steps"), [(0.5, 0.3, 14), (0.8, 0.3, 8), (0.7, 0.2, 6)])
def test_a_walk_repeats_whatever_its_length(single, double, steps):
    """The end in whole nanoseconds may come before the end in seconds."""
    gait_ = {"gait.single_support": single, "gait.double_support": double, "gait.steps": steps}
    walk = Walk(Config().replaced({**gait_, "gait.repeat": True}))
    walk.start(10**9)
    end = 10**9 + round(1e9 * walk.plan.duration_s)
    assert not walk.go_on(end - 1) and walk.go_on(end) and walk.walking(end + 1) and walk.start_ns == end


def test_a_gait_that_cannot_begin_where_the_robot_stands_is_refused(monkeypatch):
    """The node stays, and does not plan it again with every sample."""
    walk = Walk(Config().replaced({"gait.repeat": True}))
    walk.start(0)
    ended = round(walk.plan.duration_s * 1e9) + 1
    planned = []

    def fails(*arguments):
        planned.append(arguments)
        raise ConfigError("feet: too far apart")

    monkeypatch.setattr(walks, "plan_walk", fails)
    plan = walk.plan
    assert not walk.go_on(ended) and not walk.go_on(ended + 1) and len(planned) == 1 and "too far apart" in walk.refused
    assert walk.start(ended) == "cannot walk from where it stands: feet: too far apart" and walk.plan is plan
