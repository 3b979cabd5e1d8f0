# SPDX-License-Identifier: BSD-3-Clause
"""What every test runs in: ROS confined to this machine, and processes that never outlive their test."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import settings
from ros_domains import domain_of_its_own

if TYPE_CHECKING:
    from ros_testing import Peer

ROOT = Path(__file__).resolve().parents[1]
pytest_plugins = ["bad_input_tools", "sim_runs"]  # fixtures that several files share
LONGEST = ("test_wheel.py", "test_readme.py", "test_package_xml.py")
NOT_HERE = "the recordings of other robots are not beside the project"

# How long tests wait for what has to come [s]: only a test that fails takes it. A machine that others use as well may
# give a process a tenth of a core for a minute.
PATIENCE = 120.0

# A deadline for each example measures how busy the machine is, not the code.
settings.register_profile("unhurried", deadline=None)
settings.load_profile("unhurried")

# Before anything imports rclpy. Each test process gets a domain of its own, so that two runs do not hear each other.
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
_DOMAIN = contextlib.ExitStack()  # until the process ends
_DOMAIN.enter_context(domain_of_its_own())
os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"
os.environ["RMW_IMPLEMENTATION"] = "rmw_fastrtps_cpp"

# Before anything imports numpy. Test processes run side by side: threads for each core in each of them only get in
# each other's way.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")


def recording(name: str) -> Path:
    """A recording of another robot, in the folder shared/ beside the project; the test is skipped without it."""
    path = ROOT.parent / "shared" / name
    if not path.exists():
        pytest.skip(f"{NOT_HERE}: {name}")
    return path


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with what takes longest: at the end, all other processes would wait for it."""
    items.sort(key=lambda item: item.path.name not in LONGEST)


@pytest.hookimpl(hookwrapper=True, tryfirst=True)
def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> Iterator[None]:
    """The last line but one says how many tests had no recording."""
    yield
    skipped = [report for report in terminalreporter.getreports("skipped") if NOT_HERE in str(report.longrepr)]
    if skipped:
        number = "1 test" if len(skipped) == 1 else f"{len(skipped)} tests"
        terminalreporter.write_line(f"{number} skipped: {NOT_HERE}")


def child_environment(**changes: str) -> dict[str, str]:
    """Environment for a Python of its own; inherited, the wheels' start-up mark would break that one's rclpy."""
    environment = {key: value for key, value in os.environ.items() if key != "_ROS_WHEELS_BOOTSTRAP_COMPLETE"}
    return {**environment, "PYTHONUNBUFFERED": "1", **changes}


class Process:
    """A command of ours in a process group of its own, its output (both streams) collected as it comes."""

    def __init__(self, command: list[str], **environment: str) -> None:
        self.command = command
        self._lines: list[str] = []
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            env=child_environment(**environment),
            start_new_session=True,
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._lines.append(line)

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def output(self) -> str:
        return "".join(self._lines)

    @property
    def running(self) -> bool:
        return self._process.poll() is None

    def wait_for(self, text: str, timeout: float = PATIENCE) -> None:
        """Return once the output contains the text.

        Raises:
            AssertionError: it ended or timed out [s] without; shows what it printed.
        """
        deadline = time.monotonic() + timeout
        while text not in self.output:
            ended = not self.running
            if ended:
                self._reader.join(2.0)
                if text in self.output:
                    return
            if ended or time.monotonic() > deadline:
                raise AssertionError(
                    f"{self.command} {'ended' if ended else 'goes on'} without {text!r}:\n{self.output}"
                )
            time.sleep(0.02)

    def wait_until_it_takes(self, number: int, timeout: float = PATIENCE) -> None:
        """Return once a signal no longer just kills the process: its code has begun to run."""
        deadline = time.monotonic() + timeout
        while time.monotonic() < deadline:
            status = Path(f"/proc/{self.pid}/status").read_text()
            if int(status.split("SigCgt:")[1].split()[0], 16) >> (number - 1) & 1:
                return
            time.sleep(0.01)
        raise AssertionError(f"{self.command} does not take signal {number} after {timeout} s")

    def wait(self, timeout: float = PATIENCE) -> int:
        """Exit code of a process that ends by itself within the timeout [s]."""
        try:
            code = self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            raise AssertionError(f"{self.command} goes on after {timeout} s:\n{self.output}") from None
        self._reader.join(2.0)
        return code

    def interrupt(self, times: int = 1) -> None:
        """Ctrl-C, as often as said."""
        for index in range(times):
            if index:
                time.sleep(0.05)
            if self.running:
                os.killpg(self.pid, signal.SIGINT)

    def send(self, number: signal.Signals) -> None:
        """A signal to the process group, if it still runs."""
        if self.running:
            os.killpg(self.pid, number)

    def stop(self, timeout: float = PATIENCE) -> int:
        """Ctrl-C and wait; the exit code."""
        self.interrupt()
        return self.wait(timeout)

    def kill(self) -> None:
        """End it and all its children, whatever they do."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)
        self._process.wait()


class Starter:
    """Starts commands of this package; what the `start` fixture gives."""

    def __init__(self) -> None:
        self.processes: list[Process] = []

    def __call__(self, executable: str, *arguments: str | Path, **environment: str) -> Process:
        """Start `predictor`, `trajectory`, `virtual_robot` or `coman` of this environment, or any file by its path."""
        path = Path(sys.executable).parent / executable
        process = Process([str(path), *map(str, arguments)], **environment)
        self.processes.append(process)
        return process

    def node(self, executable: str, *arguments: str | Path, **parameters: object) -> Process:
        """Start a node with ROS parameters; `__` in a name stands for a dot, as in `gait__name="test2"`."""
        ros = [item for name, value in parameters.items() for item in ("-p", f"{name.replace('__', '.')}:={value}")]
        return self(executable, "--ros-args", *arguments, *ros)


@pytest.fixture
def start() -> Iterator[Starter]:
    """Start processes that are killed at the end of the test if they have not ended."""
    starter = Starter()
    yield starter
    for process in starter.processes:
        process.kill()


@pytest.fixture
def ros_domain() -> Iterator[str]:
    """A ROS domain for one test, for itself and what it starts: messages of another test cannot reach it."""
    with domain_of_its_own() as domain:
        yield domain


# Of ros_testing.py for those who ask for it: most tests need no ROS.


@pytest.fixture(scope="session")
def nodes_compiled() -> None:
    """Nodes that start have nothing to compile."""
    from ros_testing import compile_once

    compile_once()


@pytest.fixture
def peer(ros_domain: str) -> Iterator[Peer]:
    """A node of the test's own process in the test's domain."""
    from ros_testing import Peer

    peer = Peer()
    yield peer
    peer.close()


@pytest.fixture
def without_second_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Diagnoses predict in the test's process: beside other tests, a second one costs its start and saves no time."""
    from coman_reduced_model.diagnose import workflow
    from coman_reduced_model.diagnose.inference.predicted_com import free_runs_here

    monkeypatch.setattr(workflow, "free_runs_in_helper", free_runs_here)


@pytest.fixture(scope="session")
def recorded_walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag of a short walk of the virtual robot."""
    from ros_testing import record_walk

    return record_walk(tmp_path_factory.mktemp("bags"))


@pytest.fixture(scope="session")
def standing():
    """Motors of COMAN that stands."""
    return _motors("stand")


@pytest.fixture(scope="session")
def walking():
    """Motors of COMAN that walks the paper's first gait."""
    return _motors("test1")


def _motors(gait: str):
    from coman_reduced_model.core.gait.gait import plan_walk
    from coman_reduced_model.sim.motion import plan_motion
    from coman_reduced_model.sim.record import robot_gait
    from coman_reduced_model.sim.robot_table import COMAN

    return plan_motion(COMAN, plan_walk(robot_gait(COMAN, gait)))[0]
