# SPDX-License-Identifier: BSD-3-Clause
"""`coman diagnose` on recorded walks: the hidden effect is named, the gap shrinks, and bad input costs one line."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import pytest
from jsonschema import Draft202012Validator
from synthetic import WRENCHES, walk, write_bag

from coman_reduced_model.cli.main import run
from coman_reduced_model.core.config.files import load_config
from coman_reduced_model.diagnose.inference.evidence import ONE_A_STEP
from coman_reduced_model.diagnose.report.contents import MATERIAL
from coman_reduced_model.resources import config_path
from coman_reduced_model.schemas import schema
from coman_reduced_model.sim.disturbances import make
from coman_reduced_model.sim.record import record
from coman_reduced_model.sim.sensors import SensorOptions

pytestmark = pytest.mark.usefixtures("without_second_process")
SECONDS = 10.0
HIDDEN = {
    "clean": None,
    "backlash": ("backlash", {"where": "RKneeSag", "width": 0.026}),
    "motor_lag": ("motor_lag", {"time_constant": 0.03}),
    "payload": ("payload", {"mass": 1.5, "z": 0.1}),
    "encoder_bias": ("encoder_bias", {"where": "LAnkSag", "bias": 0.026}),
    "encoder_delay": ("encoder_delay", {"delay": 0.03}),  # from afar, motors that are late
    "motor_compliance": ("motor_compliance", {"compliance": 5e-4}),
    "foot_slip": ("foot_slip", {"where": "right", "distance": 0.012}),
    "touchdown_impact": ("touchdown_impact", {"impulse": 1.0}),
    "wrench_bias": ("wrench_bias", {"where": "right", "fz": 25.0}),  # the foot never seems to be in the air
    "late_clock": ("late_clock", {"rate": 0.02}),
    "stiff_springs": ("joint_stiffness", {"scale": 1.5}),
    "worn_drive": ("joint_stiffness", {"where": "LAnkLat", "scale": 0.11}),
}
ECHOED = {"motor_lag", "motor_compliance"}
MADE_OTHERWISE = {  # sensors of nominal robots
    "noise_free": SensorOptions.exact(),
    "100_hz": SensorOptions(rate_hz=100.0),
    "noisy_torques": SensorOptions(torque_noise=0.5, torque_bias=0.3),
    "noisy_encoders": SensorOptions(encoder_noise=5e-4),
}


@pytest.fixture(scope="session")
def bags(tmp_path_factory):
    """A training and a held-out walk of a robot with something hidden; each recorded once."""
    known: dict[str, tuple] = {}

    def call(name: str):
        if name not in known:
            folder = tmp_path_factory.mktemp(name)
            effect = None if name in MADE_OTHERWISE else HIDDEN[name]
            hidden = [make(effect[0], dict(effect[1]))] if effect else []
            # Motor states that echo the command hide what the motors do: the harder of the two kinds of robot.
            sensors = SensorOptions(motor_source="commanded" if name in ECHOED else "measured")
            sensors = MADE_OTHERWISE.get(name, sensors)
            for seed, gait in enumerate(("test1", "test2")):
                record(gait, folder / gait, sensors=sensors, disturbances=hidden, seed=seed, duration_s=SECONDS)
            known[name] = folder / "test1", folder / "test2"
        return known[name]

    return call


@pytest.fixture
def diagnose(tmp_path, capsys):
    """Runs `coman diagnose`; gives what it prints and the folder. Never a traceback."""

    def call(*arguments):
        out = tmp_path / "diagnosis"
        capsys.readouterr()
        code = run(["diagnose", *map(str, arguments), "--out", str(out), "--json"])
        text, err = capsys.readouterr()
        assert code == 0 and "Traceback" not in err, err
        return json.loads(text), out

    return call


@pytest.fixture
def refused(tmp_path, capsys):
    """Runs `coman diagnose`, which must refuse in one line; gives the line."""

    def call(*arguments, out="diagnosis"):
        capsys.readouterr()
        code = run(["diagnose", *map(str, arguments), "--out", str(tmp_path / out), "--json"])
        text, err = capsys.readouterr()
        lines = [line for line in err.splitlines() if line.startswith("coman: ")]
        assert code == 2 and text == "" and "Traceback" not in err and len(lines) == 1, err
        return lines[0]

    return call


# --- verdicts ---


def named(result: dict, name: str, where: str, minor: bool = False) -> dict:
    assert (result["verdict"], result["only_minor"]) == ("none" if minor else "effect", minor), result["sentence"]
    assert [(effect["name"], effect["where"]) for effect in result["effects"]] == [(name, where)]
    return result["effects"][0]["parameters"]


def shrinks(result: dict, channel: str) -> None:
    gap = result["gap"]["holdout"]
    assert gap["after"][channel] < 0.7 * gap["before"][channel], (channel, gap)


def com_is_shown(result: dict) -> None:
    """Before and after, of the whole and of each effect, also where a clock was put right."""
    for which in ("before", "after"):
        assert all(0.0 < result["gap"]["holdout"][which][f"com/{axis}"] < 0.05 for axis in "xyz")
    for effect in result["effects"]:
        com = effect["com"]
        assert all(0.0 < com[which][axis] < 0.05 for which in ("before", "after") for axis in "xyz")
        assert com["steps"] > 4 and all(low < high for low, high in com["change"].values())
        assert effect["in_model"] or any(low > 0.0 for low, _ in com["change"].values())
        share = effect["explains"]["share"]
        assert effect["minor"] == (share < MATERIAL)
        if effect["explains"]["of"] == "com":
            squares = [sum(value**2 for value in com[which].values()) for which in ("before", "after")]
            assert share == pytest.approx(1.0 - squares[1] / squares[0])
        else:
            assert 0.0 < share < 1.0


@pytest.mark.slow
def test_backlash_is_found_without_foot_sensors(bags, diagnose):
    train, held = bags("backlash")
    result, _ = diagnose(train, "--holdout", held, "--set", "streams.wrench_source=torques")
    assert named(result, "backlash", "RKneeSag")["width"]["value"] == pytest.approx(0.026, rel=0.3)
    assert any("foot wrenches are computed from torques" in line for line in result["not_checked"])


@pytest.mark.slow
def test_backlash_is_found_its_joint_named_and_the_model_runs(bags, diagnose, tmp_path, capsys):
    train, held = bags("backlash")
    urdf = config_path("coman.urdf")
    result, out = diagnose(train, "--holdout", held, "--set", "prediction.adapt=true", "--urdf", urdf)
    width = named(result, "backlash", "RKneeSag")["width"]
    assert width["value"] == pytest.approx(0.026, rel=0.3) and width["interval"][0] > 0.0 and width["unit"] == "rad"
    shrinks(result, "spring/RKneeSag")
    (effect,) = result["effects"]
    assert effect["explains"]["of"] == "com" and not effect["minor"]

    # What it prints is what discrepancy.md says, and what it writes.
    assert result == json.loads((out / "diagnosis.json").read_text())
    Draft202012Validator(schema("diagnosis")).validate(result)
    assert {*result} <= {*schema("diagnosis")["properties"]}
    assert {"verdict", "effects", "ranking", "localisation", "gap", "undetectable_below", "model", "seconds"} <= set(
        result
    )
    assert {"name", "class", "where", "parameters", "evidence", "in_model", "com"} <= set(result["effects"][0])
    assert all({"name", "evidence", "holdout_gain"} <= set(entry) for entry in result["ranking"])
    ranked = [entry["evidence"] for entry in result["ranking"]]
    assert ranked == sorted(ranked, reverse=True) and result["ranking"][0]["name"] == "backlash"
    assert all({"channel", "phase", "band_hz", "excess"} <= set(entry) for entry in result["localisation"])
    for which in ("train", "holdout"):
        assert set(result["gap"][which]) == {"before", "after", "floor"}
        assert {"com/x", "com/y", "com/z"} <= set(result["gap"][which]["after"])
    assert all(value > 0.0 for values in result["undetectable_below"].values() for value in values.values())
    assert (out / "report.html").read_text().startswith("<!doctype html>")

    # The model that it writes is used as it is.
    config = load_config(out / result["model"])
    assert [(e.name, e.where) for e in config.effects][-1] == ("backlash", "RKneeSag")
    assert config.prediction.adapt and config.urdf is not None and config.urdf.samefile(urdf)
    capsys.readouterr()
    assert run(["predict", str(held), "--config", str(out / "model.yaml"), "--out", str(tmp_path / "p")]) == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "where", "channel"),
    [
        ("payload", "", "force/z"),
        ("encoder_bias", "LAnkSag", ""),
        ("wrench_bias", "right", "force/z"),
        ("foot_slip", "right", "slide/x"),
        ("touchdown_impact", "", "landing/z"),
    ],
)
def test_the_hidden_effect_is_named_at_its_place(case, where, channel, bags, diagnose):
    train, held = bags(case)
    result, _ = diagnose(train, "--holdout", held)
    parameters = named(result, case, where, minor=case == "foot_slip")  # for which the prediction does not care
    key, value = next((key, v) for key, v in HIDDEN[case][1].items() if key in parameters)
    assert parameters[key]["value"] == pytest.approx(value, rel=0.3)
    if channel:
        shrinks(result, channel)
    com_is_shown(result)
    if channel in ONE_A_STEP:
        assert (channel, "double") in {(entry["channel"], entry["phase"]) for entry in result["localisation"]}
    if case == "payload":
        law = result["laws"][channel]  # before anything is fitted
        assert law["mean"] == pytest.approx(
            9.81 * value, abs=6.0
        )  # nominal masses and sensors are some percent of 170 N off
        assert law["rms"] >= abs(law["mean"]) > 10.0 * law["floor"] > 0.0


@pytest.mark.slow
def test_late_joint_states_are_named_among_late_streams(bags, diagnose):
    train, held = bags("encoder_delay")
    result, _ = diagnose(train, "--holdout", held)
    delay = named(result, "encoder_delay", "")["delay"]
    low, high = delay["interval"]
    assert delay["value"] == pytest.approx(0.03, rel=0.1) and 0.0 < low < 0.03 < high
    assert next(iter(result["probabilities"])) == "encoder_delay@all" and result["probabilities"]["none"] < 0.1


@pytest.mark.slow
def test_a_worn_drive_is_named_with_about_its_stiffness(bags, diagnose):
    """The motion that its data sheet would give is far from its own."""
    train, held = bags("worn_drive")
    result, _ = diagnose(train, "--holdout", held)
    _, hidden = HIDDEN["worn_drive"]
    found = named(result, "joint_stiffness", hidden["where"])
    assert 1 / 1.5 < found["scale"]["value"] / hidden["scale"] < 1.5  # lost motion of nominal robots has a part


@pytest.mark.slow
def test_springs_that_are_all_too_stiff_are_named(bags, diagnose):
    """These walks hardly distinguish them from springs that grow stiff."""
    train, held = bags("stiff_springs")
    result, _ = diagnose(train, "--holdout", held)
    named(result, "joint_stiffness", "")
    effects = [name for name in result["probabilities"] if name not in ("none", "unknown")]
    assert "joint_stiffness" in effects[:2]


@pytest.mark.slow
def test_yielding_motors_that_echo_their_command_look_like_soft_joints(bags, diagnose):
    train, held = bags("motor_compliance")
    result, _ = diagnose(train, "--holdout", held)
    assert result["verdict"] in ("effect", "unknown"), result["sentence"]
    assert "motor_compliance" in [name for name in result["probabilities"] if name not in ("none", "unknown")][:3]


@pytest.mark.slow
def test_lagging_motors_that_echo_their_command_are_a_drive_delay(bags, diagnose):
    train, held = bags("motor_lag")
    result, _ = diagnose(train, "--holdout", held)
    assert result["verdict"] == "effect", result["sentence"]
    assert {effect["name"] for effect in result["effects"]} <= {"motor_lag", "transport_delay"}
    assert len(result["effects"]) == 1


@pytest.mark.slow
@pytest.mark.parametrize("name", ["clean", *MADE_OTHERWISE])
def test_a_nominal_robot_lacks_nothing(name, bags, diagnose):
    train, held = bags(name)
    result, out = diagnose(train, "--holdout", held)
    assert result["verdict"] == "none" and result["effects"] == [], result["sentence"]
    assert load_config(out / "model.yaml").active == ()


@pytest.mark.slow
def test_what_no_effect_explains_is_said(bags, diagnose):
    """A clock of the wrenches that is 2 % off: in the mean they are late, and nothing else is named.

    Enough nominal robots leave as much that the verdict may be any.
    """
    train, held = bags("late_clock")
    result, _ = diagnose(train, "--holdout", held)
    assert {effect["name"] for effect in result["effects"]} <= {"wrench_delay"}
    if result["verdict"] != "effect":
        assert result["too_much"]
        assert "than on nominal robots" in result["sentence"] or "times as much is left" in result["sentence"]


@pytest.mark.slow
def test_an_effect_that_spoils_the_predicted_com_is_not_in_the_model(tmp_path, diagnose):
    """Joint states that are 30 ms late, of which it is assumed that the trunk carries something."""
    for seed, gait in enumerate(("test1", "test2")):
        hidden = [make("encoder_delay", {"delay": 0.03})]
        record(gait, tmp_path / gait, disturbances=hidden, seed=seed, duration_s=SECONDS)
    result, out = diagnose(tmp_path / "test1", "--holdout", tmp_path / "test2", "--assume", "payload")
    (effect,) = result["effects"]
    assert effect["name"] == "payload" and effect["parameters"]
    assert load_config(out / result["model"]).active == ()
    assert not effect["in_model"] and effect["com"]["after"]["x"] > effect["com"]["before"]["x"]
    assert "makes the predicted COM of held-out walks worse" in result["sentence"] and "assumed: " in result["sentence"]
    com_is_shown(result)


@pytest.mark.slow
def test_standing_still_excites_nothing(diagnose, tmp_path):
    record("stand", tmp_path / "stand", duration_s=6.0, seed=3)
    result, _ = diagnose(tmp_path / "stand")
    assert result["verdict"] == "not_excited" and result["effects"] == [] and result["gap"]["holdout"] is None


# --- bad input ---


@pytest.fixture(scope="session")
def stepping(tmp_path_factory):
    """Three seconds of the robot made of formulas: quick to write, quick to refuse."""
    return write_bag(tmp_path_factory.mktemp("stepping") / "bag", walk(3.0))


def test_a_bag_given_twice_confirms_nothing(stepping, refused):
    assert "given twice" in refused(stepping, "--holdout", stepping)


@pytest.mark.slow
def test_a_sensor_is_turned_where_most_recordings_show_it(diagnose, refused, tmp_path):
    quarters = [make("sensor_rotation", {"where": foot, "angle": 1.571}) for foot in ("left", "right")]
    record("test1", tmp_path / "right", seed=1, duration_s=7.0)
    record("test1", tmp_path / "wrong", disturbances=quarters, seed=2, duration_s=7.0)
    result, _ = diagnose(tmp_path / "right", "--holdout", tmp_path / "wrong")
    assert any(line.startswith("wrong: wrenches: turned about the vertical") for line in result["not_checked"])
    assert "wrong: wrenches: turned about the vertical" in refused(tmp_path / "wrong", out="other")


@pytest.mark.slow
def test_a_held_out_walk_that_never_stands_is_left_out(diagnose, refused, tmp_path):
    def lifted(stream, message):
        return replace(message, force=0.0 * message.force) if stream in WRENCHES.values() else message

    fallen = write_bag(tmp_path / "fallen", walk(3.0), lifted)
    record("stand", tmp_path / "stand", duration_s=4.0, seed=3)
    result, _ = diagnose(tmp_path / "stand", "--holdout", fallen)
    (line,) = [line for line in result["not_checked"] if line.endswith("left out")]
    assert line.startswith("fallen: steady on its feet for 0.00 s of 3.0 s")
    assert result["gap"]["holdout"] is None and result["bags"]["holdout"] == []
    assert "fallen: steady on its feet" in refused(fallen, out="other")  # to find something in


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ("no_such_effect", "names:"),
        ("backlash:at=LKneeSag", "wanted NAME"),
        ("encoder_bias", "where=LHipYaw"),
        ("backlash:where=LeftKnee", "allowed: where="),
        ("gravity_stiffness", "names:"),
    ],
)
def test_nonsense_that_is_assumed(words, reason, stepping, refused):
    assert reason in refused(stepping, "--assume", words)


def test_a_folder_that_holds_something(stepping, refused, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "work.txt").write_text("mine")
    assert "not empty" in refused(stepping, out="mine")
    assert (tmp_path / "mine" / "work.txt").read_text() == "mine"


def test_too_short(refused, tmp_path):
    assert "less than 2 s" in refused(write_bag(tmp_path / "bag", walk(1.0)))


def test_no_bag_at_all(refused, tmp_path):
    assert "no such file" in refused(tmp_path / "nothing")
    assert not list(tmp_path.iterdir())


def test_another_robot(stepping, refused, tmp_path):
    record("stand", tmp_path / "tall", robot="tall", duration_s=3.0)
    shutil.rmtree(tmp_path / "diagnosis", ignore_errors=True)
    assert "another robot" in refused(stepping, "--holdout", tmp_path / "tall")
