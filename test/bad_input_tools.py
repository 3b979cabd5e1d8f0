# SPDX-License-Identifier: BSD-3-Clause
"""The command line on bags that are spoiled: never a traceback, and one line for what cannot be done."""

from __future__ import annotations

import json
import math
import shutil

import pytest
from hypothesis import HealthCheck, settings
from synthetic import walk, write_bag

from coman_reduced_model.bag.reader import Bag
from coman_reduced_model.cli.main import run
from coman_reduced_model.core.base.limits import DIVERGED
from coman_reduced_model.core.base.types import Flags

SECONDS = 2.0
few = settings(max_examples=8, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture
def predict(tmp_path, capsys):
    """Runs `coman predict` on a bag; gives exit code, summary and standard error. Never a traceback."""

    def call(bag, *arguments):
        out = tmp_path / "out"
        shutil.rmtree(out, ignore_errors=True)
        capsys.readouterr()
        code = run(["predict", str(bag), "--out", str(out), "--json", *map(str, arguments)])
        text, err = capsys.readouterr()
        assert "Traceback" not in err
        if code:
            assert code == 2 and text == "" and not out.exists()
            lines = [line for line in err.splitlines() if line.startswith("coman: ")]
            assert len(lines) == 1, err
        return code, json.loads(text) if text else None, err

    return call


@pytest.fixture
def unpredictable(tmp_path, predict):
    """Runs `coman predict` on a walk so spoiled that there is no prediction; gives the one line of the error."""

    def call(change, seconds=SECONDS):
        shutil.rmtree(tmp_path / "bag", ignore_errors=True)
        code, _, err = predict(write_bag(tmp_path / "bag", walk(seconds), change))
        assert code == 2, "nothing was predicted"
        (line,) = [line for line in err.splitlines() if "nothing could be predicted" in line]
        return line

    return call


@pytest.fixture
def spoiled(tmp_path, predict):
    """Runs `coman predict` on a walk whose messages `change` has spoiled; it must succeed."""

    def call(change, *arguments, seconds=SECONDS):
        shutil.rmtree(tmp_path / "bag", ignore_errors=True)
        bag = write_bag(tmp_path / "bag", walk(seconds), change)
        code, summary, err = predict(bag, *arguments)
        assert code == 0, err
        return summary

    return call


def check_bounds(out):
    """What `coman predict` wrote is physically possible, or NaN with a flag."""
    with Bag(out / "predictions") as written:
        for _, _, message in written.messages(["/com/prediction"]):
            residual = message.residual
            assert not math.hypot(residual.x, residual.y, residual.z) >= DIVERGED
            for each in message.horizons:
                p = each.position
                assert math.isfinite(p.x + p.y + p.z) or message.flags & Flags.REJECTED_STATE
