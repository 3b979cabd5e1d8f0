# SPDX-License-Identifier: BSD-3-Clause
"""`coman` as a user meets it: what it prints, what it writes, how it ends."""

from __future__ import annotations

import gc
import json
import math
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import Process, child_environment
from synthetic import CYCLE, JOINTS, MOTORS, description, names, walk, write_bag

from coman_reduced_model import __version__
from coman_reduced_model.bag.reader import Bag
from coman_reduced_model.bag.session import Session
from coman_reduced_model.cli.main import run
from coman_reduced_model.core.base.types import Flags
from coman_reduced_model.core.config.files import config_to_yaml, load_config
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.errors import BagError
from coman_reduced_model.messages import COM_PREDICTION, matrix_from, stamp_of
from coman_reduced_model.resources import config_path

COMAN = [sys.executable, "-m", "coman_reduced_model.cli.main"]


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return write_bag(tmp_path_factory.mktemp("bags") / "walk", walk(4.0))


@pytest.fixture(scope="module")
def done(bag, tmp_path_factory):
    """A bag that has been predicted: the output folder and its summary."""
    out = tmp_path_factory.mktemp("out") / "run"
    assert run(["predict", str(bag), "--out", str(out)]) == 0
    return out, json.loads((out / "summary.json").read_text())


def predict(capsys, *arguments):
    """Exit code, JSON on standard output (None without), standard error."""
    code = run(["predict", *map(str, arguments)])
    out, err = capsys.readouterr()
    return code, json.loads(out) if out.startswith("{") else None, err


def axis_values(point):
    return [point.x, point.y, point.z]


def transform_matrix(transform):
    return matrix_from(SimpleNamespace(position=transform.translation, orientation=transform.rotation))


# --- what it writes ---


def test_the_summary_has_what_is_promised(bag, done):
    _, summary = done
    assert summary["bag"] == str(bag) and summary["version"] == __version__
    assert summary["samples"] == 800 and summary["duration_s"] == pytest.approx(4.0, abs=0.01)
    assert summary["rejected"] == {} and summary["restarts"] == 0 and summary["warnings"] == []
    assert sum(summary["phases_s"].values()) == pytest.approx(summary["duration_s"])
    for key in ("mse_m2", "rmse_m", "rmse_rigid_m"):
        assert set(summary[key]) == {"x", "y", "z"}
    for axis in "xyz":
        assert summary["rmse_m"][axis] ** 2 == pytest.approx(summary["mse_m2"][axis])
    assert set(summary["skill"]) == {"0.1", "0.2", "0.4"}
    predictors = {"published", "model", "planned", "deflected", "persistence", "still", "lipm", "clairvoyant"}
    assert set(summary["horizon_rmse_m"]["0.1"]) == predictors
    assert summary["robot"]["mass_kg"] == pytest.approx(17.3, abs=0.1)
    back, front, right, left = summary["robot"]["soles_m"]["left"]
    assert back < 0.0 < front and right < left
    assert summary["config"]["prediction.reference"] == "motor"
    assert summary["realtime_factor"] == pytest.approx(summary["duration_s"] / summary["elapsed_s"])


def test_phases_are_those_of_the_loads(done):
    _, summary = done
    # A foot carries alone for about a quarter of each cycle, and a bit of the ramps.
    assert summary["phases_s"]["LEFT"] == pytest.approx(4.0 * 0.29, abs=CYCLE / 4)
    assert summary["phases_s"]["RIGHT"] == pytest.approx(4.0 * 0.29, abs=CYCLE / 4)
    assert summary["phases_s"]["FLIGHT"] < 0.1


def test_errors_per_phase_add_up_to_the_whole(done):
    _, summary = done
    phases = summary["by_phase"].values()
    assert sum(phase["samples"] for phase in phases) == summary["judged_samples"]
    for axis in "xyz":
        total = sum(phase["samples"] * phase["mse_m2"][axis] for phase in phases)
        assert total == pytest.approx(summary["judged_samples"] * summary["mse_m2"][axis])


def test_the_errors_are_those_of_the_written_predictions(done):
    """Anyone can work the table out from the bag of predictions."""
    out, summary = done
    with Bag(out / "predictions") as written:
        assert written.topics["/com/prediction"] == COM_PREDICTION and written.counts["/com/prediction"] == 800
        messages = [message for _, _, message in written.messages(["/com/prediction"])]
    judged = np.array([not Flags(message.flags).diverged for message in messages])
    for index, axis in enumerate("xyz"):
        measured, predicted, reference = (
            np.array([axis_values(getattr(message, f"{name}_position"))[index] for message in messages])
            for name in ("measured", "predicted", "reference")
        )
        assert np.nanmean((measured - predicted)[judged] ** 2) == pytest.approx(summary["mse_m2"][axis])
        assert math.sqrt(np.nanmean((measured - reference) ** 2)) == pytest.approx(
            summary["rmse_rigid_m"][axis], rel=0.02
        )
        residual = np.array([axis_values(message.residual)[index] for message in messages])
        assert np.array_equal(residual, measured - predicted, equal_nan=True)


def test_points_are_the_predictions_in_odom(done):
    out, _ = done
    with Bag(out / "predictions") as written:
        by_stamp = {
            (message.header.stamp.sec, message.header.stamp.nanosec): message
            for _, _, message in written.messages(["/com/prediction"])
        }
        points = list(written.messages(["/com/measured", "/com/predicted", "/com/reference_point"]))
        counts = dict(written.counts)
    assert 190 <= counts["/com/measured"] <= 201  # 50 Hz
    assert counts["/com/support"] >= counts["/com/measured"]
    fields = {"/com/measured": "measured_position", "/com/predicted": "predicted_position"}
    for topic, _, point in points:
        assert point.header.frame_id == "odom"
        message = by_stamp[point.header.stamp.sec, point.header.stamp.nanosec]
        position = axis_values(getattr(message, fields.get(topic, "reference_position")))
        assert matrix_from(message.sole_pose) @ [*position, 1.0] == pytest.approx([*axis_values(point.point), 1.0])


def test_the_links_in_the_written_transforms_stand_on_the_support_sole(done):
    """A display needs nothing but the written bag to show the robot where it stands."""
    out, _ = done
    with Bag(out / "predictions") as written:
        soles = {stamp_of(each.header): each for _, _, each in written.messages(["/com/prediction"])}
        odometry = {stamp_of(each.header): each for _, _, each in written.messages(["/foot_odometry"])}
        moving = [message.transforms for _, _, message in written.messages(["/tf"])]
        fixed = written.first("/tf_static").transforms
    assert 190 <= len(moving) <= 201  # 50 Hz
    for transforms in moving:
        stamp = stamp_of(transforms[0].header)
        parents = {each.child_frame_id: each for each in (*fixed, *transforms)}
        T, link = np.eye(4), soles[stamp].header.frame_id
        while link != "odom":
            T = transform_matrix(parents[link].transform) @ T
            link = parents[link].header.frame_id
        np.testing.assert_allclose(T, matrix_from(soles[stamp].sole_pose), atol=1e-9)
        root = transforms[0]
        np.testing.assert_array_equal(
            matrix_from(odometry[stamp].pose.pose), transform_matrix(root.transform), err_msg="of the root link"
        )
        assert odometry[stamp].child_frame_id == root.child_frame_id == "base_link"
        assert odometry[stamp].pose.covariance[0] == odometry[stamp].twist.covariance[0] == -1.0  # not known


def test_transforms_can_be_switched_off(bag, tmp_path, capsys):
    assert predict(capsys, bag, "--out", tmp_path / "o", "--set", "output.publish_tf=false")[0] == 0
    with Bag(tmp_path / "o" / "predictions") as written:
        assert written.counts["/foot_odometry"] and not written.counts["/tf"] and not written.counts["/tf_static"]


def test_the_configuration_that_was_used_can_be_used_again(bag, done, tmp_path, capsys):
    out, summary = done
    assert json.loads(json.dumps(load_config(out / "config.yaml").flat())) == summary["config"]
    code, again, _ = predict(capsys, bag, "--out", tmp_path / "o", "--config", out / "config.yaml", "--json")
    assert code == 0
    for key in set(summary) - {"elapsed_s", "realtime_factor"}:
        assert again[key] == summary[key], key


def test_predictions_are_those_of_the_pipeline(bag, done):
    """`coman predict` adds nothing to what the core says."""
    out, _ = done
    config = load_config(out / "config.yaml")
    with Session(bag, config) as session:
        expected = list(session.predictions())
    with Bag(out / "predictions") as written:
        got = [message for _, _, message in written.messages(["/com/prediction"])]
    assert len(got) == len(expected)
    for message, prediction in zip(got, expected, strict=True):
        assert np.array_equal(axis_values(message.predicted_position), prediction.predicted_com, equal_nan=True)
        assert message.flags == prediction.flags


def test_without_motor_states_the_rigid_robot_has_no_error_and_json_says_null(bag, tmp_path, capsys):
    code, summary, _ = predict(capsys, bag, "--out", tmp_path / "o", "--set", "prediction.reference=none", "--json")
    assert code == 0 and summary["rmse_rigid_m"] == {"x": None, "y": None, "z": None}
    assert "NaN" not in (tmp_path / "o" / "summary.json").read_text()


def test_a_reference_from_a_topic(tmp_path, capsys):
    bag = write_bag(tmp_path / "bag", walk(2.0, reference=True))
    code, summary, _ = predict(capsys, bag, "--out", tmp_path / "o", "--set", "prediction.reference=topic", "--json")
    assert code == 0 and summary["judged_samples"] > 300 and summary["rmse_rigid_m"]["x"] is not None


# --- where it takes things from ---


def test_the_robot_may_come_from_a_file(tmp_path, capsys):
    bag = write_bag(tmp_path / "bag", walk(1.0), urdf_text="")
    code, _, err = predict(capsys, bag, "--out", tmp_path / "o")
    assert code == 2 and "/robot_description" in err and "--urdf" in err
    (tmp_path / "robot.urdf").write_text(description())
    assert predict(capsys, bag, "--out", tmp_path / "o", "--urdf", tmp_path / "robot.urdf")[0] == 0
    written = tmp_path / "o" / "config.yaml"  # names the robot
    assert predict(capsys, bag, "--out", tmp_path / "again", "--config", written)[0] == 0
    text = config_to_yaml(Config().replaced({"robot.urdf": "robot.urdf"}))
    (tmp_path / "c.yaml").write_text(text)
    assert predict(capsys, bag, "--out", tmp_path / "o2", "--config", tmp_path / "c.yaml")[0] == 0


def test_topics_may_be_in_a_namespace_or_have_other_names(tmp_path, capsys):
    bag = write_bag(tmp_path / "bag", walk(1.0), namespace="/robot1")
    code, _, err = predict(capsys, bag, "--out", tmp_path / "o")
    assert code == 2 and "no topic /joint_states" in err and "/robot1/joint_states" in err
    code, summary, _ = predict(capsys, bag, "--out", tmp_path / "o", "--namespace", "robot1", "--json")
    assert code == 0 and summary["samples"] == 200
    with Bag(tmp_path / "o" / "predictions") as written:
        assert written.counts["/robot1/com/prediction"] == 200
    moved = [f"{name}:=/robot1/{name}" for name in ("joint_states", "motor_states", "robot_description")]
    moved += [f"{side}_foot/wrench:=/robot1/{side}_foot/wrench" for side in ("left", "right")]
    remaps = [item for rule in moved for item in ("--remap", rule)]
    assert predict(capsys, bag, "--out", tmp_path / "o2", *remaps)[0] == 0


# --- how it behaves ---


@pytest.mark.slow
def test_results_go_to_standard_output_and_all_else_to_standard_error(bag, tmp_path):
    command = [*COMAN, "predict", str(bag), "--out", str(tmp_path / "o"), "--json"]
    result = subprocess.run(command, capture_output=True, text=True, env=child_environment(), timeout=120)
    assert result.returncode == 0, result.stderr
    assert json.loads(result.stdout)["samples"] == 800
    assert "Traceback" not in result.stderr


def test_an_output_folder_is_not_overwritten_unasked(bag, tmp_path, capsys):
    out = tmp_path / "o"
    out.mkdir()
    (out / "mine.txt").write_text("mine")
    code, _, err = predict(capsys, bag, "--out", out)
    assert code == 2 and "--force" in err and str(out) in err
    assert predict(capsys, bag, "--out", out, "--force")[0] == 0
    assert predict(capsys, bag, "--out", out, "--force")[0] == 0
    assert sorted(path.name for path in out.iterdir()) == ["config.yaml", "mine.txt", "predictions", "summary.json"]
    assert predict(capsys, bag, "--out", tmp_path / "o" / "mine.txt")[0] == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["o"]


def test_a_command_that_fails_leaves_nothing_behind(bag, tmp_path, capsys):
    code, _, _ = predict(capsys, bag, "--out", tmp_path / "o", "--set", "robot.left.sole_frame=nobody")
    assert code == 2 and not list(tmp_path.iterdir())


@pytest.mark.slow
def test_ctrl_c_is_quiet_and_leaves_nothing_behind(tmp_path):
    bag = write_bag(tmp_path / "bag", walk(60.0))
    process = Process([*COMAN, "predict", str(bag), "--out", str(tmp_path / "o")])
    process.wait_for("%", 60.0)
    process.send(signal.SIGINT)
    assert process.wait() == 130
    assert "Traceback" not in process.output
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bag"]


@pytest.mark.slow
def test_long_work_shows_progress(tmp_path):
    bag = write_bag(tmp_path / "bag", walk(60.0))
    process = Process([*COMAN, "predict", str(bag), "--out", str(tmp_path / "o")])
    process.wait_for("predicting: ", 60.0)
    process.kill()


@pytest.mark.parametrize(
    "arguments",
    [["predict"], ["predict", "x"], ["nonsense"], ["predict", "x", "--out", "y", "--nonsense"], ["--nonsense"],
     ["record", "--out", "x", "--duration", "soon"], ["replay", "x", "--rate", "-1"], ["report"],
     *(["record", "--out", "/nowhere/x", "--gait", gait, "--duration", each]
       for gait in ("test1", "load") for each in ("-5", "nan", "0"))],
)  # fmt: skip
def test_bad_usage_is_one_line_and_exit_2(arguments, capsys):
    assert run(arguments) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.startswith("coman: ") and err.count("\n") == 1


def test_config_prints_what_it_has_checked(tmp_path, capsys):
    assert run(["config", "--set", "support.contact_on=0.3"]) == 0
    (tmp_path / "c.yaml").write_text(capsys.readouterr().out)
    assert load_config(tmp_path / "c.yaml").support.contact_on == 0.3
    assert run(["config", str(tmp_path / "c.yaml"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["support.contact_on"] == 0.3


@pytest.mark.slow
def test_offline_work_imports_no_ros(bag, tmp_path):
    """A machine without ROS can predict."""
    code = (
        "import sys; sys.modules['rclpy'] = None\n"
        "from coman_reduced_model.cli.main import run\n"
        f"code = run(['predict', {str(bag)!r}, '--out', {str(tmp_path / 'o')!r}])\n"
        "sys.exit(code or any(name.endswith('_msgs') for name in sys.modules))"
    )
    environment = child_environment()
    result = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=120)
    assert result.returncode == 0, result.stderr


def test_output_that_nobody_reads_is_no_error(bag):
    read, write = os.pipe()
    os.close(read)
    result = subprocess.run(
        [*COMAN, "config"], stdout=write, stderr=subprocess.PIPE, text=True, env=child_environment(), timeout=60
    )
    os.close(write)
    assert result.stderr == "" and result.returncode in (0, 1)


@pytest.mark.slow
def test_record_predict_report(tmp_path, capsys):
    """The way of someone who has no robot."""
    bag, out = str(tmp_path / "bag"), str(tmp_path / "out")
    assert run(["record", "--gait", "test1", "--duration", "4.0", "--seed", "7", "--out", bag, "--json"]) == 0
    recorded = json.loads(capsys.readouterr().out)
    assert recorded["fallen_s"] is None and Path(recorded["truth"]).exists()
    assert run(["predict", bag, "--out", out, "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["rmse_rigid_m"]["z"] > 1e-4 and summary["rejected"] == {}
    assert run(["report", out]) == 0
    assert (tmp_path / "out" / "report.html").stat().st_size > 10_000
    capsys.readouterr()
    assert run(["record", "--gait", "test1", "--out", bag]) == 2
    assert "exists" in capsys.readouterr().err
    assert run(["record", "--gait", "moonwalk", "--out", str(tmp_path / "b2")]) == 2
    assert "moonwalk" in capsys.readouterr().err and not (tmp_path / "test1").exists()


def test_velocities_that_are_missing_are_made(bag, done, tmp_path, capsys):
    def silent(stream, message):
        return replace(message, velocity=None) if stream in (JOINTS, MOTORS) else message

    without = write_bag(tmp_path / "bag", walk(4.0), silent)
    code, summary, _ = predict(capsys, without, "--out", tmp_path / "o", "--json")
    assert code == 0 and summary["samples"] == 799
    assert summary["rejected"] == {"joint_states/no_velocity": 1, "motor_states/no_velocity": 1}
    known = done[1]["rmse_rigid_m"]
    assert [summary["rmse_rigid_m"][axis] for axis in "xyz"] == pytest.approx([known[axis] for axis in "xyz"], rel=0.05)


def test_the_shipped_configuration_is_that_of_the_virtual_robot():
    robot = load_config(config_path("coman")).robot
    assert robot.left.joints + robot.right.joints == names()


def test_nothing_is_collected_while_a_command_loads_or_ends(bag, tmp_path, monkeypatch):
    """What numba and ROS types load stays: to look through it took a sixth of the time of a short recording."""
    collecting = []

    class Opened:
        def __init__(self, *_, **__):
            collecting.append(gc.isenabled())
            raise BagError("never opened")

    monkeypatch.setattr("coman_reduced_model.bag.session.Session", Opened)
    assert run(["predict", str(bag), "--out", str(tmp_path / "out")]) == 2
    assert collecting == [False] and gc.isenabled()
    code = """
import atexit, gc
atexit.register(lambda: print(gc.get_freeze_count() > 10_000, gc.isenabled()))
from coman_reduced_model.cli.entry import main
main()
"""
    command = [sys.executable, "-c", code, "--version"]
    done = subprocess.run(command, env=child_environment(), capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "True True"
