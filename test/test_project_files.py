# SPDX-License-Identifier: BSD-3-Clause
"""The files about the project agree with it: version, layout, workflow of the public CI."""

from __future__ import annotations

import re
import shlex
import subprocess
from xml.etree import ElementTree

import pytest
import yaml
from conftest import ROOT

VERSION = ElementTree.parse(ROOT / "package.xml").getroot().findtext("version")
WORKFLOW = yaml.safe_load((ROOT / ".github" / "workflows" / "ci.yml").read_text())
STEPS = [step["run"] for job in WORKFLOW["jobs"].values() for step in job["steps"] if "run" in step]


def test_the_newest_entry_of_the_changelog_and_the_citation_are_of_the_version():
    versions = re.findall(r"^## \[(.*?)\] - \d{4}-\d\d-\d\d$", (ROOT / "CHANGELOG.md").read_text(), re.M)
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert versions[0] == citation["version"] == VERSION
    assert "0.1.0" in versions


def test_folders_that_the_contributors_guide_names_exist():
    text = (ROOT / "CONTRIBUTING.md").read_text()
    named = re.findall(r"^\| (`.*?`) \|", text, re.M)
    folders = [name for cell in named for name in re.findall(r"`([\w./]+)`", cell)]
    assert len(folders) > 12
    for name in folders:
        assert (ROOT / name).exists() or (ROOT / "coman_reduced_model" / name).exists(), name


@pytest.mark.parametrize("step", STEPS)
def test_steps_of_the_workflow_are_shell(step):
    checked = subprocess.run(["bash", "-n"], input=step, text=True, capture_output=True, check=False)
    assert checked.returncode == 0, checked.stderr


def test_the_workflow_names_targets_files_and_executables_that_exist():
    assert WORKFLOW["jobs"]["jazzy"]["container"] == "ros:jazzy"
    text = "\n".join(STEPS)
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.M)
    made = re.findall(r"\bmake ([a-z-]+)", text)
    launched = re.search(r"for file in (.*?);", text)
    assert made and set(made) <= set(targets) and launched
    assert all((ROOT / "launch" / f"{name}.launch.py").is_file() for name in shlex.split(launched[1]))
    assert all((ROOT / path).exists() for path in re.findall(r"\bbags/\w+", text))


def test_the_dockerfile_names_what_exists():
    """It cannot be built everywhere; it follows the workflow, which is."""
    text = (ROOT / "Dockerfile").read_text()
    assert re.search(r"^FROM ros:jazzy$", text, re.M)
    for package in re.findall(r"src/coman_reduced_model(\S*)", text.partition("colcon build")[2].partition("&&")[0]):
        assert (ROOT / package.lstrip("/") / "package.xml").is_file()
    for module in re.findall(r"python3 -m (\S+)", text):
        assert (ROOT / f"{module.replace('.', '/')}.py").is_file()
    for name in re.findall(r"ros2 launch \S+ (\S+)", text):
        assert (ROOT / "launch" / name).is_file()
    installed = re.search(r'pip install .*("typer>=.*" rich)', text)
    assert installed and any(installed[1] in step for step in STEPS)
