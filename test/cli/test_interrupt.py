# SPDX-License-Identifier: BSD-3-Clause
"""Ctrl-C, whenever it comes, leaves no traceback and no process, also where several processes work."""

from __future__ import annotations

import os
import shutil
import sys
import time

import pytest

from coman_reduced_model.cli.compiling import COMPILING
from coman_reduced_model.resources import bag_path

LOADING = """
import os, signal, sys

module = sys.argv.pop(1)

class Interrupt:
    def find_spec(self, name, path=None, target=None):
        if name == module:
            sys.meta_path.remove(self)
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Interrupt())
from coman_reduced_model.cli.entry import main
main()
"""


def goes_silently(process):
    assert process.wait() == 130, process.output
    assert not any(words in process.output for words in ("Traceback", "Exception ignored", "Error")), process.output
    with pytest.raises(ProcessLookupError):  # nothing of its group goes on
        for _ in range(100):
            os.killpg(process.pid, 0)
            time.sleep(0.1)


@pytest.mark.parametrize("module", ["typer", "rich.console", "numpy", "numba", "pinocchio"])
def test_ctrl_c_while_modules_are_loaded(start, module):
    process = start(sys.executable, "-c", LOADING, module, "check", bag_path("stand"))
    goes_silently(process)
    assert not process.output


@pytest.mark.slow
@pytest.mark.parametrize(("command", "after"), [("diagnose", 0.0), ("diagnose", 1.5), ("tune", 0.0)])
def test_ctrl_c_ends_long_work_in_silence(tmp_path, start, command, after):
    """The second process of a diagnosis is at work; a terminal sends it to both."""
    bags = [bag_path("test1")]
    if command == "diagnose":  # enough of them that no machine is done before the Ctrl-C
        copies = [(walk, tmp_path / f"{walk}_{n}") for walk in ("test1", "test2") for n in range(5)]
        bags = [shutil.copytree(bag_path(walk), folder) for walk, folder in copies]
    process = start("coman", command, *bags, "--out", tmp_path / "out")
    process.wait_for("ing: ")  # comes with the progress, after two seconds of work
    time.sleep(after)
    process.interrupt(times=2)
    goes_silently(process)
    assert not (tmp_path / "out").exists() and not [*tmp_path.glob(".out.*")]


@pytest.mark.slow
def test_ctrl_c_during_the_first_compilation(tmp_path, start, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "nothing_compiled"))
    process = start("coman", "predict", bag_path("test1"), "--out", tmp_path / "out")
    process.wait_for(COMPILING)
    process.interrupt(times=2)
    goes_silently(process)
    assert not (tmp_path / "out").exists()


SWALLOWING = """
import os, signal, sys

class Swallows:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
        sum(range(1000))

def swallow(*_, **__):
    Swallows()
    while True:
        pass

import coman_reduced_model.output
coman_reduced_model.output.OutputFolder = swallow
from coman_reduced_model.cli.entry import main
main()
"""


@pytest.mark.slow
def test_ctrl_c_that_a_destructor_swallows(start, tmp_path):
    process = start(sys.executable, "-c", SWALLOWING, "diagnose", bag_path("stand"), "--out", tmp_path / "out")
    goes_silently(process)
    assert not process.output


HALF_MADE = """
import os, signal

class HalfMade:
    def __init__(self):
        os.kill(os.getpid(), signal.SIGINT)
        sum(range(1000))
        self.handle = 1

    def __del__(self):
        self.handle

import coman_reduced_model.output
coman_reduced_model.output.OutputFolder = lambda *_, **__: HalfMade()
from coman_reduced_model.cli.entry import main
main()
"""


@pytest.mark.slow
def test_ctrl_c_that_leaves_an_object_half_made(start, tmp_path):
    """Its destructor fails, as those of compilers do."""
    process = start(sys.executable, "-c", HALF_MADE, "diagnose", bag_path("stand"), "--out", tmp_path / "out")
    goes_silently(process)
    assert not process.output


TAKING = """
import os, signal, threading

lock = threading.Condition()

class Takes:
    def __enter__(self):
        lock.acquire()
        os.kill(os.getpid(), signal.SIGINT)
        sum(range(1000))

    def __exit__(self, *_):
        lock.release()

def work(*_, **__):
    try:
        with Takes():
            while True:
                pass
    finally:
        other = threading.Thread(target=lock.acquire)
        other.start()
        other.join()

import coman_reduced_model.output
coman_reduced_model.output.OutputFolder = work
from coman_reduced_model.cli.entry import main
main()
"""


@pytest.mark.slow
def test_ctrl_c_while_a_lock_is_taken_leaves_it_free(start, tmp_path):
    """The threads of a pool of processes, which has to end, wait for its locks."""
    process = start(sys.executable, "-c", TAKING, "diagnose", bag_path("stand"), "--out", tmp_path / "out")
    goes_silently(process)
    assert not process.output


ENDING = """
import atexit, os, signal

atexit.register(os.kill, os.getpid(), signal.SIGINT)
from coman_reduced_model.cli.entry import main
main()
"""


def test_ctrl_c_after_the_work_changes_nothing(start):
    process = start(sys.executable, "-c", ENDING, "--version")
    assert process.wait() == 0, process.output
    assert process.output.startswith("coman ") and len(process.output.splitlines()) == 1
