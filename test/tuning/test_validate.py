# SPDX-License-Identifier: BSD-3-Clause
"""Validation: what is tuned on is never what is judged on, errors are pooled as squares, the page says it all."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from coman_reduced_model.cli.main import run
from coman_reduced_model.core.config.files import load_config
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.resources import config_path
from coman_reduced_model.sim.robot_table import ROBOTS
from coman_reduced_model.tuning.validate import VARIANTS, Score, _possible, rows, summarise, virtual_case

BAGS = Path(__file__).resolve().parents[2] / "bags"


def test_every_variant_is_a_configuration():
    for changes in VARIANTS.values():
        Config().replaced(changes)
    assert len({str(sorted(changes.items())) for changes in VARIANTS.values()}) == len(VARIANTS)


def test_variants_that_a_configuration_cannot_have_are_left_out():
    """Without the motor side the trunk does not turn."""
    found = _possible(Config().replaced({"prediction.reference": "topic"}), list(VARIANTS))
    assert "paper" in found and "trunk_rotation alone" not in found
    assert list(_possible(Config(), list(VARIANTS))) == list(VARIANTS)


@pytest.mark.parametrize(("variant", "shipped"), [("paper", "coman_paper"), ("all options", "coman")])
def test_variants_are_the_shipped_configurations(variant, shipped):
    made, file = load_config(config_path()).replaced(VARIANTS[variant]), load_config(config_path(shipped))
    assert made.flat() == file.flat()


def test_a_virtual_robot_is_judged_with_its_own_data_sheet():
    config = load_config(config_path())
    for name, table in ROBOTS.items():
        leg = virtual_case(name, config).config.robot.right
        assert leg.stiffness == tuple(table.stiffness[joint[1:]] for joint in leg.joints)
        assert leg.damping == tuple(table.damping[joint[1:]] for joint in leg.joints)


def test_errors_are_pooled_as_squares_and_the_worst_walk_is_named():
    def one(error, skill, pitch):
        axes = dict.fromkeys("xyz", error)
        return Score(
            "r", "g", "v", axes, dict.fromkeys("xyz", 2.0 * error), {"0.2": dict.fromkeys("xyz", skill)}, pitch
        )

    table = summarise([one(1e-3, 0.2, float("nan")), one(7e-3, 0.4, float("nan"))])["v"]
    assert table["rmse_m"]["x"] == pytest.approx(5e-3)
    assert table["rigid_m"]["z"] == pytest.approx(10e-3)
    assert table["worst_m"]["x"] == 7e-3
    assert table["skill"]["0.2"]["z"] == pytest.approx(0.3)
    assert rows({"v": table})[1] == ["v", "2", "5.00", "5.00", "5.00", "7.00", "7.00", "-", "0.30", "0.30"]


def test_bad_input_is_one_line(tmp_path, capsys):
    out, test1 = ["--out", str(tmp_path / "v")], str(BAGS / "test1")
    for arguments, said in (
        ([test1], "--holdout"),
        ([test1, "--untuned"], "only without BAG"),
        (["--holdout", test1], "name the bags to tune on"),
        ([test1, "--holdout", test1], "also tuned on"),
        (["--robots", "coman,giant"], "'giant' is not allowed"),
        (["nowhere", "--holdout", test1], "nowhere"),
        (["--urdf", "robot.urdf"], "--urdf: only with BAG"),
        ([test1, "--holdout", str(BAGS / "test2"), "--remap", "joint_states:=elsewhere"], "/elsewhere"),
        ([test1, "--holdout", str(BAGS / "test2"), "--urdf", "nowhere.urdf"], "nowhere.urdf"),
    ):
        assert run(["validate", *arguments, *out]) == 2
        error = capsys.readouterr().err
        line = [x for x in error.splitlines() if x.startswith("coman:")]
        assert said in line[0] and "Traceback" not in error
    assert not (tmp_path / "v").exists()


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_bags_of_ones_own_are_validated(tmp_path, capsys):
    out = tmp_path / "v"
    command = [
        "validate",
        str(BAGS / "test1"),
        "--holdout",
        str(BAGS / "test2"),
        "--quick",
        "--out",
        str(out),
        "--json",
    ]
    assert run(command) == 0
    result = json.loads(capsys.readouterr().out)
    assert {s["gait"] for s in result["scores"]} == {"test2"}
    assert set(result["summary"]) == {"paper", "all options", "paper, tuned", "all options, tuned", "as configured"}
    for s in result["summary"].values():
        assert all(math.isfinite(value) for value in s["rmse_m"].values())
    assert result["summary"]["all options"]["rmse_m"]["x"] < result["summary"]["all options"]["rigid_m"]["x"]
    page = (out / "report.html").read_text(encoding="utf-8")
    for name in ("validation", "fig10", "fig11", "fig12", "whole", "whole_tuned"):
        assert (out / f"{name}.png").exists()
    assert "tuned on test1, on another gait (test2)" in page
    assert json.loads((out / "validation.json").read_text())["summary"] == result["summary"]
