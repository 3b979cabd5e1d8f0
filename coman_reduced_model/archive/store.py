# SPDX-License-Identifier: BSD-3-Clause
"""Folders that a URI names: of this machine, or of an object store, by fsspec."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import fsspec
from fsspec.implementations.local import LocalFileSystem

from ..errors import BagError, OutputError

# What a file system says of the contents of a file without reading it.
_TAGS = (
    "ETag",
    "etag",
    "md5Hash",
    "content_md5",
    "sha256",
    "mtime",
    "LastModified",
    "last_modified",
    "modify",
    "updated",
)


@dataclass(frozen=True)
class StoredFile:
    """A file of a store: its path below the folder, its size [bytes], and a text that changes when it changes."""

    path: str
    size: int
    tag: str


class Store:
    """A folder: a path, or the URI of one, such as s3://bucket/walks."""

    def __init__(self, uri: str) -> None:
        """Connect.

        Raises:
            BagError: no such kind of file system, or a package for it is missing.
        """
        self.uri = uri
        try:
            self._fs, self._root = fsspec.core.url_to_fs(uri)
        except (ValueError, ImportError) as error:
            raise BagError(f"{uri}: {error}") from None
        self.local = isinstance(self._fs, LocalFileSystem)

    def path(self, name: str = "") -> str:
        """As the file system calls a file of the folder."""
        return f"{self._root.rstrip('/')}/{name}" if name else self._root

    def local_path(self, name: str = "") -> Path | None:
        """On this machine; None if it is elsewhere."""
        return Path(self.path(name)) if self.local else None

    def files(self, below: str = "") -> list[StoredFile]:
        """All files in the folder and in the folders of it, sorted by path; none that is hidden.

        Raises:
            BagError: there is no such folder, or it cannot be read.
        """
        try:
            if not self._fs.isdir(self.path(below)):
                raise BagError(f"{self.uri}: no such folder")
            found = self._fs.find(self.path(below), detail=True)
        except BagError:
            raise
        except Exception as error:  # each file system has its own
            raise BagError(f"{self.uri}: cannot be read: {_line(error)}") from None
        start = len(self._root.rstrip("/")) + 1
        files = [StoredFile(path[start:], int(entry["size"] or 0), _tag(entry)) for path, entry in found.items()]
        return sorted((each for each in files if not _hidden(each.path)), key=lambda each: each.path)

    def names(self, folder: str) -> list[str]:
        """Names of the files in a folder; none if it is not there."""
        try:
            return sorted(path.rpartition("/")[2] for path in self._fs.ls(self.path(folder), detail=False))
        except FileNotFoundError:
            return []

    def exists(self, name: str) -> bool:
        """Whether there is such a file."""
        return bool(self._fs.exists(self.path(name)))

    def read(self, name: str) -> bytes:
        """The contents of a file.

        Raises:
            BagError: it cannot be read.
        """
        try:
            return bytes(self._fs.cat_file(self.path(name)))
        except Exception as error:
            raise BagError(f"{self.uri}: {name} cannot be read: {_line(error)}") from None

    def read_all(self, names: list[str]) -> dict[str, bytes]:
        """The contents of many files, by name; of an object store many at a time. Missing ones are left out."""
        if self.local:  # fsspec takes [, * and ? for patterns
            paths = {name: Path(self.path(name)) for name in names}
            return {name: path.read_bytes() for name, path in paths.items() if path.is_file()}
        found = self._fs.cat([self.path(name) for name in names], on_error="omit") if names else {}
        start = len(self._root.rstrip("/")) + 1
        if isinstance(found, bytes):
            return {names[0]: found}
        return {path[start:]: contents for path, contents in found.items()}

    def fetch(self, names: list[str], folder: Path) -> None:
        """Copy files of the folder into a local one.

        Raises:
            BagError: one cannot be read.
        """
        for name in names:
            target = folder / name.rpartition("/")[2]
            try:
                self._fs.get_file(self.path(name), str(target))
            except Exception as error:
                raise BagError(f"{self.uri}: {name} cannot be read: {_line(error)}") from None

    def remove(self, name: str) -> None:
        """Remove a file."""
        self._fs.rm_file(self.path(name))

    def write(self, name: str, contents: bytes) -> None:
        """Write a file, whole or not at all: locally by renaming, into an object store by putting it.

        Raises:
            OutputError: it cannot be written.
        """
        target = self.path(name)
        try:
            self._fs.makedirs(target.rpartition("/")[0], exist_ok=True)
            if self.local:
                folder, _, last = target.rpartition("/")
                partial = f"{folder}/.{last}.{os.getpid()}.part"
                Path(partial).write_bytes(contents)
                Path(partial).replace(target)
            else:
                self._fs.pipe_file(target, contents)
        except Exception as error:
            raise OutputError(f"{self.uri}: {name} cannot be written: {_line(error)}") from None


def _tag(entry: dict[str, Any]) -> str:
    return next((str(entry[key]) for key in _TAGS if entry.get(key)), "")


def _hidden(path: str) -> bool:
    return any(part.startswith(".") for part in path.split("/"))


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__
