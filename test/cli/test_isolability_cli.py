# SPDX-License-Identifier: BSD-3-Clause
"""`coman isolability`."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from synthetic import walk, write_bag

from coman_reduced_model.cli.main import run
from coman_reduced_model.core.base.stream_names import JOINTS


@pytest.mark.slow
def test_the_matrix_is_printed_and_as_json(tmp_path, capsys):
    bag = str(write_bag(tmp_path / "bag", walk(6.0)))
    assert run(["isolability", bag]) == 0
    printed = capsys.readouterr().out
    assert "could be taken for" in printed and "joint_stiffness" in printed and "Cannot be distinguished" in printed
    assert run(["isolability", bag, "--size", "0.2", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    n = len(found["effects"])
    factors = np.array(found["factors"], dtype=float)
    assert factors.shape == (n, n) and n > 50
    names = {f"{each['name']}@{each['where']}" if each["where"] else each["name"] for each in found["effects"]}
    assert set(found["hidden"]) | set().union(*map(set, found["groups"])) <= names


def test_a_bag_that_is_not_there_is_one_line(tmp_path, capsys):
    assert run(["isolability", str(tmp_path / "nothing")]) == 2
    assert "nothing" in capsys.readouterr().err
    assert run(["isolability", str(tmp_path), "--size", "9"]) == 2


def without_torques(stream, message):
    return replace(message, effort=None) if stream == JOINTS else message


@pytest.mark.slow
def test_what_candidates_would_add_is_printed_and_as_json(tmp_path, capsys):
    """A stream that is missing is no obstacle; more of the same is a candidate too."""
    bag = str(write_bag(tmp_path / "bag", walk(6.0)))
    other = str(write_bag(tmp_path / "other", walk(4.0)))
    poor = str(write_bag(tmp_path / "poor", walk(4.0), without_torques))
    command = ["isolability", bag, "--size", "1.0", "--candidate", poor, "--candidate", other]
    assert run(command) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "With 20 s more, like each of these" in printed and "these alone" in printed and "with 3" in printed
    assert run([*command, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["seconds"] == 20.0 and len(found["candidates"]) == 3
    by_bag = {(each["bag"], each["again"]): each for each in found["candidates"]}
    assert set(by_bag) == {(other, False), (poor, False), (bag, True)}
    assert by_bag[other, False]["lasts"] < 4.0 < by_bag[bag, True]["lasts"] < 6.0
    assert set(by_bag[other, False]["hidden"]) < set(found["hidden"])
    order = [(-each["distinguished"], len(each["hidden"])) for each in found["candidates"]]
    assert order == sorted(order)
    assert found["pairs"] and all(len(pair["with"]) == 3 for pair in found["pairs"])
    members = [set(group) for group in found["groups"]]
    for pair in found["pairs"]:
        assert pair["alone"] < 3.0 and any(set(pair["effects"]) <= group for group in members)
    for k, each in enumerate(found["candidates"]):
        assert each["distinguished"] == sum(pair["with"][k] >= 3.0 for pair in found["pairs"])


def test_a_candidate_that_cannot_be_used_is_one_line(tmp_path, capsys):
    bag = str(write_bag(tmp_path / "bag", walk(3.0)))
    short = str(write_bag(tmp_path / "short", walk(1.0)))
    for candidate, reason in ((str(tmp_path / "nothing"), "nothing"), (short, "less than 2 s")):
        assert run(["isolability", bag, "--candidate", candidate, "--json"]) == 2
        text, err = capsys.readouterr()
        (line,) = [line for line in err.splitlines() if line.startswith("coman: ")]
        assert reason in line and text == "" and "Traceback" not in err
