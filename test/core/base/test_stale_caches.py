# SPDX-License-Identifier: BSD-3-Clause
"""What was compiled before the newest source is forgotten."""

from __future__ import annotations

import os

from coman_reduced_model.core.base.compiled import _drop_stale_caches


def test_code_goes_with_its_index(tmp_path):
    """An index without its code, or code without its index, would have another process load what was there before."""
    cache = tmp_path / "core/__pycache__"
    cache.mkdir(parents=True)
    (tmp_path / "core/stride.py").touch()
    for name, age in (("stride.old-1.py311", -10), ("stride.new-9.py311", 10)):
        for file in (f"{name}.nbi", f"{name}.1.nbc", f"{name}.2.nbc"):
            (cache / file).touch()
            time = (tmp_path / "core/stride.py").stat().st_mtime + age
            os.utime(cache / file, (time, time))
    _drop_stale_caches(tmp_path / "core")
    assert {each.name for each in cache.iterdir()} == {f"stride.new-9.py311.{end}" for end in ("nbi", "1.nbc", "2.nbc")}
