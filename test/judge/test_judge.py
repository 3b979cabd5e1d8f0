# SPDX-License-Identifier: BSD-3-Clause
"""The judge: fair draws, bags without labels, answers out of reach, and a score that counts what it says."""

from __future__ import annotations

import json
import re
import sys
from collections import Counter
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from diagnose_tools import standing
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from coman_reduced_model.cli.main import run as coman
from coman_reduced_model.core.config.files import load_config
from coman_reduced_model.core.effects.catalogue import CATALOGUE
from coman_reduced_model.diagnose.physics.hypotheses import candidates, unknowns
from coman_reduced_model.errors import ConfigError, OutputError
from coman_reduced_model.judge import cases, families
from coman_reduced_model.judge import run as judge_run
from coman_reduced_model.judge.cases import BAGS, draw_case, write_case
from coman_reduced_model.judge.families import FAMILIES, LEVELS, draw_effect
from coman_reduced_model.judge.folder import RunFolder
from coman_reduced_model.judge.run import choose_seeds, run
from coman_reduced_model.judge.score import score_run
from coman_reduced_model.sim.describe import urdf
from coman_reduced_model.sim.disturbances import DISTURBANCES, make
from coman_reduced_model.sim.robot_table import ROBOTS
from coman_reduced_model.sim.worlds import AXES, World

REPORTED = range(1000, 1200)
MODEL_OPTIONS = {"gravity_stiffness", "lateral_compliance", "swing_momentum", "trunk_rotation"}

# --- draws ---


def test_a_seed_gives_the_same_case_in_any_range_and_any_order():
    assert [draw_case(seed) for seed in range(1040, 1000, -1)] == [draw_case(seed) for seed in range(1001, 1041)][::-1]


@pytest.mark.slow
def test_the_reported_seeds_hold_what_the_targets_ask_for():
    drawn = [draw_case(seed) for seed in REPORTED]
    assert Counter(case.kind for case in drawn) == {"clean": 100, "single": 60, "pair": 20, "unknown": 20}
    singles = Counter(case.families[0] for case in drawn if case.kind == "single")
    assert set(singles) == set(families.CATALOGUED) and min(singles.values()) >= 1
    for kind, least in (("single", 15), ("unknown", 3)):
        assert min(Counter(case.wanted[0] for case in drawn if case.kind == kind).values()) >= least
    assert {case.world.robot for case in drawn} == set(ROBOTS)
    every_kind = {name for kinds in AXES.values() for name, kind in kinds.items() if kind.weight}
    assert {kind for case in drawn for kind in case.world.kinds.values()} == every_kind
    for case in drawn:
        assert len(set(case.gaits.values())) == 3  # the held-out walks are others
        assert len({families.class_of(e["name"]) for e in case.effects}) == len(case.families)
    assert len({case.name for case in map(draw_case, range(2000))}) == 2000


@pytest.mark.parametrize("family", FAMILIES)
def test_levels_grow_and_can_be_built_on_every_robot(family):
    f = FAMILIES[family]
    same = {"cable_drag": {"spring"}}.get(family, {"friction", "time", "frequency"})  # not of the size
    for table in ROBOTS.values():
        sizes = []
        reached = []
        for level in range(3):
            values, got = draw_effect(family, np.random.default_rng(4), level, World(robot=table.name))
            effect = make(f.effect, values)
            reached.append(got)
            sizes.append(
                sum(
                    abs(np.log(v)) if key == "scale" else abs(v)
                    for key, v in effect.to_dict()["parameters"].items()
                    if isinstance(v, float) and key not in same
                )
            )
        grew = [b > a for a, b in pairwise(sizes)]
        assert grew == [b > a for a, b in pairwise(reached)], (table.name, sizes, reached)
        assert reached[0] == 0


@pytest.mark.parametrize(
    ("family", "places"),
    [
        ("joint_stiffness", {"LHipSag", "RHipYaw", "LKneeSag", "RAnkSag", "left", ""}),
        ("joint_damping", {"RHipSag", "LHipYaw", "right", ""}),
        ("hardening", {"LHipSag", "RAnkSag", "left", ""}),
        ("softening", {"RHipSag", "LKneeSag", "right", ""}),
        ("hysteresis", {"LHipSag", "RKneeSag", "left", "right", ""}),
        ("body_mass", {"LHipSag", "RHipLat", "LHipYaw", "RKneeSag", "LAnkSag", "RAnkLat", "", "WaistLat", "RElbow"}),
        ("backlash", {"LHipYaw", "RAnkLat", "left", ""}),
        ("joint_friction", {"RHipYaw", "LKneeSag", "right", ""}),
        ("encoder_bias", {"LHipYaw", "RHipSag"}),
    ],
)
def test_effects_are_hidden_at_all_their_places(family, places):
    drawn = set()
    for seed in range(150):
        robot = list(ROBOTS)[seed % len(ROBOTS)]
        world = World(robot=robot, upper_body=seed % 2 == 0)
        values, _ = draw_effect(family, np.random.default_rng(seed), seed % 3, world)
        make(FAMILIES[family].effect, values)  # within its bounds
        drawn.add(values["where"])
    assert places <= drawn


def test_a_bent_spring_has_its_change_at_the_deflections_of_its_joint():
    values = {}
    for seed in range(100):
        found, _ = draw_effect("hardening", np.random.default_rng(seed), 1, World())
        values.setdefault(found["where"][1:], []).append(found)
    low, high = (multiple * families.deviations()["hardening"] for multiple in families.MULTIPLES[1])
    for joint in ("HipSag", "KneeSag", "AnkSag"):
        changes = [v["cubic"] * families.working_stretch(joint, ROBOTS["coman"]) ** 2 for v in values[joint]]
        assert low < min(changes) and max(changes) < high
        assert {v["at"] for v in values[joint]} == {round(families.working_stretch(joint, ROBOTS["coman"]), 12)}


def test_every_effect_that_can_be_hidden_is_drawn():
    assert {f.effect for f in FAMILIES.values()} == set(DISTURBANCES) - {"scatter", "imperfections"}


def test_effects_have_the_same_names_for_the_judge_the_model_and_the_diagnosis():
    """The judge shares no table with the diagnosis: a name that differs would count as a wrong verdict."""
    known = {FAMILIES[name].effect for name in families.CATALOGUED}
    alike = {name for name in known - set(CATALOGUE) if families.class_of(name) in families.CLASSES.values()}
    known -= alike
    assert alike == {"wrench_cross_talk"} and known == set(CATALOGUE) - MODEL_OPTIONS
    assert not {FAMILIES[name].effect for name in families.OUTSIDE} & set(CATALOGUE)
    recording, world = standing()
    assert {option.effect for option in candidates(unknowns(recording, world))} == known
    assert set(families.CLASSES) <= known | alike
    of_diagnosis = {name: kind.ambiguity.name for name, kind in CATALOGUE.items() if kind.ambiguity}
    assert {name: each for name, each in families.CLASSES.items() if each != "sensor_axes"} == of_diagnosis


def test_after_falls_the_level_goes_down_and_that_is_recorded():
    seed = next(seed for seed in range(1000) if draw_case(seed).levels == ("strong",))
    levels = [draw_case(seed, attempt).levels for attempt in range(12)]
    assert levels == [("strong",)] * 4 + [("medium",)] * 4 + [("weak",)] * 4
    first, later = draw_case(seed), draw_case(seed, 5)
    assert (later.attempt, later.families, later.wanted) == (5, first.families, ("strong",))
    assert later.world.kinds == first.world.kinds and later.world != first.world


# --- bags ---


@pytest.fixture(scope="module")
def written(tmp_path_factory) -> tuple[Path, cases.HiddenCase, dict]:
    """A case with short walks."""
    folder = tmp_path_factory.mktemp("bags")
    fixed = {"kind": "pair", "families": ("backlash", "wrench_scale"), "level": "medium"}
    case = draw_case(3, **fixed, worlds={"engine": "mujoco"}, duration_s=3.6)
    found = write_case(case, folder / case.name)
    assert found is not None
    return folder / case.name, case, found


def test_what_happens_before_the_motors_is_hidden_where_motor_states_repeat_the_command():
    """Motor states that are measured lag already."""
    for family in ("motor_lag", "transport_delay", "motor_compliance"):
        for attempt in (0, 1):
            case = draw_case(3, attempt, kind="single", families=(family,))
            assert case.world.kinds["streams"] == "commanded" and case.world.sensors.motor_source == "commanded"
    assert (
        draw_case(3, kind="single", families=("motor_lag",), worlds={"streams": "bare"}).world.kinds["streams"]
        == "bare"
    )


@pytest.mark.slow
def test_bags_hold_no_label(written):
    folder, case, found = written
    assert sorted(path.name for path in folder.iterdir()) == ["hold1", "hold2", "robot.yaml", "train"]
    assert [e["name"] for e in found["effects"]] == ["backlash", "wrench_scale"] and found["seed"] == 3
    drawn = {*case.gaits.values(), *case.world.kinds.values()}
    words = [*DISTURBANCES, *FAMILIES, *LEVELS, "truth", "clean", "seed", *drawn]
    files = [path for path in folder.rglob("*") if path.is_file()]
    assert {path.suffix for path in files} == {".mcap", ".yaml"}
    spoken = {path: path.read_text() for path in files if path.suffix == ".yaml"}
    for bag in BAGS:
        with AnyReader([folder / bag]) as reader:
            assert reader.message_count > 1000
            description = [c for c in reader.connections if c.topic == "/robot_description"]
            connection, _, raw = next(reader.messages(description))
            assert reader.deserialize(raw, connection.msgtype).data == urdf(case.world.table)
        path = folder / bag / f"{bag}.mcap"
        with path.open("rb") as stream:
            mcap = make_reader(stream)
            assert not list(mcap.iter_attachments())
            spoken[path] = "".join(str(record) for record in mcap.iter_metadata())
    for path, text in spoken.items():
        for word in words:
            assert word not in path.name and not re.search(rf"(?<![A-Za-z]){word}(?![A-Za-z])", text), (path, word)


def test_name_and_robot_do_not_depend_on_what_is_hidden():
    for seed in range(100):
        clean, other = draw_case(seed, kind="clean"), draw_case(seed, kind="single", families=("payload",))
        assert (clean.world, clean.name) == (other.world, other.name)


def test_the_data_sheet_is_a_configuration_with_nominal_constants(written):
    folder, case, _ = written
    robot = load_config(folder / "robot.yaml").robot
    table = case.world.table
    assert robot.name == table.name
    assert [*robot.left.stiffness, *robot.right.stiffness] == [joint.stiffness for joint in table.leg_joints()]


# --- the workflow sees bags and nothing else ---

SPY = """
import json, os, sys
from pathlib import Path
a = sys.argv[1:]
out = Path(a[a.index("--out") + 1])
seen = {"argv": a, "cwd": os.getcwd(), "environment": dict(os.environ),
        "files": [str(p) for p in Path(a[0]).parent.rglob("*")], "assume": "--assume" in a}
with open(sys.argv[0] + ".log", "a") as log: log.write(json.dumps(seen) + chr(10))
out.mkdir()
(out / "diagnosis.json").write_text(json.dumps({"verdict": "none", "effects": [], "gap": {}}))
"""


NO_RANKING = (sys.executable, "-c", "import sys; sys.exit('no ranking')")  # as of bags that are empty


@pytest.fixture
def spy(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("tool") / "spy.py"
    path.write_text(SPY)
    return path


@pytest.fixture
def judged(tmp_path, spy, monkeypatch) -> tuple[RunFolder, list[str], list[int]]:
    """A run whose bags exist already, as empty files: the recording is tested above."""
    monkeypatch.setattr(judge_run, "RANK", NO_RANKING)
    layout = RunFolder(tmp_path / "run_of_the_judge")
    seeds = [next(s for s in REPORTED if draw_case(s).kind == kind) for kind in ("clean", "single", "unknown")]
    layout.sealed.mkdir(parents=True)
    for seed in seeds:
        case = draw_case(seed)
        for bag in BAGS:
            (layout.bags(case.name) / bag).mkdir(parents=True)
            (layout.bags(case.name) / bag / "metadata.yaml").write_text("")
        (layout.bags(case.name) / "robot.yaml").write_text("")
        layout.answer(case.name).write_text(json.dumps(cases.answer(case)))
    names = run(layout.out, seeds, command=[sys.executable, str(spy)], baselines=())
    return layout, names, seeds


def seen(spy: Path) -> list[dict]:
    return [json.loads(line) for line in Path(f"{spy}.log").read_text().splitlines()]


@pytest.mark.slow
def test_the_workflow_has_no_path_to_the_answers(judged, spy):
    layout, names, _ = judged
    calls = [call for call in seen(spy) if not call["assume"]]
    assert len(calls) == len(names) == 3
    for call in calls:
        given = json.dumps([call["argv"], call["cwd"], call["files"], call["environment"]])
        assert str(layout.out) not in given and str(layout.sealed) not in given and layout.out.name not in given
        assert not any(name in given for name in names)
        for file in call["files"]:
            assert Path(file).name in (*BAGS, "robot.yaml", "metadata.yaml")
        up = Path(call["argv"][0]).parent
        assert layout.out not in up.parents and not any(layout.answer(n).name in call["files"] for n in names)
    assert not any(path.is_relative_to(layout.out) for path in layout.sealed.iterdir())


@pytest.mark.slow
def test_oracles_run_only_after_the_verdicts_are_sealed(judged, spy):
    layout, names, seeds = judged
    calls = seen(spy)
    assert [call["assume"] for call in calls] == [False] * 3 + [True]
    effect = draw_case(seeds[1]).effects[0]
    assumed = calls[-1]["argv"][calls[-1]["argv"].index("--assume") + 1]
    assert assumed == (f"{effect['name']}:where={effect['where']}" if effect["where"] else effect["name"])
    sealed = (layout.out / "verdicts.sha256").stat().st_mtime_ns
    assert sealed < (layout.oracle(draw_case(seeds[1]).name) / "run.json").stat().st_mtime_ns


@pytest.mark.slow
def test_a_run_goes_on_where_it_was_broken_off(judged, spy):
    layout, names, seeds = judged
    (layout.verdict(names[0]) / "run.json").unlink()
    (layout.out / "verdicts.sha256").unlink()
    run(layout.out, seeds, command=[sys.executable, str(spy)], baselines=())
    assert len(seen(spy)) == 5  # the missing one, and no other


@pytest.mark.slow
def test_a_verdict_changed_after_sealing_is_refused(judged):
    layout, names, _ = judged
    assert score_run(layout.out, names)["workflow"]["false_alarms_on_clean"]["hits"] == 0
    (layout.verdict(names[1]) / "diagnosis.json").write_text('{"verdict": "unknown"}')
    with pytest.raises(OutputError, match="changed since the answers were opened"):
        score_run(layout.out, names)


@pytest.mark.slow
def test_a_workflow_that_breaks_counts_as_failed_and_the_round_is_counted(judged):
    layout, names, seeds = judged
    assert score_run(layout.out, names)["round"] == 1
    broken = [sys.executable, "-c", "import sys; sys.exit('no such luck')"]
    run(layout.out, seeds, command=broken, baselines=(), again=True)
    result = score_run(layout.out, names)
    assert result["round"] == 2
    assert result["workflow"]["failed"]["hits"] == 3
    assert json.loads((layout.verdict(names[0]) / "run.json").read_text())["message"] == "no such luck"


@pytest.mark.slow
def test_a_run_from_the_first_draw_to_the_score(tmp_path, spy):
    short = {"duration_s": 4.0, "worlds": {"engine": "mujoco", "floor": "level"}}
    seeds = [next(s for s in REPORTED if draw_case(s).kind == kind) for kind in ("clean", "single")]
    names = run(tmp_path / "judged", seeds, jobs=2, command=[sys.executable, str(spy)], baselines=(), **short)
    result = score_run(tmp_path / "judged", names)
    assert result["cases"] == {"clean": 1, "single": 1} and result["workflow"]["failed"]["hits"] == 0
    hidden = draw_case(seeds[1], **short).effects[0]["name"]
    assert {row["truth"][0] for row in result["rows"] if row["truth"]} == {hidden}
    assert all(oct(path.stat().st_mode)[-3:] == "600" for path in RunFolder(tmp_path / "judged").sealed.iterdir())
    # The case with something hidden, recorded again by one process and without the other: the same to the byte.
    run(tmp_path / "alone", seeds[1:], jobs=1, command=[sys.executable, str(spy)], baselines=(), oracle=False, **short)
    both, case = [tmp_path / name for name in ("judged", "alone")], Path("bags", draw_case(seeds[1], **short).name)
    bags = [sorted(path.relative_to(out) for path in (out / case).rglob("*.*")) for out in both]
    assert bags[0] == bags[1] and len(bags[0]) > 6
    assert all((both[0] / bag).read_bytes() == (both[1] / bag).read_bytes() for bag in bags[0])


# --- the command ---


@pytest.mark.parametrize("text", ["1000", "9:3", "5:5", "a:b", "-1:5"])
def test_seeds_that_are_no_range_are_refused(text, tmp_path):
    with pytest.raises(ConfigError, match="--seeds"):
        choose_seeds(text, tmp_path / "new")


@pytest.mark.slow
def test_the_command_prints_figures_and_keeps_them(judged, spy, capsys):
    layout, names, seeds = judged
    workflow = f"{sys.executable} {spy}"
    for path in [p for p in (layout.out / "bags").iterdir() if p.name != draw_case(seeds[0]).name]:
        for file in sorted(path.rglob("*"), reverse=True):
            file.rmdir() if file.is_dir() else file.unlink()
    seed = f"{seeds[0]}:{seeds[0] + 1}"
    arguments = ["judge", "--out", str(layout.out), "--seeds", seed, "--workflow", workflow, "--no-baselines"]
    assert coman([*arguments, "--only", "clean"]) == 0
    printed = capsys.readouterr().out
    assert "false alarms on clean robots" in printed and "0 % (0/1" in printed
    assert "took 0 minutes" in printed and layout.took("diagnosis")["seconds"] < 60.0 and layout.took("monitor") is None
    assert coman([*arguments, "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == json.loads((layout.out / "score.json").read_text())
    assert coman([*arguments, "--only", "dirty"]) == 2
    assert "allowed: clean, single, pair, unknown" in capsys.readouterr().err
