# SPDX-License-Identifier: BSD-3-Clause
"""The bags of an archive, found by the names of its files alone."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory

from ..bag.reader import SUFFIXES
from ..errors import BagError
from .store import Store, StoredFile

METADATA = "metadata.yaml"
_BLOCK = 2**20  # [bytes]


@dataclass(frozen=True)
class StoredBag:
    """A recording in an archive.

    Attributes:
        archive: URI of the folder that was searched; bag: path below it, of the folder of a bag or of its one file.
        files: of the bag, sorted by path.
        folder: whether the bag is a folder.
    """

    archive: str
    bag: str
    files: tuple[StoredFile, ...]
    folder: bool

    @property
    def size(self) -> int:
        """[bytes]."""
        return sum(file.size for file in self.files)

    @contextmanager
    def opened(self) -> Iterator[Path]:
        """The bag on this machine; what is elsewhere is copied for as long as the context lasts.

        Raises:
            BagError: it cannot be copied.
        """
        store = Store(self.archive)
        here = store.local_path(self.bag)
        if here is not None:
            yield here
            return
        with TemporaryDirectory(prefix="coman_archive_") as temporary:
            folder = Path(temporary)
            store.fetch([file.path for file in self.files], folder)
            yield folder if self.folder else folder / self.bag.rpartition("/")[2]

    def digest(self, path: Path) -> str:
        """SHA-256 over names and contents of the files of the bag, which is at a local path."""
        found = sha256()
        for file in self.files:
            name = file.path.rpartition("/")[2]
            found.update(f"{name}\0".encode())
            with (path / name if self.folder else path).open("rb") as opened:
                while block := opened.read(_BLOCK):
                    found.update(block)
        return found.hexdigest()


def find_bags(uris: Sequence[str]) -> list[StoredBag]:
    """All bags below some folders, sorted.

    A folder with a metadata.yaml is one bag, with all recordings directly in it; elsewhere each recording is one.

    Raises:
        BagError: a folder cannot be read, or there is no bag in any.
    """
    bags = [bag for uri in dict.fromkeys(uris) for bag in _bags_of(uri)]
    if not bags:
        raise BagError(f"{', '.join(uris)}: no bags below ({', '.join(SUFFIXES)} files)")
    return bags


def _bags_of(uri: str) -> list[StoredBag]:
    by_folder: dict[str, list[StoredFile]] = {}
    for file in Store(uri).files():
        folder, _, name = file.path.rpartition("/")
        if name == METADATA or name.endswith(SUFFIXES):
            by_folder.setdefault(folder, []).append(file)
    bags = []
    for folder, files in by_folder.items():
        if any(file.path.rpartition("/")[2] == METADATA for file in files):
            bags.append(StoredBag(uri, folder, tuple(files), True))
        else:
            bags += [StoredBag(uri, file.path, (file,), False) for file in files]
    return sorted(bags, key=lambda bag: bag.bag)
