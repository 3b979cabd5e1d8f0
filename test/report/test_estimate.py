# SPDX-License-Identifier: BSD-3-Clause
"""The section of the report on the estimate."""

import numpy as np

from coman_reduced_model.core.evaluation.run import run_of
from coman_reduced_model.report.estimate import estimate_section
from coman_reduced_model.report.page import Picture, Table, Text

RUN = run_of([])
XYZ = {"x": 0.9, "y": 0.8, "z": 1.0}


def test_with_a_truth_it_has_nees_and_a_reliability_plot():
    shares = {"0.5": 0.4, "0.9": 0.8}
    found = {
        "nis": 2.8, "inconsistent": 0.1, "steps": 7, "nees_position": 3.6, "nees_velocity": 2.0,
        "within_90": {"position": XYZ, "velocity": XYZ}, "rmse_velocity_m_s": XYZ, "rmse_encoder_velocity_m_s": XYZ,
        "reliability": {"position": shares, "velocity": shares},
    }  # fmt: skip
    parts = estimate_section({"estimate": found}, RUN, None).parts
    text = " ".join(part.text for part in parts if isinstance(part, Text))
    assert "2.8 on average" in text and "INCONSISTENT" in text and "Position: 3.6, velocity: 2.0" in text
    assert {type(part) for part in parts} == {Text, Picture, Table}


def test_the_rotation_of_the_trunk_stands_in_the_table():
    found = {
        "nis": 2.8, "steps": 7, "nees_position": 3.6, "nees_velocity": 2.0, "tilt_by_imu": 0.5,
        "within_90": {"position": XYZ, "velocity": XYZ}, "rmse_velocity_m_s": XYZ, "rmse_encoder_velocity_m_s": XYZ,
        "reliability": {}, "turn_within_90": {"turn": XYZ, "angular_velocity": XYZ},
        **{f"rmse_{of}{key}": XYZ for of in ("", "encoder_") for key in ("turn_rad", "angular_velocity_rad_s")},
    }  # fmt: skip
    parts = estimate_section({"estimate": found}, RUN, None).parts
    assert "50" in parts[0].text and "IMU" in parts[0].text
    rows = {row[0]: row[1:] for row in parts[-1].rows}
    assert rows["RMS error of the rotation of the trunk [mrad]"] == ["900.0", "800.0", "1000.0"]
    assert len(rows) == 4 + 6


def test_without_a_truth_it_has_the_innovations_alone():
    parts = estimate_section({"estimate": {"nis": 3.1, "inconsistent": 0.0}}, RUN, None).parts
    assert len(parts) == 1 and isinstance(parts[0], Text)


def test_without_an_estimate_it_is_left_out():
    for summary in ({}, {"estimate": {"nis": None}}, {"estimate": {"nis": np.nan}}):
        assert not estimate_section(summary, RUN, None).parts
