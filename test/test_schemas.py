# SPDX-License-Identifier: BSD-3-Clause
"""What commands write is as the shipped JSON Schemas say; older versions are read, newer ones refused in one line."""

from __future__ import annotations

import json

import pytest
from jsonschema import Draft202012Validator
from synthetic import walk, write_bag

from coman_reduced_model import ComanError, read_result
from coman_reduced_model.cli.main import run
from coman_reduced_model.schemas import KINDS, VERSION, schema


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The output of `coman predict`."""
    folder = tmp_path_factory.mktemp("predicted")
    bag = write_bag(folder / "bag", walk(2.0))
    assert run(["predict", str(bag), "--out", str(folder / "out")]) == 0
    return folder / "out"


@pytest.mark.parametrize("kind", KINDS)
def test_schemas_are_schemas(kind):
    Draft202012Validator.check_schema(schema(kind))
    assert schema(kind)["properties"]["schema_version"]["const"] == VERSION


def test_a_summary_is_as_its_schema_says_and_all_of_it_is_described(folder):
    summary = read_result(folder / "summary.json")
    Draft202012Validator(schema("summary")).validate(summary)
    assert {*summary} <= {*schema("summary")["properties"]}


@pytest.mark.slow
def test_a_summary_of_an_older_version_is_read_and_reported(folder, tmp_path, capsys):
    summary = json.loads((folder / "summary.json").read_text())
    for key in ("schema_version", "within_90", "model_share", "simpler_ahead", "estimate"):  # 0.2.0 has none of them
        del summary[key]
    older = tmp_path / "older"
    older.mkdir()
    (older / "predictions").symlink_to(folder / "predictions")
    (older / "summary.json").write_text(json.dumps(summary))
    assert read_result(older / "summary.json")["schema_version"] == 0
    assert run(["report", str(older)]) == 0 and (older / "report.html").is_file()


def test_a_newer_version_is_refused_in_one_line(folder, tmp_path, capsys):
    summary = json.loads((folder / "summary.json").read_text())
    newer = tmp_path / "newer"
    newer.mkdir()
    (newer / "predictions").symlink_to(folder / "predictions")
    (newer / "summary.json").write_text(json.dumps({**summary, "schema_version": VERSION + 1}))
    with pytest.raises(ComanError, match=f"schema_version {VERSION + 1}"):
        read_result(newer / "summary.json")
    assert run(["report", str(newer)]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
