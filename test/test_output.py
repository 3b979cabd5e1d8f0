# SPDX-License-Identifier: BSD-3-Clause
"""Where results go: complete or not at all, on the file system where they are wanted, refused before the work."""

from __future__ import annotations

import os

import pytest

from coman_reduced_model.core.config.files import load_config, save_config
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.errors import OutputError
from coman_reduced_model.output import OutputFolder, check_file


def test_a_folder_that_exists_is_filled_from_within(tmp_path):
    """It may be mounted: a file of another file system cannot be moved there at once."""
    (tmp_path / "out").mkdir()
    (tmp_path / "out/kept").write_text("kept")
    with OutputFolder(tmp_path / "out", force=True) as folder:
        assert folder.parent == tmp_path / "out"
        (folder / "new").write_text("new")
    assert {each.name for each in (tmp_path / "out").iterdir()} == {"kept", "new"}


@pytest.mark.parametrize("there", [True, False])
def test_files_that_a_configuration_names_are_found_from_where_it_ends_up(tmp_path, there):
    config, out = Config().replaced({"robot.urdf": str(tmp_path / "robot.urdf")}), tmp_path / "out"
    if there:
        out.mkdir()
    with OutputFolder(out) as folder:
        save_config(config, folder / "config.yaml", folder=out)
    assert load_config(out / "config.yaml").urdf.resolve() == (tmp_path / "robot.urdf").resolve()


def test_what_cannot_be_written_is_said_before_the_work(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "access", lambda path, mode: str(path) != str(tmp_path))
    for made in (lambda: OutputFolder(tmp_path / "a/b"), lambda: check_file(tmp_path / "a/b.yaml", False)):
        with pytest.raises(OutputError, match="may not be written to"):
            made()
    (tmp_path / "out").mkdir()
    OutputFolder(tmp_path / "out")  # as in a container: only what is mounted may be written to
