# SPDX-License-Identifier: BSD-3-Clause
"""`coman isolability`."""

from __future__ import annotations

import json

import numpy as np
from synthetic import walk, write_bag

from coman_reduced_model.cli.main import run


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
