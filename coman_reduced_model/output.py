# SPDX-License-Identifier: BSD-3-Clause
"""Output: folders that are complete or not at all, files that are not overwritten unasked, JSON as it is defined."""

from __future__ import annotations

import json
import math
import os
import shutil
import tempfile
from pathlib import Path
from typing import Any

from .errors import OutputError


class OutputFolder:
    """Collects files in a temporary folder and moves them to their place when all has gone well.

    Use it in a `with` statement, which gives the temporary folder. If it is left by an exception, Ctrl-C included,
    nothing is left behind and what was there before is untouched.
    """

    def __init__(self, path: str | Path, force: bool = False) -> None:
        """Check that the folder may be written.

        Raises:
            OutputError: it exists and is not empty (without `force`), is a file, or it cannot be written there.
        """
        self.path = Path(path)
        if self.path.exists() and not self.path.is_dir():
            raise OutputError(f"{path}: exists and is no folder")
        _refuse_read_only(self.path)
        if self.path.is_dir() and not force and any(self.path.iterdir()):
            raise OutputError(f"{path}: the folder exists and is not empty; --force replaces what this command writes")

    def __enter__(self) -> Path:
        path = self.path.absolute()
        within = path if path.is_dir() else path.parent  # on the file system of the folder, which may be mounted there
        try:
            within.mkdir(parents=True, exist_ok=True)
            self._temporary = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=within))
        except OSError as error:
            raise OutputError(f"{self.path}: cannot be written: {error.strerror or error}") from None
        return self._temporary

    def __exit__(self, kind: object, *_: object) -> None:
        try:
            if kind is None:
                self._move()
        finally:
            shutil.rmtree(self._temporary, ignore_errors=True)

    def _move(self) -> None:
        """Replace what has the name of a new file or folder, and nothing else: --force must never empty a home."""
        try:
            self.path.mkdir(exist_ok=True)
            for entry in sorted(self._temporary.iterdir()):
                target = self.path / entry.name
                if target.is_dir() and not target.is_symlink():
                    shutil.rmtree(target)
                entry.replace(target)
        except OSError as error:
            raise OutputError(f"{self.path}: cannot be written: {error.strerror or error}") from None


def check_file(path: str | Path, force: bool) -> Path:
    """A file that may be written, said before the work begins.

    Raises:
        OutputError: it exists (without `force`), is a folder, or cannot be written there.
    """
    path = Path(path)
    if path.is_dir():
        raise OutputError(f"{path}: is a folder, wanted a file such as {path / 'tuned.yaml'}")
    if path.exists() and not force:
        raise OutputError(f"{path}: exists; --force replaces it")
    _refuse_read_only(path.absolute().parent)  # a file is replaced by another one in its folder
    return path


def _refuse_read_only(folder: Path) -> None:
    """A folder, or the one that exists above it.

    Raises:
        OutputError: nothing can be written to it.
    """
    there = next(each for each in (folder.absolute(), *folder.absolute().parents) if each.exists())
    if there.is_dir() and not os.access(there, os.W_OK | os.X_OK):
        raise OutputError(f"{folder}: cannot be written: {there} may not be written to")


def write_file(path: Path, content: str | bytes, private: bool = False) -> None:
    """Write a file and the folders above it, whole or not at all; `private`: only its owner can read it.

    Raises:
        OutputError: it cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_name(f".{path.name}.part")
        partial.write_bytes(content if isinstance(content, bytes) else content.encode())
        if private:
            partial.chmod(0o600)
        partial.replace(path)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from None


def to_json(value: Any) -> str:
    """JSON as it is defined: null for NaN and infinity, which it does not have."""

    def plain(item: Any) -> Any:
        if isinstance(item, dict):
            return {str(key): plain(entry) for key, entry in item.items()}
        if isinstance(item, (list, tuple)):
            return [plain(entry) for entry in item]
        return None if isinstance(item, float) and not math.isfinite(item) else item

    return json.dumps(plain(value), indent=2, ensure_ascii=False, allow_nan=False)
