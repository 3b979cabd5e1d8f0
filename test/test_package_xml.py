# SPDX-License-Identifier: BSD-3-Clause
"""package.xml of both packages, as rosdep, bloom and colcon read them; and a workspace that colcon builds."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest
from catkin_pkg.package import parse_package
from conftest import ROOT, child_environment

PACKAGES = {folder: parse_package(str(ROOT / folder)) for folder in (".", "msg_defs")}
# Where a package, or the one that brings it, has another name than the module. None: optional, and not asked for there.
NAMES = {
    "llvmlite": "python3-numba",  # which is built on it
    "lz4": "mcap-ros2-support",
    "mcap": "mcap-ros2-support",
    "zstandard": "mcap-ros2-support",
    "markupsafe": "python3-jinja2",
    "mujoco": "python3-mujoco-pip",
    "rosbags": "python3-rosbags-pip",
    "coman_reduced_model_msgs": "coman_reduced_model_msgs",
    "typer": None,  # its key is too old in Ubuntu 24.04, see package.xml
    "pydrake": None,
    "pysindy": None,
    "rerun": None,
    "pyarrow": None,
    "fsspec": None,
    "duckdb": None,
    "ray": None,
}


@pytest.mark.parametrize("folder", PACKAGES)
def test_packages_are_valid_and_can_be_released(folder):
    package, warnings = PACKAGES[folder], []
    package.validate(warnings)
    assert not warnings and package.package_format == 3
    assert package.version == PACKAGES["."].version
    (license_,) = package.licenses
    assert (ROOT / folder / license_.file).read_text() == (ROOT / "LICENSE").read_text()
    assert package.maintainers and package.authors and package.description


def test_what_the_code_imports_is_declared():
    imported = set()
    for path in (ROOT / "coman_reduced_model").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                imported |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level:
                imported.add(node.module.partition(".")[0])
    imported -= {*sys.stdlib_module_names, "coman_reduced_model"}
    assert {"numpy", "rclpy", "zstandard"} <= imported
    declared = {each.name for each in PACKAGES["."].exec_depends}
    missing = set()
    for module in imported:
        name = NAMES.get(module, module)
        if name is not None and not {name, f"python3-{name}"} & declared:
            missing.add(module)
    assert not missing


@pytest.mark.slow
def test_colcon_builds_a_workspace(tmp_path):
    """By the command of doc/topics.md; the wheels of ROS 2 need two settings more than an installation."""
    source = tmp_path / "src/coman_reduced_model"
    source.mkdir(parents=True)
    for name in ("coman_reduced_model", "config", "launch", "resource", "msg_defs", "test"):
        source.joinpath(name).symlink_to(ROOT / name)
    for name in ("package.xml", "setup.py", "setup.cfg", "LICENSE"):
        source.joinpath(name).write_bytes((ROOT / name).read_bytes())
    shown = "colcon build --base-paths src/coman_reduced_model src/coman_reduced_model/msg_defs"
    assert shown in (ROOT / "doc/topics.md").read_text(encoding="utf-8")
    prefix, tools = Path(sys.prefix), ROOT / "msg_defs/cmake/drop_missing_includes.cmake"
    environment = child_environment(
        PATH=f"{prefix / 'bin'}{os.pathsep}{os.environ['PATH']}",
        AMENT_PREFIX_PATH=str(prefix),
        CMAKE_PREFIX_PATH=str(prefix),
    )
    wheels = ["--cmake-args", "-G", "Ninja", f"-DCMAKE_PROJECT_INCLUDE={tools}"]
    command = [*shown.split(), "--event-handlers", "console_direct-", *wheels]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=500)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    install = tmp_path / "install"
    for node in ("predictor", "trajectory", "virtual_robot", "coman"):
        assert os.access(install / f"coman_reduced_model/lib/coman_reduced_model/{node}", os.X_OK)
    share = install / "coman_reduced_model/share"
    assert (share / "ament_index/resource_index/packages/coman_reduced_model").is_file()
    assert (share / "coman_reduced_model/launch/predict.launch.py").is_file()
    # The messages are found after `source install/setup.bash`, and not those of this environment.
    code = "import coman_reduced_model_msgs.msg as m; print(m.__file__); m.ComPrediction()"
    line = f'set -e; source install/setup.bash; "{sys.executable}" -c "{code}"'
    sourced = subprocess.run(
        ["bash", "-c", line], cwd=tmp_path, env=child_environment(), capture_output=True, text=True
    )
    assert sourced.stdout.startswith(str(install / "coman_reduced_model_msgs")), sourced.stderr
