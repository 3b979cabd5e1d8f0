# SPDX-License-Identifier: BSD-3-Clause
"""What the README promises of the models on the walks that are shipped."""

from __future__ import annotations

import pytest

from coman_reduced_model.bag.session import Session
from coman_reduced_model.core.config.files import load_config
from coman_reduced_model.offline import predict_bag
from coman_reduced_model.resources import bag_path, config_path


@pytest.mark.slow
@pytest.mark.parametrize("name", ["test1", "test2"])
def test_untuned_the_papers_model_explains_the_height(name, tmp_path):
    """Better than a third of the rigid robot, over the whole bag, setting off and stopping included."""
    with Session(bag_path(name), load_config(config_path("coman_paper"))) as session:
        summary = predict_bag(session, tmp_path / "out")
    assert summary["samples"] == summary["streams"]["joint_states"]["accepted"] > 2000
    assert summary["judged_samples"] > 0.99 * summary["samples"] and not summary["rejected"]
    assert summary["rmse_m"]["z"] < summary["rmse_rigid_m"]["z"] / 3.0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["test1", "test2"])
def test_untuned_the_default_explains_the_fore_aft_motion_as_well(name, tmp_path):
    """The targets are 1 mm in x and z, and a trunk that is no worse than rigid in y."""
    with Session(bag_path(name), load_config(config_path())) as session:
        summary = predict_bag(session, tmp_path / "out")
    error, rigid = summary["rmse_m"], summary["rmse_rigid_m"]
    assert error["x"] < 0.4e-3 and error["z"] < 0.12e-3 and error["y"] < rigid["y"]
    assert error["x"] < rigid["x"] / 4.0 and error["z"] < rigid["z"] / 15.0
    assert not summary["warnings"], "nothing of the default is said to be of no use"
