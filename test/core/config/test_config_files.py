# SPDX-License-Identifier: BSD-3-Clause
"""The shipped configurations load, and coman.yaml says what the defaults are."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from conftest import recording

from coman_reduced_model.cli.main import run
from coman_reduced_model.core.config.files import load_config, save_config
from coman_reduced_model.core.config.schema import OPTIONS, Config, parameter_table
from coman_reduced_model.core.robot.robot import Robot
from coman_reduced_model.resources import config_path
from coman_reduced_model.sim.describe import urdf
from coman_reduced_model.sim.robot_table import COMAN

ROOT = Path(__file__).resolve().parents[3]
FILES = sorted({*(ROOT / "config").glob("*.yaml")} - {ROOT / "config/nominal.yaml"})


def keys(tree: dict, prefix: str = "") -> list[str]:
    """Dotted keys in the order of the file."""
    found = []
    for key, value in tree.items():
        found += keys(value, f"{prefix}{key}.") if isinstance(value, dict) else [prefix + key]
    return found


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_each_loads_and_has_no_empty_list(path: Path) -> None:
    load_config(path)
    for value in yaml.safe_load(path.read_text())["/**"]["ros__parameters"].values():
        assert value != [], "ROS 2 parameter files have no empty lists"


def test_coman_yaml_lists_every_default_in_the_order_of_the_table() -> None:
    path = config_path("coman")
    assert load_config(path).flat() == Config().flat()
    table = {name: parameter.nominal for name, parameter in parameter_table().items() if parameter.nominal != ()}
    listed = [name for name in table if name == "effects.active" or not name.startswith("effects.")]
    assert keys(yaml.safe_load(path.read_text())["/**"]["ros__parameters"]) == listed


def test_the_default_has_all_options_of_the_model_and_coman_paper_none() -> None:
    assert all(load_config(config_path("coman")).uses(option) for option in OPTIONS)
    for name in ("coman_paper", "icub"):  # of the latter the motor side is not known
        assert not any(load_config(config_path(name)).uses(option) for option in OPTIONS)


def test_coman_yaml_fits_the_virtual_robot() -> None:
    config = load_config(config_path("coman"))
    robot = Robot(urdf(COMAN), config.robot)
    assert robot.mass == pytest.approx(17.3, abs=0.05)
    for leg, side in ((config.robot.left, "L"), (config.robot.right, "R")):
        springs = {joint.name: (joint.stiffness, joint.damping) for joint in COMAN.joints() if joint.name[0] == side}
        assert dict(zip(leg.joints, zip(leg.stiffness, leg.damping, strict=True), strict=True)) == springs


def test_files_that_a_configuration_names_are_found_from_it(tmp_path) -> None:
    path = tmp_path / "robots" / "mine.yaml"
    path.parent.mkdir()
    path.write_text("/**:\n  ros__parameters: {robot.urdf: mine.urdf, monitor.baseline: usual.yaml}\n")
    config = load_config(path)
    again = load_config(save_config(config, tmp_path / "other.yaml"))
    for each in (config, again):
        assert each.urdf.resolve() == path.parent / "mine.urdf"
        assert each.baseline.resolve() == path.parent / "usual.yaml"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("effects.active=[backlash] effects.backlash.where=[Nope]", "no leg joint 'Nope'"),
        ("monitor.baseline=/nowhere.yaml", "/nowhere.yaml"),
    ],
)
def test_coman_config_refuses_places_and_files_that_do_not_exist(capsys, change, words) -> None:
    changes = [part for each in change.split() for part in ("--set", each)]
    assert run(["config", "--urdf", str(ROOT / "config" / "coman.urdf"), *changes]) == 2
    assert words in capsys.readouterr().err.splitlines()[-1]


def test_icub_yaml_fits_the_recorded_robot() -> None:
    from coman_reduced_model.bag.session import Session

    config = load_config(config_path("icub"))
    assert config.prediction.reference == "none"
    with Session(recording("real/icub_walk"), config) as session:
        assert session.robot.mass == pytest.approx(33.08, abs=0.05)
