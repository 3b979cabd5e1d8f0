# SPDX-License-Identifier: BSD-3-Clause
"""The table of parameters: what is refused and how it is said, and that a file says what was meant."""

from __future__ import annotations

import dataclasses
import string

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from coman_reduced_model.core.config.files import (
    config_to_yaml,
    load_config,
)
from coman_reduced_model.core.config.schema import (
    OPTIONS,
    Config,
    config_from_flat,
    parameter_table,
)
from coman_reduced_model.core.effects.catalogue import CATALOGUE
from coman_reduced_model.errors import ConfigError

TABLE = parameter_table()


def refused(values, *words):
    """The one line that refuses the values; it must contain all the words."""
    with pytest.raises(ConfigError) as error:
        config_from_flat(values, "my.yaml")
    text = str(error.value)
    assert text.startswith("my.yaml: ") and "\n" not in text
    for word in words:
        assert word in text, text
    return text


def write(tmp_path, text, name="robot.yaml"):
    path = tmp_path / name
    path.write_text(text)
    return path


# --- what is refused ---


@pytest.mark.parametrize(
    ("key", "hint"),
    [
        ("support.contact_of", "'support.contact_off'"),
        ("model.stifness", "'model.stiffness'"),
        ("robot.left.joint", "'robot.left.joints'"),
        ("effects.activ", "'effects.active'"),
    ],
)
def test_unknown_keys_are_refused_with_a_hint(key, hint):
    refused({key: 1}, f"{key}: unknown key", f"did you mean {hint}?")


def test_a_key_like_no_other_gets_no_hint():
    assert "did you mean" not in refused({"zzz": 1}, "zzz: unknown key")


WRONG = {
    "float": ["0.1", True, None, [0.1], float("nan"), float("inf")],
    "int": [1.0, "1", True, None],
    "bool": [1, "true", None],
    "str": [1, None, ["motor"], False],
    "floats": [0.1, "0.1", ["a"], [None], {"a": 1}, [True]],
    "strs": ["LHipSag", [1], 3, None],
}


@pytest.mark.parametrize("name", sorted(TABLE))
def test_every_parameter_refuses_what_is_not_of_its_type(name):
    for value in WRONG[TABLE[name].kind]:
        refused({name: value}, name, repr(value) if not isinstance(value, float) else name)


BOUNDED = [n for n, p in TABLE.items() if p.kind in ("float", "int", "floats") and (abs(p.low) < 1e300)]


@pytest.mark.parametrize("name", sorted(BOUNDED))
def test_every_bound_is_kept_and_said(name):
    p = TABLE[name]
    step = 1 if p.kind == "int" else max(1e-6, 1e-3 * abs(p.high - p.low))
    for value in (p.low - step, p.high + step):
        value = int(value) if p.kind == "int" else value
        refused({name: [value] if p.kind == "floats" else value}, name, "out of range", f"{p.low:g} to {p.high:g}")


@pytest.mark.parametrize("name", sorted(n for n, p in TABLE.items() if p.choices))
def test_choices_are_listed(name):
    value = "somthing"
    refused(
        {name: [value] if TABLE[name].kind == "strs" else value}, name, repr(value), "allowed", *TABLE[name].choices
    )


def test_a_near_miss_of_a_choice_is_hinted():
    refused({"model.stiffness": "condenced"}, "did you mean 'condensed'?")


def test_lists_must_fit_each_other():
    joints = {f"robot.{side}.joints": list(getattr(Config().robot, side).joints) for side in ("left", "right")}
    refused({**joints, "robot.left.stiffness": [100.0, 200.0]}, "robot.left.stiffness: 2 values for 6 joints")
    refused({**joints, "robot.right.damping": [1.0] * 7}, "robot.right.damping: 7 values for 6 joints")
    refused({"robot.left.stiffness": [100.0, 200.0]}, "robot.left.stiffness: 2 values, but 6 of robot.left.damping")
    twice = ["LHipSag", "LHipSag", "LHipYaw", "LKneeSag", "LAnkSag", "LAnkLat"]
    refused({"robot.left.joints": twice}, "robot.left.joints", "twice", "LHipSag")
    refused({"support.contact_on": 0.05, "support.contact_off": 0.05}, "support.contact_off", "below", "0.05")


def test_effects_are_checked():
    refused(
        {"effects.active": ["paylod"]},
        "effects.active",
        "'paylod'",
        "did you mean 'payload'?",
    )
    refused(
        {"effects.active": ["payload"], "effects.payload.where": ["left"]},
        "effects.payload.where", "'left'", "not allowed",
    )  # fmt: skip


def test_parameters_of_effects_need_a_value_for_each_place(monkeypatch):
    from coman_reduced_model.core.base.parameter import Parameter
    from coman_reduced_model.core.effects.base import Effect

    class Springs(Effect):
        name, place = "springs", "side"
        parameters = (Parameter("ratio", "float", 1.0, "1", "of the spring", 0.1, 10.0),)

    monkeypatch.setitem(CATALOGUE, "springs", Springs)
    parameter_table.cache_clear()
    try:
        flat = {"effects.active": ["springs"], "effects.springs.where": ["left", "right"]}
        config = config_from_flat({**flat, "effects.springs.ratio": [0.5, 2.0]}, "my.yaml")
        assert [(e.where, e.values["ratio"]) for e in config.effects] == [("left", 0.5), ("right", 2.0)]
        assert [e.values["ratio"] for e in config_from_flat(flat, "my.yaml").effects] == [1.0, 1.0]
        assert config.replaced({}) == config
        refused({**flat, "effects.springs.ratio": [1.0, 2.0, 3.0]}, "effects.springs.ratio: 3 values for 2 places")
        refused({**flat, "effects.springs.ratio": [11.0, 1.0]}, "effects.springs.ratio: 11.0 is out of range")
        refused({"effects.active": ["springs"]}, "effects.springs.where", "''", "'left', 'right'")
    finally:
        monkeypatch.undo()
        parameter_table.cache_clear()


# --- the table ---


def test_the_table_is_complete_and_its_nominals_are_allowed():
    assert dict(Config().flat()).keys() <= TABLE.keys()
    for name, parameter in TABLE.items():
        assert parameter.name == name and parameter.description
        if not name.startswith("effects."):
            assert parameter.check(parameter.nominal, "nominal") == parameter.nominal


def test_whole_numbers_are_numbers_and_lists_become_tuples():
    config = config_from_flat({"support.weight": 300, "prediction.horizons": [1, 0.5]}, "my.yaml")
    assert config.support.weight == 300.0 and isinstance(config.support.weight, float)
    assert config.prediction.horizons == (1.0, 0.5)


def test_a_change_leaves_the_original_alone():
    config = Config()
    other = config.replaced({"model.a1": 2.0})
    assert (config.model.a1, other.model.a1) == (1.0, 2.0)
    with pytest.raises(dataclasses.FrozenInstanceError):
        config.model.a1 = 3.0
    with pytest.raises(ConfigError, match="model.a1"):
        config.replaced({"model.a1": -1.0})


# --- files ---


def value_of(parameter):
    """Any value that the parameter allows."""
    low, high = max(parameter.low, -1e6), min(parameter.high, 1e6)
    words = st.text(string.printable, max_size=12).filter(lambda text: text != "")
    return {
        "bool": st.booleans(),
        "int": st.integers(int(low), int(high)),
        "float": st.floats(low, high),
        "str": st.sampled_from(parameter.choices) if parameter.choices else st.text(string.printable, max_size=12),
        "floats": st.lists(st.floats(low, high), min_size=1, max_size=4),
        "strs": st.lists(words, min_size=1, max_size=4),
    }[parameter.kind]


FREE = sorted(  # values that need not fit each other
    name
    for name in TABLE
    if not name.startswith(
        ("effects.", "robot.left.", "robot.right.", "support.contact", "prediction.reference", "model.trunk")
    )
)


@given(st.sets(st.sampled_from(FREE), max_size=8).flatmap(lambda keys: st.fixed_dictionaries(
    {key: value_of(TABLE[key]) for key in keys})))  # fmt: skip
@settings(deadline=None, max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_what_is_written_is_what_is_read(tmp_path, changes):
    """Any text, any number, to the last bit; comments and units do not get in the way."""
    config = Config().replaced(changes)
    path = write(tmp_path, config_to_yaml(config, "made by a test\nin two lines"))
    assert load_config(path) == dataclasses.replace(config, directory=path.parent)


def test_effects_and_legs_are_written_and_read(tmp_path):
    config = Config().replaced(
        {"effects.active": ["payload", "backlash"], "effects.payload.mass": [1.5],
         "effects.backlash.where": ["a", "b"], "effects.backlash.width": [1e-3, 2e-3], "robot.left.joints": ["a", "b"],
         "robot.left.stiffness": [1e-3, 1e7], "robot.left.damping": [0, 1]}
    )  # fmt: skip
    path = write(tmp_path, config_to_yaml(config))
    assert load_config(path) == dataclasses.replace(config, directory=path.parent)
    found = [(each.name, each.where) for each in load_config(path).effects]
    assert found == [("payload", ""), ("backlash", "a"), ("backlash", "b")]


def test_nested_and_dotted_keys_mean_the_same(tmp_path):
    dotted = write(tmp_path, "/**:\n  ros__parameters:\n    model.a1: 2.0\n    model.c1: 3\n", "a.yaml")
    nested = write(tmp_path, "/**:\n  ros__parameters:\n    model: {a1: 2.0, c1: 3}\n", "b.yaml")
    assert load_config(dotted) == load_config(nested)
    assert load_config(nested).model.c1 == 3.0


def test_the_section_of_a_node_overrides_that_of_all(tmp_path):
    path = write(
        tmp_path,
        "/**:\n  ros__parameters:\n    model.a1: 2.0\n    model.a2: 2.0\n    use_sim_time: true\n"
        "/robot1/predictor:\n  ros__parameters:\n    model.a1: 3.0\n"
        "trajectory:\n  ros__parameters:\n    gait.steps: 3\n",
    )
    config = load_config(path)
    assert (config.model.a1, config.model.a2, config.gait.steps) == (3.0, 2.0, Config().gait.steps)
    assert load_config(path, node="trajectory").gait.steps == 3
    assert load_config(path, node="trajectory").model.a1 == 2.0


def test_sections_of_two_robots_are_not_mixed(tmp_path):
    text = "".join(f"/{name}/predictor:\n  ros__parameters:\n    model.a1: 2.0\n" for name in ("one", "two"))
    with pytest.raises(ConfigError, match="/one/predictor and /two/predictor are of two robots"):
        load_config(write(tmp_path, text))
    assert load_config(write(tmp_path, text), node="trajectory").model.a1 == Config().model.a1


def test_the_order_of_sections_does_not_matter(tmp_path):
    path = write(
        tmp_path,
        "predictor:\n  ros__parameters:\n    model.a1: 3.0\n"
        "/**:\n  ros__parameters:\n    model.a1: 2.0\n    model.a2: 2.0\n",
    )
    assert (load_config(path).model.a1, load_config(path).model.a2) == (3.0, 2.0)
    assert load_config(path, node="trajectory").model.a1 == 2.0


def test_sections_of_other_packages_nodes_are_not_looked_at(tmp_path):
    path = write(
        tmp_path,
        "controller_manager:\n  ros__parameters:\n    update_rate: 200\n    legs: {type: position}\n"
        "/**:\n  ros__parameters:\n    model.a1: 2.0\n",
    )
    assert load_config(path).model.a1 == 2.0
    path.write_text(path.read_text() + "my_predictor:\n  ros__parameters: {model.a1: 2.0, model.a7: 1.0}\n")
    with pytest.raises(ConfigError, match="my_predictor: model.a7: unknown key"):
        load_config(path)


def test_a_metre_backwards_is_a_step_that_can_be_asked_for():
    assert Config().gait.changes() == {}
    for length in (-1.0, -0.03, 0.0, 1.0):
        assert Config().replaced({"gait.step_length": length}).gait.changes() == {"step_length_m": length}


def test_a_mistake_in_another_nodes_section_is_found_now(tmp_path):
    path = write(tmp_path, "trajectory:\n  ros__parameters:\n    gait.stepps: 3\n")
    with pytest.raises(ConfigError, match=r"trajectory: gait.stepps: unknown key; did you mean 'gait.steps'"):
        load_config(path, node="predictor")


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("", "wanted a ROS 2 parameter file"),
        ("just text", "wanted a ROS 2 parameter file"),
        ("[1, 2]", "wanted a ROS 2 parameter file"),
        ("model.a1: 2.0", "model.a1: wanted 'ros__parameters:'"),
        ("/**:\n  model.a1: 2.0", "wanted 'ros__parameters:'"),
        ("/**:\n  ros__parameters:\n    a: [1, 2\n", "is not YAML in line"),
        ("/**:\n  ros__parameters:\n\ta: 1\n", "is not YAML in line"),
        ("/**:\n  ros__parameters:\n    model: 3\n", "model: unknown key"),
        ("/**:\n  ros__parameters:\n    3: 3\n", "3: unknown key"),
    ],
)
def test_a_file_that_is_none_is_refused_in_one_line(tmp_path, text, wanted):
    path = write(tmp_path, text)
    with pytest.raises(ConfigError) as error:
        load_config(path)
    assert str(path) in str(error.value) and wanted in str(error.value) and "\n" not in str(error.value)


def test_files_that_cannot_be_read(tmp_path):
    for path in (tmp_path / "missing.yaml", tmp_path):
        with pytest.raises(ConfigError, match=r"cannot be read: "):
            load_config(path)
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(ConfigError, match="is not a text file"):
        load_config(binary)
    zeros = tmp_path / "zeros.yaml"
    zeros.write_bytes(b"\x00\x01\x02")
    with pytest.raises(ConfigError, match="is not YAML"):
        load_config(zeros)


def test_written_files_are_ros_parameter_files():
    document = yaml.safe_load(config_to_yaml(Config()))
    assert list(document) == ["/**"] and list(document["/**"]) == ["ros__parameters"]


def test_whole_numbers_with_an_exponent_are_numbers(tmp_path):
    """As for ROS; YAML 1.1 would take them for texts."""
    path = write(tmp_path, "/**:\n  ros__parameters:\n    model.a1: 1e-1\n    effects.active: [ground_compliance]\n"
                 "    effects.ground_compliance.vertical: [5e-6]\n")  # fmt: skip
    config = load_config(path)
    assert config.model.a1 == 0.1 and config.effects[0].values["vertical"] == 5e-6
    refused({"model.a1": "1e-"}, "model.a1", "'1e-' is not a number")


def test_legs_of_unequal_length_cannot_carry_a_turning_trunk():
    flat = {f"robot.left.{key}": value[:-1] for key, value in (
        ("joints", Config().robot.left.joints),
        ("stiffness", Config().robot.left.stiffness),
        ("damping", Config().robot.left.damping),
    )}  # fmt: skip
    uneven = Config().replaced(flat)
    assert len(uneven.robot.left.joints) == 5 and not uneven.turning
    with pytest.raises(ConfigError, match="equally many joints, not 5 and 6"):
        Config().replaced({**flat, "model.trunk_rotation": "with"})


def used(config: Config) -> list[str]:
    return [option for option in OPTIONS if config.uses(option)]


def test_options_of_the_model_act_on_the_motor_side_alone_unless_they_are_chosen():
    assert used(Config()) == list(OPTIONS)
    for reference in ("topic", "none"):
        assert used(Config().replaced({"prediction.reference": reference})) == []
        with pytest.raises(ConfigError, match=f"trunk_rotation: needs the motor side .* not '{reference}'"):
            Config().replaced({"prediction.reference": reference, "model.trunk_rotation": "with"})
    topic = Config().replaced({"prediction.reference": "topic", "model.lateral_compliance": "with"})
    assert used(topic) == ["lateral_compliance"]
    assert used(topic.replaced({"prediction.reference": "motor"})) == list(OPTIONS)
    assert used(Config().replaced({"model.trunk_rotation": "without"})) == [], "the others follow it"
    with pytest.raises(ConfigError, match="swing_momentum: acts with model.trunk_rotation alone"):
        Config().replaced({"model.trunk_rotation": "without", "model.swing_momentum": "with"})


@pytest.mark.parametrize(
    ("old", "options", "effects"),
    [
        (["standard"], OPTIONS, []),
        (["none"], (), []),
        (["standard", "payload"], OPTIONS, ["payload"]),
        (["gravity_stiffness", "trunk_rotation"], OPTIONS[:2], []),
        (["lateral_compliance", "payload"], ("lateral_compliance",), ["payload"]),
    ],
)
def test_keys_of_version_0_1_are_read_with_a_note(tmp_path, old, options, effects):
    path = write(tmp_path, "/**:\n  ros__parameters:\n"
                           f"    effects.active: {old}\n    effects.trunk_rotation.friction: [0.2]\n")  # fmt: skip
    config = load_config(path)
    assert used(config) == list(options) and list(config.active) == effects and config.model.friction == 0.2
    assert len(config.notes) == 2 and old[0] in config.notes[0] and "model.friction" in config.notes[1]
    again = load_config(write(tmp_path, config_to_yaml(config)))
    assert again == dataclasses.replace(config, directory=again.directory) and not again.notes
    assert config.replaced({"model.a1": 2.0}).notes == config.notes


def test_a_plain_name_is_no_list():
    refused({"effects.active": "payload"}, "effects.active", "wanted [payload]?")
