# SPDX-License-Identifier: BSD-3-Clause
"""The package as a whole: what importing costs, what is installed, and that messages and core agree."""

import importlib
import re
import subprocess
import sys
from importlib.metadata import entry_points, version
from pathlib import Path
from xml.etree import ElementTree

import pytest
from conftest import ROOT, child_environment
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import coman_reduced_model
from coman_reduced_model import resources
from coman_reduced_model.core.base.types import Flags, Foot, Phase
from coman_reduced_model.errors import BagError, ConfigError

MESSAGES = sorted(path.stem for path in (ROOT / "msg_defs/msg").glob("*.msg"))
EXECUTABLES = ("predictor", "trajectory", "virtual_robot", "coman")


def run_python(code: str) -> str:
    return subprocess.run(
        [sys.executable, "-c", code], env=child_environment(), check=True, capture_output=True, text=True
    ).stdout


@pytest.mark.slow
def test_offline_code_never_imports_rclpy():
    """An offline machine has no ROS: everything outside ros/ imports without it."""
    modules = [
        ".".join(path.relative_to(ROOT).with_suffix("").parts)
        for path in sorted((ROOT / "coman_reduced_model").rglob("*.py"))
        if "ros" not in path.relative_to(ROOT).parts and path.stem not in ("__init__", "__main__")
    ]
    assert any(module.startswith("coman_reduced_model.core.") for module in modules)
    code = f"import sys, importlib\nfor m in {modules!r}: importlib.import_module(m)\n"
    assert run_python(code + "print('rclpy' in sys.modules)").strip() == "False"


@pytest.mark.parametrize(("own", "wanted"), [("", "1"), ("3", "3")])
def test_the_command_line_keeps_linear_algebra_to_one_thread_before_numpy_is_there(own, wanted):
    code = f"""
import os, sys
os.environ.pop("OPENBLAS_NUM_THREADS", None)
os.environ.update({{"OPENBLAS_NUM_THREADS": "{own}"}} if "{own}" else {{}})
import coman_reduced_model.cli
print(os.environ["OPENBLAS_NUM_THREADS"], "numpy" in sys.modules)
"""
    assert run_python(code).split() == [wanted, "False"]


@pytest.mark.parametrize("name", EXECUTABLES)
def test_executables_exist(name):
    (entry,) = (entry for entry in entry_points(group="console_scripts") if entry.name == name)
    assert entry.value.startswith("coman_reduced_model.")
    assert callable(entry.load())


def test_one_version():
    stated = {
        file: ElementTree.parse(ROOT / file).findtext("version") for file in ("package.xml", "msg_defs/package.xml")
    }
    assert set(stated.values()) == {coman_reduced_model.__version__, version("coman_reduced_model")}, stated


def test_lock_names_versions_only():
    """Exact versions, no addresses, and everything that is used directly is in it."""
    locked = [line for line in (ROOT / "requirements.txt").read_text().splitlines() if not line.startswith("#")]
    assert locked and all(re.fullmatch(r"[a-z0-9-]+==[^\s/]+( ; [^/]+)?", line) for line in locked)
    names = {line.split("==")[0] for line in locked}
    for line in (ROOT / "requirements.in").read_text().splitlines():
        if wanted := re.match(r"[A-Za-z][\w-]*", line):
            assert wanted[0].lower().replace("_", "-") in names


@pytest.mark.parametrize("name", MESSAGES)
def test_bags_and_messages_have_the_same_type(name):
    """The type hash of the definition, as rosbags reads it, is that of the built message: bags fit live topics."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for other in MESSAGES:
        definition = (ROOT / f"msg_defs/msg/{other}.msg").read_text()
        store.register(get_types_from_msg(definition, f"coman_reduced_model_msgs/msg/{other}"))
    share = Path(importlib.import_module("coman_reduced_model_msgs").__file__).parents[4] / "share"
    built = (share / f"coman_reduced_model_msgs/msg/{name}.json").read_text()
    type_hash = store.hash_rihs01(f"coman_reduced_model_msgs/msg/{name}")
    assert re.fullmatch("RIHS01_[0-9a-f]{64}", type_hash) and f'"{type_hash}"' in built


@pytest.mark.parametrize("name", MESSAGES)
def test_every_field_says_its_unit(name):
    for line in (ROOT / f"msg_defs/msg/{name}.msg").read_text().splitlines():
        declaration, _, comment = line.partition("#")
        if declaration.strip() and "=" not in declaration:
            assert re.search(r"\[[^\]]+\]|no unit|stamp|units", comment), line


def test_constants_of_messages_and_core_agree():
    from coman_reduced_model_msgs.msg import ComPrediction, ComReference, SupportState

    for phase in Phase:
        assert getattr(SupportState, phase.name) == getattr(ComReference, phase.name) == phase
    for foot in Foot:
        assert getattr(SupportState, f"FOOT_{foot.name}") == foot
    for name, flag in Flags.__members__.items():
        assert getattr(ComPrediction, f"FLAG_{name}") == flag


def test_shipped_files_are_found_and_missing_ones_are_named():
    assert resources.config_path("coman").is_file()
    with pytest.raises(ConfigError, match=r"nobody.*coman\.yaml"):
        resources.config_path("nobody")
    with pytest.raises(BagError, match="nothing_recorded"):
        resources.bag_path("nothing_recorded")
