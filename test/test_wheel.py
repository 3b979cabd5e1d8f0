# SPDX-License-Identifier: BSD-3-Clause
"""`pip install .` without ROS: a small wheel, which works with what it declares and nothing else."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import zipfile
from email.parser import Parser
from pathlib import Path

import pytest
from conftest import ROOT, child_environment
from synthetic import walk, write_bag

SOURCES = ("setup.py", "setup.cfg", "pyproject.toml", "package.xml", "LICENSE", "README.md", "bags", "config", "launch")
FOLDERS = ("msg_defs", "resource", "coman_reduced_model")
MOST_MB = 1.5
UV = Path(sys.executable).parent / "uv"


def uv(*arguments: str | Path) -> None:
    done = subprocess.run([UV, *arguments], env=child_environment(), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Built from a copy, so that nothing is left in the sources."""
    folder = tmp_path_factory.mktemp("wheel")
    for name in (*SOURCES, *FOLDERS):
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, folder / "source" / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            (folder / "source").mkdir(exist_ok=True)
            shutil.copy(ROOT / name, folder / "source" / name)
    built = ("build", "--wheel", "--no-build-isolation", "--python", sys.executable, "--out-dir", folder / "dist")
    uv(*built, folder / "source")
    (found,) = (folder / "dist").glob("*.whl")
    return found


def test_a_wheel_has_what_is_needed_and_no_bags(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    assert wheel.stat().st_size < MOST_MB * 1e6
    assert not [name for name in names if ".mcap" in name or name.startswith("test")]
    for needed in ("config/coman.yaml", "config/nominal.yaml", "package.xml", "msg_defs/msg/ComPrediction.msg"):
        assert any(name.endswith(f"share/coman_reduced_model/{needed}") for name in names), needed
    for needed in ("page.html.j2", "summary.schema.json", "diagnosis.schema.json", "py.typed"):
        assert any(name.endswith(f"/{needed}") for name in names), needed


def test_a_wheel_declares_what_it_imports(wheel):
    """Of the product alone: neither ROS, which no index has for every Python, nor tools for tests."""
    archive = zipfile.ZipFile(wheel)
    (metadata,) = (name for name in archive.namelist() if name.endswith("METADATA"))
    lines = Parser().parsestr(archive.read(metadata).decode()).get_all("Requires-Dist")
    plain = {line.split(">")[0].strip() for line in lines if "extra ==" not in line}
    listed = (ROOT / "requirements.in").read_text().partition("--- run time: real ROS 2")[0]
    product = {line.split()[0] for line in listed.splitlines() if line and not line.startswith("#")}
    assert plain <= product and product - plain <= {"mujoco", "rerun-sdk", "pyarrow", "fsspec", "duckdb", "ray"}


def take_along_what_is_compiled(package: Path) -> None:
    """But for one folder: what numba compiled of the sources, which are the same, saves two minutes."""
    for source in package.rglob("*.py"):
        of = ROOT / package.name / source.relative_to(package)
        if of.parent.name != "measured":
            os.utime(source, ns=(of.stat().st_atime_ns, of.stat().st_mtime_ns))
            (source.parent / "__pycache__").mkdir(exist_ok=True)
            for compiled in (of.parent / "__pycache__").glob(f"{of.stem}.*.nb[ic]"):
                shutil.copy(compiled, source.parent / "__pycache__")


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_wheel_predicts_in_an_environment_of_its_own(wheel, tmp_path):
    """It compiles there and says so; what needs ROS or an extra says in one line what to install."""
    python = tmp_path / "venv/bin/python"
    uv("venv", "--quiet", "--python", sys.executable, tmp_path / "venv")
    uv("pip", "install", "--quiet", "--python", python, "--constraint", ROOT / "requirements.txt", wheel)
    (package,) = (tmp_path / "venv").glob("lib/python*/site-packages/coman_reduced_model")
    take_along_what_is_compiled(package)
    bag = write_bag(tmp_path / "bag", walk(1.0))

    def coman(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
        environment = {**child_environment(), "PYTHONPATH": "", "ROS_DOMAIN_ID": "99"}
        command = [python.parent / "coman", *arguments]
        return subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True, check=False)

    done = coman("predict", bag, "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert json.loads((tmp_path / "out/summary.json").read_text())["judged_samples"] > 100
    assert "compiling the model, once per installation" in done.stderr
    again = coman("predict", bag, "--out", tmp_path / "again")
    assert again.returncode == 0 and "compiling" not in again.stderr
    needs = {"demo": "ROS 2", f"replay {bag}": "ROS 2", "worlds": "[sim]", f"record --out {tmp_path / 'w'}": "[sim]"}
    for command, words in needs.items():
        done = coman(*command.split())
        assert done.returncode == 2 and words in done.stderr and len(done.stderr.strip().splitlines()) == 1, command
