# SPDX-License-Identifier: BSD-3-Clause
"""The public interface: what it costs to import, its names, and the examples of its docstrings, which are run here."""

from __future__ import annotations

import doctest
import inspect
import subprocess
import sys

import pytest
from conftest import ROOT, child_environment

import coman_reduced_model as coman

HEAVY = ("numpy", "numba", "pinocchio", "scipy", "rosbags", "rclpy", "yaml")


def run_python(code: str) -> str:
    return subprocess.run(
        [sys.executable, "-c", code], env=child_environment(), check=True, capture_output=True, text=True
    ).stdout


def test_importing_the_package_loads_nothing_heavy():
    code = f"import sys, coman_reduced_model as c; c.__version__; print([m for m in {HEAVY!r} if m in sys.modules])"
    assert run_python(code).strip() == "[]"


@pytest.mark.slow
def test_predicting_needs_neither_ros_nor_what_diagnoses_and_draws():
    code = "import sys, coman_reduced_model as c; next(c.predict(c.bag_path('test1')))\n"
    code += "print([m for m in ('rclpy', 'scipy.optimize', 'matplotlib', 'mujoco') if m in sys.modules])"
    assert run_python(code).strip() == "[]"


def test_every_name_is_there_and_documented():
    assert len(coman.__all__) == len(set(coman.__all__))
    assert set(coman.__all__) <= set(dir(coman))
    for name in coman.__all__:
        assert inspect.getdoc(getattr(coman, name)), name
    with pytest.raises(AttributeError, match="nothing"):
        _ = coman.nothing


def test_the_diagnosis_is_a_function_whatever_has_been_imported():
    code = "import coman_reduced_model as c\nfrom coman_reduced_model.diagnose import workflow\n"
    assert run_python(code + "print(callable(c.diagnose))").strip() == "True"


def test_types_are_shipped():
    assert (ROOT / "coman_reduced_model/py.typed").is_file()
    assert "py.typed" in (ROOT / "setup.py").read_text()


def examples() -> list[doctest.DocTest]:
    """Of the docstrings of all public names."""
    parser = doctest.DocTestParser()
    found = (parser.get_doctest(inspect.getdoc(getattr(coman, n)) or "", {}, n, None, 0) for n in coman.__all__)
    return [each for each in found if each.examples]


def marked(example: doctest.DocTest) -> object:
    marks = [pytest.mark.slow] if example.name == "diagnose" else []
    return pytest.param(example, id=example.name, marks=marks)


@pytest.mark.parametrize("example", [marked(each) for each in examples()])
def test_examples_of_docstrings(example, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    said: list[str] = []
    doctest.DocTestRunner().run(example, out=said.append)
    assert not said, "".join(said)


def test_there_are_examples_of_what_users_do():
    names = {example.name for example in examples()}
    assert names >= {"open_robot", "predict", "diagnose", "load_config", "Session", "Predictor", "Pipeline"}


def test_a_bag_is_read_as_the_iteration_goes_on(monkeypatch):
    """The first prediction takes some hundred samples of the bag, not all."""
    read, batches = 0, coman.Session.batches

    def counted(session, progress=None):
        nonlocal read
        for batch in batches(session, progress):
            read += len(batch)
            yield batch

    monkeypatch.setattr(coman.Session, "batches", counted)
    predictions = coman.predict(coman.bag_path("test1"))
    assert next(predictions).stamp_ns > 0 and 0 < read < 1000
    assert sum(1 for _ in predictions) > 2000 and read > 2000


def test_a_urdf_is_taken_as_text_and_as_a_file(tmp_path):
    path = coman.config_path("coman.urdf")
    text = path.read_text(encoding="utf-8")
    assert coman.open_robot(text).mass == coman.open_robot(path).mass == coman.open_robot(str(path)).mass > 10.0
    with pytest.raises(coman.ComanError, match="nothing.urdf"):
        coman.open_robot(tmp_path / "nothing.urdf")
