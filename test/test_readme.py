# SPDX-License-Identifier: BSD-3-Clause
"""The README names commands, make targets, files and parameters that exist."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
import typer

from coman_reduced_model.cli.main import app
from coman_reduced_model.core.config.schema import Config

ROOT = Path(__file__).parent.parent
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
SHOWN = re.findall(r"^    (coman .*)$", TEXT, re.M)
NAMED = re.findall(r"`(coman [^`]+)`", TEXT)
COMMANDS = sorted({*SHOWN, *(line for line in NAMED if "--" in line)})


def test_commands_are_found():
    assert len(SHOWN) > 5 and len(COMMANDS) > len(SHOWN)


@pytest.mark.parametrize("line", COMMANDS)
def test_commands_are_understood(line):
    """Options and arguments are as the README says; nothing is run."""
    name, *arguments = shlex.split(line, comments=True)[1:]
    command = typer.main.get_command(app).commands[name]
    command.make_context(name, arguments)


def test_make_targets_exist():
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M)
    assert set(re.findall(r"(?:^    |`)make ([a-z-]+)", TEXT, re.M)) <= {*targets}


def test_files_exist():
    names = set(re.findall(r"`?((?:bench|config|bags|test)/[\w/]+(?:\.\w+)?)", TEXT))
    assert len(names) > 10 and not [name for name in names if not (ROOT / name).exists()]


def test_parameters_exist():
    keys = {*Config().flat(), "model.yaml"}  # the latter is a file of coman diagnose
    named = set(re.findall(r"`((?:prediction|model|streams|robot|support|output|gait|virtual_robot)\.[a-z_]+)", TEXT))
    assert len(named) > 5 and not named - set(keys)
