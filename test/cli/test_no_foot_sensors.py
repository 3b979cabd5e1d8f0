# SPDX-License-Identifier: BSD-3-Clause
"""Robots without foot force sensors, on the command line: what is refused, and what the results say."""

from __future__ import annotations

from dataclasses import replace

import pytest
from synthetic import JOINTS, LEFT, RIGHT, walk, write_bag

from coman_reduced_model import Config, bag_path, diagnose
from coman_reduced_model.bag.session import Session
from coman_reduced_model.core.base.stream_names import CONTACTS
from coman_reduced_model.errors import BagError, ConfigError
from coman_reduced_model.offline import predict_bag


def by(source: str) -> Config:
    return Config().replaced({"streams.wrench_source": source})


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return write_bag(tmp_path_factory.mktemp("bags") / "no_wrenches", walk(1.0), skip=(LEFT, RIGHT))


def test_a_bag_without_wrenches_says_what_does_without(bag):
    with pytest.raises(
        BagError, match="no topics? /left_foot/wrench.*wrench_source: sensors; `torques` and `contacts`"
    ):
        Session(bag)


def test_a_bag_with_neither_contacts_nor_torques(bag, tmp_path):
    with pytest.raises(BagError, match=f"/{CONTACTS}.*wrench_source: contacts; `torques` and `sensors`"):
        Session(bag, by("contacts"))
    strip = lambda stream, message: replace(message, effort=None) if stream == JOINTS else message  # noqa: E731
    bare = write_bag(tmp_path / "bare", walk(1.0), strip, skip=(LEFT, RIGHT))
    with pytest.raises(BagError, match="gives no torques .effort., which streams.wrench_source: torques needs"):
        Session(bare, by("torques"))


def test_results_say_the_source(tmp_path):
    with Session(bag_path("test1"), by("torques").replaced({"prediction.horizons": []})) as session:
        summary = predict_bag(session, tmp_path / "out")
        assert not session.warnings
    assert summary["wrench_source"] == "torques"
    assert summary["flags"]["COMPUTED_WRENCH"] == summary["samples"]
    assert summary["mismatches"] == []


def test_a_diagnosis_needs_measured_wrenches():
    with pytest.raises(ConfigError, match="wrench_source: torques: a diagnosis needs measured foot wrenches"):
        diagnose([bag_path("stand")], config=by("torques"))
