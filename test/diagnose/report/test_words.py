# SPDX-License-Identifier: BSD-3-Clause
"""The result of a diagnosis in words."""

from __future__ import annotations

import pytest

from coman_reduced_model.diagnose.report.words import effect_sentence, figures_of, meaning, place, sentence


def test_a_class_is_named_beside_the_group_only_where_none_of_it_is_there():
    width = {"width": {"value": 0.01, "unit": "rad", "interval": [0.009, 0.011]}}
    entry = {"name": "backlash", "class": "lost_motion", "where": "LKneeSag", "parameters": width, "probability": 0.6}
    assert effect_sentence({**entry, "group": ["backlash@LKneeSag"]}).endswith("cannot distinguish from it")
    said = effect_sentence({**entry, "group": ["backlash@LKneeSag", "hysteresis@LKneeSag"]})
    assert "or hysteresis of the left knee (LKneeSag), which" in said and "class" not in said


@pytest.mark.parametrize(
    ("where", "said"),
    [
        ("LKneeSag", "the left knee (LKneeSag)"),
        ("RAnkSag", "the right ankle pitch (RAnkSag)"),
        ("l_hip_roll", "the left hip roll (l_hip_roll)"),
        ("left_knee", "the left knee (left_knee)"),
        ("leg_right_knee_joint", "the right knee (leg_right_knee_joint)"),
        ("robot_left_hip_yaw", "the left hip yaw (robot_left_hip_yaw)"),
        ("RLEG_KNEE", "the right knee (RLEG_KNEE)"),
        ("lknee", "the left knee (lknee)"),
        ("rear_hip", "rear_hip"),
        ("leg_r_hip", "leg_r_hip"),
        ("joint7", "joint7"),
        ("left", "all joints of the left leg"),
    ],
)
def test_places_are_said_as_people_say_them_where_the_name_tells(where, said):
    assert place(where) == said


@pytest.mark.parametrize(
    ("verdict", "probabilities", "more", "said"),
    [
        ("none", {"none": 0.9, "payload": 0.05}, {}, "nothing is missing that this data could show"),
        ("none", {"none": 0.3, "payload": 0.4, "foot_slip@left": 0.25}, {}, "payload (40%) or foot slip of left (25%)"),
        (
            "none",
            {"none": 0.05, "unknown": 0.93},
            {},
            "perhaps something is missing: something outside the catalogue (93%)",
        ),
        ("none", {}, {}, "nothing is missing that this data could show"),  # assumed effects that cannot be fitted
        (
            "unknown",
            {"none": 0.02, "payload": 0.45, "foot_slip@left": 0.4},
            {},
            "not clear what: payload (45%) or foot",
        ),
        (
            "unknown",
            {"none": 0.02, "unknown": 0.9},
            {"too_much": ["spring/LKneeSag|any"]},
            "more is left in the spring law, LKneeSag, than on",
        ),
        (
            "unknown",
            {"none": 0.02, "unknown": 0.9},
            {"apart": {"spring/LKneeSag|any": 6.0}},
            ": 6.0 times as much is left in the spring law, LKneeSag",
        ),
        ("unknown", {"none": 0.02, "unknown": 0.9}, {"pulled_too_far": True}, "is missing: masses, zeros, gains"),
        ("unknown", {"none": 0.02, "payload": 0.9}, {"contradicted": ["payload"]}, "speaks against it"),
    ],
)
def test_a_sentence_without_a_name_says_what_is_likely(verdict, probabilities, more, said):
    result = {"verdict": verdict, "probabilities": probabilities, "too_much": [], "apart": {}, "effects": [],
              "suspected": [], "contradicted": [], "weight": {"share": 0.0, "deviation": 0.01, "allowed": 0.03},
              "only_minor": False, "clocks_apart": [], "pulled_too_far": False, **more}  # fmt: skip
    assert said in sentence(result)
    assert meaning(result)


def test_a_sentence_holds_values_intervals_and_signs():
    def effect(name: str, where: str, key: str, value: float, unit: str, kind: str | None = None) -> str:
        parameters = {key: {"value": value, "unit": unit, "interval": [0.95 * value, 1.05 * value]}}
        return effect_sentence({"name": name, "class": kind, "where": where, "parameters": parameters})

    assert effect("wrench_scale", "right", "scale", 0.93, "1").startswith(
        "the force sensor of the right foot reads 93.0"
    )
    assert "too low" in effect("encoder_bias", "LAnkSag", "bias", -0.0122, "rad")
    assert "softens" in effect("spring_nonlinearity", "LAnkSag", "cubic", -280.0, "1/rad^2")
    assert "class drive delay" in effect("motor_lag", "", "time_constant", 0.015, "s", "drive_delay")
    assert "x 5.00 ± 0.25 N" in effect("external_force", "", "x", 5.0, "N")


@pytest.mark.parametrize(
    ("value", "interval", "said"),
    [
        (0.0122, (0.011, 0.0135), "0.699 ± 0.072 degrees"),
        (0.0122, (0.0, 0.036), "0.699 (0 to 2.06) degrees"),
        (-0.0122, (-0.03, -0.01), "0.699 (0.573 to 1.72) degrees"),
    ],
)
def test_an_interval_that_is_not_about_its_value_is_said_with_both_ends(value, interval, said):
    bias = {"bias": {"value": value, "unit": "rad", "interval": list(interval)}}
    entry = {"name": "encoder_bias", "class": None, "where": "LAnkSag", "parameters": bias}
    assert said in effect_sentence(entry)


@pytest.mark.parametrize(
    ("of", "said"), [("com", "2 % of the error of the predicted COM"), ("residuals", "2 % of the")]
)
def test_what_is_real_but_hardly_matters_is_said_to_be_minor(of, said):
    slip = {"distance": {"value": 0.003, "unit": "m", "interval": [0.002, 0.004]}}
    entry = {"name": "foot_slip", "class": None, "where": "left", "parameters": slip}
    entry |= {"explains": {"of": of, "share": 0.02}, "minor": True}
    assert f"(minor: it explains {said.replace(' %', '%')}" in effect_sentence(entry)
    assert "minor" not in effect_sentence({**entry, "minor": False})
    assert "minor" not in effect_sentence({**entry, "left_out": "it makes the predicted COM worse"})


def test_sizes_are_in_units_of_a_reader():
    values, units = {"mass": 1.5, "x": 0.03, "scale": 1.125}, {"mass": "kg", "x": "kg m", "scale": "1"}
    assert figures_of(values, units) == "mass 1.5 kg, x 0.03 kg m, scale 112 %"
