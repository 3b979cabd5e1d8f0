# SPDX-License-Identifier: BSD-3-Clause
"""What a node puts into /diagnostics, programs read back as the same numbers."""

from __future__ import annotations

from dataclasses import replace
from unittest.mock import MagicMock

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from synthetic import LEFT, robot, walk

from coman_reduced_model.bag.session import Session
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.evaluation.baselines import BASELINES
from coman_reduced_model.core.model.trunk.adaptation import Adapted
from coman_reduced_model.core.pipeline import Pipeline
from coman_reduced_model.resources import bag_path
from coman_reduced_model.ros.interface.diagnostic_report import (
    Level,
    Report,
    adapted_values,
    rate_value,
    rejected_values,
    restart_value,
    skill_values,
)
from coman_reduced_model.ros.interface.diagnostics import Diagnostics, _text


def sent(values: dict, level: Level = Level.WARN) -> Report:
    status = DiagnosticStatus(level=bytes([level]), message="a sentence with 12.5 in it")
    status.values = [KeyValue(key=key, value=_text(value)) for key, value in values.items()]
    return Report.of(status)


def test_numbers_come_back():
    skill = {"0.1": np.array((0.123456, -1.5, np.nan)), "1": np.zeros(3)}
    counts, last = {"joint_states/nan": 3, "imu/frame": 1}, {"joint_states/nan": "of 7 rad", "imu/frame": "no link: x"}
    learnt = {"LKneeSag": Adapted(0.9375, -0.00125), "RKneeSag": Adapted(1.0, 0.0)}
    report = sent(
        {
            "samples": 4,
            **rate_value("left_foot/wrench", 199.875),
            **rejected_values(counts, last),
            **skill_values(skill),
            **restart_value(2),
            **adapted_values(learnt, np.array((0.002, -0.001))),
        }
    )
    assert report.level is Level.WARN and report.message
    assert report.rates() == {"left_foot/wrench": 199.875}
    assert report.rejected() == counts
    assert report.restarts() == 2
    assert report.adapted() == learnt
    read = report.skill(("0.1", "0.4", "1"))
    assert list(read) == ["0.1", "1"]
    for h, values in read.items():
        assert list(values.values()) == pytest.approx(skill[h], nan_ok=True)


def test_nothing_was_reported():
    report = Report()
    assert report.level is Level.OK and not report.rates() and not report.rejected() and not report.skill(("0.1",))
    assert report.restarts() == 0 and not report.adapted()


@pytest.mark.parametrize("level", Level)
def test_levels_are_those_of_the_message(level):
    assert bytes([level]) == getattr(DiagnosticStatus, level.name)
    assert sent({}, level).level is level


@pytest.mark.parametrize(("rotation", "taken_over"), [("with", False), ("without", True)])
def test_the_report_says_when_simpler_predictions_have_taken_over(rotation, taken_over):
    """After 6 s of a walk by the default model, and by the paper's, which is worse than none ahead."""
    node, config = MagicMock(), Config().replaced({"model.trunk_rotation": rotation})
    node.config, node.get_fully_qualified_name.return_value = config, "/predictor"
    node.get_clock.return_value.now.return_value.to_msg.return_value = Time()
    with Session(bag_path("test1"), config) as session:
        node.pipeline, diagnostics = session.pipeline, Diagnostics(node)
        for count, prediction in enumerate(session.predictions()):
            diagnostics.on_prediction(prediction, 0.0)
            if count == 1200:
                break
        node.create_timer.call_args.args[1]()
    (array,) = node.create_publisher.return_value.publish.call_args.args
    prediction = next(each for each in array.status if each.name == "predictor: prediction")
    assert bytes(prediction.level) == DiagnosticStatus.OK and prediction.message.startswith("error RMS")
    assert ("ahead, simpler predictions have taken over from the model" in prediction.message) == taken_over
    values = {each.key: each.value for each in prediction.values}
    assert (float(values["share simpler_ahead"]) > 0.1) == taken_over
    names = {key.split()[-1]: name for key, name in values.items() if key.startswith("simpler ahead ")}
    assert bool(names) == taken_over and {*names.values()} <= {*BASELINES}
    assert all(axis in prediction.message.rpartition("model in ")[2].split(", ") for axis in names)


def test_the_report_counts_looks_that_found_wrenches_implausible():
    """Of a left foot sensor of the wrong sign, beside the sentence that says so."""
    node = MagicMock()
    node.config, node.get_fully_qualified_name.return_value = Config(), "/predictor"
    node.get_clock.return_value.now.return_value.to_msg.return_value = Time()
    node.pipeline = Pipeline(robot(), Config().replaced({"prediction.horizons": []}))
    Diagnostics(node)
    for stream, message in walk(4.0):
        flipped = replace(message, force=-message.force) if stream == LEFT else message
        node.pipeline.feed(stream, flipped, lambda message: message)
    node.create_timer.call_args.args[1]()
    (array,) = node.create_publisher.return_value.publish.call_args.args
    values = {each.key: each.value for status in array.status for each in status.values}
    assert int(values[f"implausible: {LEFT}/negative"]) > 50
