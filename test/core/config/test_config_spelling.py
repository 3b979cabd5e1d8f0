# SPDX-License-Identifier: BSD-3-Clause
"""How numbers and lists are spelled in parameter files, for YAML and ROS alike."""

from __future__ import annotations

import pytest

from coman_reduced_model.core.config.files import config_to_yaml, load_config
from coman_reduced_model.core.config.schema import Config


def write(tmp_path, text: str):
    path = tmp_path / "robot.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_no_horizons_are_written_and_read(tmp_path):
    """By a list of one empty text: ROS reads no empty lists."""
    config = Config().replaced({"prediction.horizons": ()})
    text = config_to_yaml(config)
    assert load_config(write(tmp_path, text)).prediction.horizons == () and "prediction.horizons: ['']" in text


@pytest.mark.parametrize("text", ["1.5e1", "150e-1", ".15e2", "+1.5E1"])
def test_numbers_with_an_exponent_are_numbers(tmp_path, text):
    """YAML 1.1 takes some of them for texts, ROS does not."""
    path = write(tmp_path, f"/**:\n  ros__parameters:\n    model.a1: {text}\n")
    assert load_config(path).model.a1 == 15.0
