# SPDX-License-Identifier: BSD-3-Clause
"""Processes that work for a command end with it, and so does what they have started."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from multiprocessing import active_children
from pathlib import Path

import pytest

from coman_reduced_model import processes
from coman_reduced_model.processes import workers


def wait_for_a_command(started: str) -> None:
    """Write the number of a process that lasts, and wait for it."""
    code = "import os, sys, time; open(sys.argv[1], 'w').write(str(os.getpid())); time.sleep(60)"
    subprocess.run([sys.executable, "-c", code, started], check=False)


def runs(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def until(condition, seconds: float = 20.0) -> bool:
    end = time.monotonic() + seconds
    while time.monotonic() < end and not condition():
        time.sleep(0.05)
    return bool(condition())


def test_an_interrupt_ends_processes_and_the_commands_that_they_wait_for(tmp_path: Path):
    started = tmp_path / "pid"
    with pytest.raises(KeyboardInterrupt), workers(1) as pool:
        pool.submit(wait_for_a_command, str(started))
        assert until(lambda: started.is_file() and started.read_text())
        raise KeyboardInterrupt
    assert until(lambda: not runs(int(started.read_text())))


def begin(path: str) -> None:
    Path(path).touch()


def test_a_process_begins_with_what_it_is_given_and_gives_results(tmp_path: Path):
    with workers(1, begin, (str(tmp_path / "begun"),)) as pool:
        assert pool.submit(sum, [1, 2]).result() == 3
    assert (tmp_path / "begun").is_file()


class Interrupted(processes._Pool):
    """Ctrl-C comes while its process is started."""

    def submit(self, *call, **named):
        started = super().submit(*call, **named)
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.1)
        return started


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_ctrl_c_while_a_process_is_started_is_not_lost(monkeypatch, method):
    monkeypatch.setattr(processes, "_Pool", Interrupted)
    begun = []
    with pytest.raises(KeyboardInterrupt), workers(1, method=method):
        begun.append(method)
    assert not begun and until(lambda: not active_children())


class EndedWhileSent:
    """A result whose process gets SIGTERM while it is sent."""

    def __reduce__(self):
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(0.1)
        return str, ("whole",)


def test_a_result_that_is_being_sent_arrives_whole_and_nothing_is_begun_after_it():
    with workers(1) as pool:
        assert pool.submit(EndedWhileSent).result() == "whole"
        with pytest.raises(SystemExit):
            pool.submit(int).result()


KILLED = """
import os, sys, time
from coman_reduced_model.processes import workers

def work(path):
    with open(path, "w") as file:
        file.write(str(os.getpid()))
    time.sleep(60)

if __name__ == "__main__":
    with workers(2) as pool:
        list(pool.map(work, sys.argv[1:]))
"""


@pytest.mark.slow
def test_processes_end_when_the_command_is_killed(tmp_path: Path):
    started = [tmp_path / "one", tmp_path / "two"]
    command = subprocess.Popen([sys.executable, "-c", KILLED, *map(str, started)])
    assert until(lambda: all(path.is_file() and path.read_text() for path in started))
    command.kill()
    command.wait()
    assert until(lambda: not any(runs(int(path.read_text())) for path in started))
