# SPDX-License-Identifier: BSD-3-Clause
"""`coman baseline`: what is usual for one robot."""

from __future__ import annotations

import json

import numpy as np
import pytest
from diagnose_tools import standing
from synthetic import walk, write_bag

from coman_reduced_model.cli.main import run
from coman_reduced_model.core.base.nominal import load_nominal
from coman_reduced_model.diagnose.baseline import PLAUSIBLE, _leftover, _repeats, of_cases
from coman_reduced_model.diagnose.data.masks import masks
from coman_reduced_model.diagnose.inference.case import examine
from coman_reduced_model.diagnose.physics.hypotheses import unknowns
from coman_reduced_model.sim.disturbances import make
from coman_reduced_model.sim.record import record

pytestmark = pytest.mark.usefixtures("without_second_process")


def learnt(changes):
    """The baseline of standing robots with these changes of a parameter, by name: one recording each."""
    cases = []
    for each in changes:
        recording, world = standing()
        known = unknowns(recording, world)
        for name, value in each.items():
            unknown = next(one for one in known if one.name == name)
            recording, _ = unknown.apply(recording, world, -value)  # what the sensor reads of it
        cases.append(examine((recording, world, masks(recording, world)), known, np.zeros(len(known))))
    return of_cases(cases, load_nominal())


def test_what_is_the_same_in_all_recordings_is_usual():
    name = "encoder_bias@LKneeSag.bias"
    usual, spread = learnt([{name: 0.0012}] * 3).nominal.parameters[name]
    assert 0.0005 < usual < 0.0013  # the zero of the torque sensor takes the rest
    assert spread < load_nominal().widths["encoder_bias.bias.spread"]


@pytest.mark.slow
def test_what_differs_between_recordings_varies_on_this_robot(step=0.0005):
    """Two recordings show as much of it as many do."""
    name = "encoder_bias@LKneeSag.bias"
    same, two, four = (learnt([{name: sign * step} for sign in signs]).nominal.parameters[name][1]
                       for signs in ((1, 1), (1, -1), (1, -1, 1, -1)))  # fmt: skip
    assert same < 0.6 * two and same < 0.7 * four


def test_what_no_robot_plausibly_has_is_not_taken_over():
    name = "encoder_bias@LKneeSag.bias"
    baseline = learnt([{name: 0.05}] * 2)
    most = PLAUSIBLE * load_nominal().most["encoder_bias.bias.spread"]
    assert baseline.nominal.parameters[name][0] <= most + 1e-12
    assert baseline.pulled["encoder_bias.bias"] > 3.0


def test_what_laws_leave_is_shrunk_towards_the_population_the_more_the_fewer_recordings_there_are():
    population = load_nominal()
    law = "force/z|double"
    own, (_, scatter) = 2.0, population.leftover[law]

    def learnt_of(values):
        return _leftover([{law: value} for value in values], population)[law]

    few, many = learnt_of([own] * 2), learnt_of([own] * 50)
    assert few[0] == many[0] == pytest.approx(own)
    assert scatter / 2 <= many[1] < few[1] < scatter  # robots that repeat exactly have half of the scatter
    wild = learnt_of([0.2, 2.0, 20.0] * 10)
    assert wild[1] > 1.5
    others = _leftover([], population)
    assert others == population.leftover  # of laws that its recordings lack


def test_what_repeats_is_shrunk_likewise():
    population = load_nominal()
    law, usual = next(iter(population.repeats.items()))
    few, many = (_repeats({law: 3.0 * usual}, count, population)[law] for count in (2, 50))
    assert usual < few < many < 3.0 * usual and many == pytest.approx(3.0 * usual, rel=0.05)
    assert _repeats({}, 2, population) == population.repeats


def test_one_recording_is_too_few(tmp_path, capsys):
    bag = write_bag(tmp_path / "bag", walk(3.0))
    assert run(["baseline", str(bag), "--out", str(tmp_path / "usual.yaml")]) == 2
    assert "at least 2 are needed" in capsys.readouterr().err
    assert not (tmp_path / "usual.yaml").exists()


@pytest.mark.slow
def test_a_baseline_of_a_robot_that_is_too_heavy_does_not_hide_it(tmp_path, capsys):
    """Ten percent, of which a part would be plausible link by link; gains of sensors as they vary hide up to eight."""
    heavy = [make("body_mass", {"where": where, "scale": 1.1}) for where in ("", "left", "right")]
    for seed, (name, gait) in enumerate([("well_1", "test1"), ("well_2", "test2"), ("later", "test1")]):
        record(gait, tmp_path / name, disturbances=heavy, seed=seed, duration_s=6.0)
    usual, out = tmp_path / "usual.yaml", tmp_path / "out"
    assert run(["baseline", str(tmp_path / "well_1"), str(tmp_path / "well_2"), "--out", str(usual)]) == 0
    text, err = capsys.readouterr()
    assert "weight by forces and motion: 109 ± " in text
    assert "warning: by its forces, the robot weighs 9% more than by its URDF, and data sheets allow 3%" in err
    assert load_nominal(usual).parameters["mass@root_joint"][0] > 0.03  # most of it is usual

    assert run(["diagnose", str(tmp_path / "later"), "--baseline", str(usual), "--out", str(out), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    share = result["weight"]["share"]
    assert result["verdict"] != "none"
    assert abs(share - 0.1) < result["weight"]["deviation"] < 0.03
    said = f"by its forces, the robot weighs {share:.0%} more than by its URDF"
    assert said in result["sentence"] and said in (out / "report.html").read_text()


@pytest.mark.slow
def test_with_a_baseline_of_the_robot_its_recordings_lack_nothing_and_more_is_seen(tmp_path, capsys):
    """The same robot, no precise one, well in three recordings, then with a small zero of one encoder."""
    robot = make("scatter", {"seed": 3}), make("imperfections", {"seed": 3, "amount": 0.6})
    fault = make("encoder_bias", {"where": "RKneeSag", "bias": 0.004})
    walks = [("well_1", "test1", []), ("well_2", "test2", []), ("well_3", "test1", []), ("odd", "test1", [fault])]
    for seed, (name, gait, hidden) in enumerate(walks):
        record(gait, tmp_path / name, disturbances=[*robot, *hidden], seed=seed, duration_s=7.0)
    usual = tmp_path / "usual.yaml"
    bags = [str(tmp_path / name) for name in ("well_1", "well_2")]
    assert run(["baseline", *bags, "--out", str(usual)]) == 0
    own, population = load_nominal(usual).repeats, load_nominal().repeats
    assert own["tilt/roll|single"] < population["tilt/roll|single"]

    def evidence(bag: str, *options: str) -> tuple[str, float]:
        out = tmp_path / "out"
        capsys.readouterr()
        assert run(["diagnose", str(tmp_path / bag), "--out", str(out), "--force", "--json", *options]) == 0
        result = json.loads(capsys.readouterr().out)
        mine = [r["evidence"] for r in result["ranking"] if (r["name"], r["where"]) == ("encoder_bias", "RKneeSag")]
        return result["verdict"], mine[0]

    assert evidence("well_3", "--baseline", str(usual))[0] == "none"
    assert evidence("odd", "--baseline", str(usual))[1] > evidence("odd")[1] + 1.0

    rows = load_nominal(usual).monitor
    assert {"spring/RKneeSag", "force/x", "spring"} <= set(rows)
    assert rows["spring/RKneeSag"]["by_robot"] < rows["spring"]["by_robot"]
    out = tmp_path / "watched"
    assert run(["predict", str(tmp_path / "well_3"), "--out", str(out), "--set", f"monitor.baseline={usual}"]) == 0
    assert json.loads((out / "summary.json").read_text())["mismatches"] == []
