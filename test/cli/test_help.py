# SPDX-License-Identifier: BSD-3-Clause
"""Help, version and shell completion, as users see them."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import typer
from conftest import child_environment

from coman_reduced_model import __version__
from coman_reduced_model.cli.main import app, run

COMMANDS = typer.main.get_command(app).commands


def test_help_groups_all_commands(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")
    assert run([]) == 0
    text = capsys.readouterr().out
    assert run(["--help"]) == 0
    assert capsys.readouterr().out == text
    assert set(re.findall(r"^│ ([a-z]+) ", text, re.M)) == set(COMMANDS)
    groups = re.findall(r"^╭─ (.+?) ─", text, re.M)
    assert groups[0] == "Options" and len(groups) > 4 and "Commands" not in groups, "each command is in a group"


@pytest.mark.parametrize("name", COMMANDS)
def test_help_of_each_command_ends_with_an_example_that_is_understood(name, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "150")
    assert run([name, "--help"]) == 0
    text = capsys.readouterr().out
    assert not re.findall(r"\b(?:tells?|told|hears?|heard|anew|so many|healthy)\b", text), "words of the glossary"
    example = text.strip().splitlines()[-1].strip()
    start, command, *arguments = shlex.split(example.removeprefix("Example: "))
    assert (start, command) == ("coman", name)
    COMMANDS[name].make_context(name, arguments)


def test_version(capsys):
    assert run(["--version"]) == 0
    assert capsys.readouterr().out == f"coman {__version__}\n"


COMPLETED = {
    "coman pre": ["predict"],
    "coman predict bag --set monitor.thr": ["monitor.threshold="],
    "coman record --gait test": ["test1", "test2"],
    "coman record --world creep": ["creeping"],
    "coman predict bag --rem": ["--remap"],
}


@pytest.mark.slow
@pytest.mark.parametrize("line", COMPLETED)
def test_the_shell_completes(line):
    coman = Path(sys.executable).with_name("coman")
    words = {"COMP_WORDS": line, "COMP_CWORD": str(line.count(" ")), "_COMAN_COMPLETE": "complete_bash"}
    done = subprocess.run([coman], env=child_environment(**words), capture_output=True, text=True, check=True)
    assert done.stdout.split() == COMPLETED[line]


def test_completion_can_be_installed():
    """As `coman --install-completion` does, without touching the files of whoever runs this."""
    coman = Path(sys.executable).with_name("coman")
    environment = child_environment(_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION="1")
    done = subprocess.run([coman, "--show-completion", "bash"], env=environment, capture_output=True, text=True)
    assert done.returncode == 0 and "complete -o default -F _coman_completion coman" in done.stdout
