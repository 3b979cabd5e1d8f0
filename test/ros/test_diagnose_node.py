# SPDX-License-Identifier: BSD-3-Clause
"""The model that a diagnosis writes, in the predictor node: real processes, real DDS."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from conftest import PATIENCE
from ros_testing import Peer, paced, vector

from coman_reduced_model.cli.main import run
from coman_reduced_model.core.config.files import config_to_yaml, load_config
from coman_reduced_model.diagnose.result import MODEL_FILE
from coman_reduced_model.ros.tools.replay import Replay
from coman_reduced_model.sim.disturbances import make
from coman_reduced_model.sim.record import record

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.usefixtures("nodes_compiled")]


@pytest.fixture
def replayed(start, ros_domain):
    """RMS (3,) [m] of measured minus predicted COM that the node publishes while a bag is replayed to it."""

    def call(bag, config):
        peer = Peer()
        node = start.node("predictor", "--params-file", config)
        replay = Replay(peer.node, bag)
        replay.wait_for_subscribers(("joint_states", "motor_states", "left_foot/wrench", "right_foot/wrench"), PATIENCE)
        replay.play(2.0, keep_going=paced(peer, replay.bag))
        replay.close()
        assert node.stop() == 0
        residuals = np.array([vector(message.residual) for message in peer.predictions])
        peer.close()
        assert np.isfinite(residuals).all(axis=1).mean() > 0.95
        return np.sqrt(np.nanmean(residuals**2, axis=0))

    return call


def test_the_found_model_predicts_the_held_out_walk_better_in_the_node(replayed, tmp_path):
    """Springs of one leg that are half as stiff: found in one gait, and the other gait is predicted better live."""
    hidden = [make("joint_stiffness", {"where": "left", "scale": 0.5})]
    for seed, gait in enumerate(("test1", "test2")):
        record(gait, tmp_path / gait, disturbances=hidden, seed=seed, duration_s=8.0)
    train, held = tmp_path / "test1", tmp_path / "test2"
    assert run(["diagnose", str(train), "--holdout", str(held), "--out", str(tmp_path / "found")]) == 0
    found = load_config(tmp_path / "found" / MODEL_FILE)
    assert "joint_stiffness" in [effect.name for effect in found.effects]
    # Before: the same model without what was found.
    before = tmp_path / "before.yaml"
    before.write_text(config_to_yaml(dataclasses.replace(found, effects=()), "before"))
    without, with_it = replayed(held, before), replayed(held, tmp_path / "found" / MODEL_FILE)
    assert with_it[2] < 0.6 * without[2] and with_it[0] < without[0], (without, with_it)
