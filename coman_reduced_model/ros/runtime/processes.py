# SPDX-License-Identifier: BSD-3-Clause
"""Nodes as processes of their own, for `coman live` and `coman demo`: started, watched, stopped."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

PARENT = "COMAN_PARENT"  # process without which a node ends: a terminal that is closed leaves none behind


class NodeFailed(Exception):
    """A node has ended that should run: says which and its last words."""


def confine() -> None:
    """Keep what is started from here on to this machine and, unless one is set, to a ROS domain of its own."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_DOMAIN_ID", str(random.SystemRandom().randint(1, 101)))


class Nodes:
    """Running nodes. Use it in a `with` statement: at its end they are stopped."""

    def __init__(self, config: Path) -> None:
        """All nodes take the same parameter file."""
        self._config = config
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._folder = tempfile.TemporaryDirectory(prefix="coman_")
        self.exit_codes: dict[str, int] = {}

    def start(self, name: str, parameters: Mapping[str, object] | None = None) -> None:
        """Start predictor, trajectory or virtual_robot, with parameters beside those of the file."""
        command = [
            sys.executable,
            "-m",
            "coman_reduced_model.ros",
            name,
            "--ros-args",
            "--params-file",
            str(self._config),
        ]
        for key, value in (parameters or {}).items():
            command += ["-p", f"{key}:={json.dumps(value, ensure_ascii=False)}"]  # YAML, in which texts stay texts
        with self._log(name).open("wb") as log:
            # A session of its own, so that Ctrl-C comes to us and we stop the nodes in order.
            self._running[name] = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT, start_new_session=True,
                env={**os.environ, PARENT: str(os.getpid())},
            )  # fmt: skip

    def _log(self, name: str) -> Path:
        return Path(self._folder.name) / f"{name}.log"

    def output(self, name: str) -> str:
        """What a node has printed so far."""
        return self._log(name).read_text(encoding="utf-8", errors="replace")

    def check(self) -> None:
        """Look whether all still run.

        Raises:
            NodeFailed: one does not.
        """
        for name, process in self._running.items():
            if (code := process.poll()) is not None:
                lines = self.output(name).strip().splitlines() or ["it printed nothing"]
                raise NodeFailed(f"{name} has ended with exit code {code}: {lines[-1]}")

    def stop(self, timeout_s: float = 10.0) -> None:
        """Stop all nodes; their exit codes are in `exit_codes`."""
        for process in self._running.values():
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
        for name, process in self._running.items():
            try:
                self.exit_codes[name] = process.wait(timeout_s)
            except subprocess.TimeoutExpired:
                process.kill()
                self.exit_codes[name] = process.wait()
        self._running.clear()

    def __enter__(self) -> Nodes:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
        self._folder.cleanup()


def why_not() -> str | None:
    """Why nodes cannot be started here; None: they can."""
    try:
        import coman_reduced_model_msgs.msg
        import rclpy  # noqa: F401

        del coman_reduced_model_msgs
    except ImportError as error:
        return f"ROS 2 and the built messages are needed ({error}): source ROS 2 Jazzy, or `make setup`"
    return None
