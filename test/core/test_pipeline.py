# SPDX-License-Identifier: BSD-3-Clause
"""A pipeline that is reset, or whose parameters change, while it runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from monitor_tools import KNEE, turned
from synthetic import JOINTS, robot, walk

from coman_reduced_model.core.base.types import Flags, Phase
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.pipeline import Pipeline
from coman_reduced_model.errors import ConfigError

SETTINGS = Config().replaced({"prediction.horizons": []})


def feed(pipeline, messages):
    return [each for stream, message in messages for each in pipeline.feed(stream, message, lambda message: message)]


def slipped_walk(seconds):
    """A walk whose knee encoder is off from the start by much more than that of nominal robots."""
    return [(s, turned(m, KNEE, 0.03) if s == JOINTS else m) for s, m in walk(seconds)]


def channels(pipeline):
    return {each.channel for each in pipeline.status().mismatches}


def test_after_a_reset_it_predicts_as_if_just_started():
    messages = list(walk(6.0))
    half = len(messages) // 2
    pipeline, fresh = Pipeline(robot(), SETTINGS), Pipeline(robot(), SETTINGS)
    first = feed(pipeline, messages[:half])
    assert np.abs(first[-1].T_odom_sole[:3, 3]).max() > 0.01, "it has walked"
    pipeline.reset()
    again, wanted = feed(pipeline, messages[half:]), feed(fresh, messages[half:])
    begun = next(each for each in again if not each.flags & Flags.NOT_INITIALISED)
    assert begun.flags & Flags.RESET and np.abs(begun.T_odom_sole[:2, 3]).max() < 0.01, "odom begins again"
    same = min(len(again), len(wanted))
    for a, b in zip(again[-same + 20 :], wanted[-same + 20 :], strict=True):
        np.testing.assert_allclose(a.predicted_com, b.predicted_com, atol=1e-6)
        np.testing.assert_allclose(a.T_odom_sole, b.T_odom_sole, atol=1e-6)
    assert pipeline.status().samples == len(first) + len(again) and pipeline.status().restarts == 0


def test_the_monitor_takes_over_another_threshold_and_keeps_what_it_has_learnt():
    pipeline = Pipeline(robot(), SETTINGS.replaced({"monitor.threshold": 1000.0}))
    feed(pipeline, slipped_walk(4.0))
    phases = pipeline.monitor.phases
    assert phases and not channels(pipeline)
    pipeline.reconfigure(SETTINGS)
    feed(pipeline, slipped_walk(5.5)[len(slipped_walk(4.0)) :])
    assert "spring/LKneeSag" in channels(pipeline) and pipeline.monitor.phases > phases


def test_the_monitor_is_switched_off_and_on():
    pipeline = Pipeline(robot(), SETTINGS)
    feed(pipeline, slipped_walk(4.0))
    assert channels(pipeline)
    off = SETTINGS.replaced({"monitor.enabled": False})
    pipeline.reconfigure(off)
    assert not channels(pipeline)
    pipeline.reconfigure(off.replaced({"monitor.enabled": True}))
    assert not pipeline.monitor.phases, "it begins again"


def test_a_baseline_that_cannot_be_read_changes_nothing(tmp_path):
    pipeline = Pipeline(robot(), SETTINGS)
    monitor = pipeline.monitor
    with pytest.raises(ConfigError, match="nowhere"):
        pipeline.reconfigure(SETTINGS.replaced({"monitor.baseline": str(tmp_path / "nowhere.yaml")}))
    assert pipeline.config is SETTINGS and pipeline.monitor is monitor


def test_another_weight_counts_for_the_support_phase():
    """Sensors that read a tenth of the forces: with the weight that they show, the phases are those of the walk."""
    pipeline = Pipeline(robot(), SETTINGS)
    light = [(s, replace(m, force=m.force * 0.1) if hasattr(m, "force") else m) for s, m in walk(4.0)]
    half = len(light) // 2
    before = {each.support.phase for each in feed(pipeline, light[:half])}
    pipeline.reconfigure(SETTINGS.replaced({"support.weight": 0.1 * robot().mass * 9.81}))
    after = {each.support.phase for each in feed(pipeline, light[half:])[100:]}  # at rest again after 0.5 s
    assert Phase.FLIGHT not in after and after >= {Phase.LEFT, Phase.RIGHT, Phase.DOUBLE} != before
