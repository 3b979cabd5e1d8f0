# SPDX-License-Identifier: BSD-3-Clause
"""Recordings, message by message and never loaded whole: MCAP or SQLite, compressed, split, or cut off."""

from __future__ import annotations

import heapq
import tempfile
from collections.abc import Collection, Iterator, Sequence
from contextlib import ExitStack
from itertools import chain
from pathlib import Path
from typing import Any, Protocol

import zstandard
from rosbags.interfaces import MessageDefinitionFormat
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.storage_mcap import McapReader
from rosbags.typesys import get_types_from_msg
from rosbags.typesys.store import Typestore

from ..errors import BagError
from ..messages import OWN
from .blocks import Raw, RawBlock, grouped
from .chunks import GROWTH, LARGEST, grows_unchecked, indexed_blocks, plain
from .truncated import MAGIC, TruncatedMcap
from .types import typestore

SUFFIXES = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd")


class _Part(Protocol):
    """One file of a bag, or a whole bag that rosbags reads."""

    topics: dict[str, str]
    definitions: dict[str, str]
    counts: dict[str, int]
    start_ns: int
    end_ns: int

    def blocks(self, topics: Collection[str]) -> Iterator[RawBlock]: ...


class Bag:
    """One recording, open for reading. Use it in a `with` statement, or call `close`.

    Attributes:
        topics: name to type.
        counts: topic to number of messages.
        start_ns, end_ns: log times of the first and last message.
        warnings: what could not be read, a line each; more may come while messages are read.
    """

    def __init__(self, path: str | Path) -> None:
        """Open a bag: its folder, or one of its files.

        Raises:
            BagError: says what is wrong with which file.
        """
        self.path = Path(path)
        self.warnings: list[str] = []
        self._stack = ExitStack()
        try:
            self._parts = sorted(self._open(), key=lambda part: part.start_ns)
        except BaseException:
            self.close()
            raise
        self.topics: dict[str, str] = {}
        self.counts: dict[str, int] = {}
        for part in self._parts:
            for topic, kind in part.topics.items():
                if self.topics.setdefault(topic, kind) != kind:
                    raise BagError(f"{path}: {topic}: of type {self.topics[topic]} in one file and {kind} in another")
                self.counts[topic] = self.counts.get(topic, 0) + part.counts.get(topic, 0)
        if not self.message_count:
            self.close()
            raise BagError("; ".join([f"{path}: the bag has no messages", *self.warnings]))
        used = [part for part in self._parts if any(part.counts.values())]
        self.start_ns = min(part.start_ns for part in used)
        self.end_ns = max(part.end_ns for part in used)
        self.typestore = self._typestore()

    @property
    def message_count(self) -> int:
        """Number of messages of all topics."""
        return sum(self.counts.values())

    @property
    def duration_s(self) -> float:
        """From the first to the last log time [s]."""
        return (self.end_ns - self.start_ns) * 1e-9

    def close(self) -> None:
        """Close the files, remove what was decompressed."""
        self._stack.close()

    def __enter__(self) -> Bag:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def raw(self, topics: Collection[str]) -> Iterator[Raw]:
        """Topic, log time [ns] and serialised message, in the order of the log times (damaged files: as written)."""
        for block in self.blocks(topics):
            yield from block

    def blocks(self, topics: Collection[str]) -> Iterator[RawBlock]:
        """The same messages, some thousand at a time."""
        parts = [plain(part.blocks(topics)) for part in self._parts if any(topic in part.topics for topic in topics)]
        ends = [(part.start_ns, part.end_ns) for part in self._parts]
        apart = all(before[1] <= after[0] for before, after in zip(ends, ends[1:], strict=False))
        if apart:
            for part in parts:
                yield from part
        else:
            yield from grouped(heapq.merge(*map(chain.from_iterable, parts), key=lambda item: item[1]))

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, Any]]:
        """Topic, log time [ns] and message, with the fields that ROS gives it.

        Raises:
            BagError: a message cannot be decoded.
        """
        for topic, log_time, raw in self.raw(topics):
            yield topic, log_time, self.decode(topic, raw)

    def decode(self, topic: str, raw: bytes) -> Any:
        """The message that bytes of a topic are.

        Raises:
            BagError: they are not of the topic's type.
        """
        try:
            return self.typestore.deserialize_cdr(raw, self.topics[topic])
        except Exception as error:  # rosbags, struct, numpy and codecs each have their own
            reason = " ".join(str(error).split())[:120]
            raise BagError(f"{self.path}: {topic}: a message is no {self.topics[topic]}: {reason}") from None

    def first(self, topic: str) -> Any | None:
        """The first message of a topic; None if it has none."""
        return next((message for _, _, message in self.messages([topic])), None)

    # --- opening ---

    def _open(self) -> list[_Part]:
        path = self.path
        if not path.exists():
            raise BagError(f"{path}: no such file or folder")
        if path.is_file():
            return [self._file(path)]
        problem = "no metadata.yaml"
        inside = sorted(each for each in path.iterdir() if each.name.endswith(SUFFIXES))
        if any(grows_unchecked(each) for each in inside):
            return self._files(inside)
        if (path / "metadata.yaml").is_file():
            try:
                return [self._whole(path)]
            except Exception as error:  # a wrong metadata.yaml fails in any way; the files may be good all the same
                problem = " ".join(str(error).split())[:200] or type(error).__name__
        if not inside:
            raise BagError(f"{path}: not a bag: {problem}, and no {', '.join(SUFFIXES[:2])} file")
        self.warnings.append(f"{path}: read file by file: {problem}")
        return self._files(inside)

    def _files(self, inside: Sequence[Path]) -> list[_Part]:
        """Those that can be read: the last one may hold nothing, where power was lost."""
        parts, problems = [], []
        for file in inside:
            try:
                parts.append(self._file(file))
            except BagError as error:
                problems.append(error)
        if not parts:
            raise problems[0]
        self.warnings += [f"{error}; left out" for error in problems]
        return parts

    def _file(self, path: Path, shown: Path | None = None) -> _Part:
        """Open one file; `shown` is what it is called to people, if it is a decompressed copy."""
        shown = shown or path
        if path.name == "metadata.yaml":
            return self._whole(path.parent)
        with path.open("rb") as file:
            start = file.read(16)
        if start.startswith(b"\x28\xb5\x2f\xfd"):
            return self._file(self._decompressed(path), path)
        if start.startswith(b"#ROSBAG"):
            raise BagError(f"{shown}: a bag of ROS 1; convert it first: rosbags-convert --src {shown.name} --dst NEW")
        if start.startswith(b"SQLite format 3\0"):
            return self._whole(path, ".db3")
        if not start.startswith(MAGIC):
            raise BagError(f"{shown}: neither an MCAP nor an SQLite bag{'' if start else ': the file is empty'}")
        if grows_unchecked(path):
            return self._cut(path, shown)
        try:
            return self._whole(path, ".mcap")
        except Exception:  # however it fails, it is not whole
            return self._cut(path, shown)

    def _whole(self, path: Path, suffix: str = "") -> _Part:
        if suffix and path.suffix != suffix:  # rosbags goes by the name
            link = Path(self._stack.enter_context(tempfile.TemporaryDirectory()), f"bag{suffix}")
            link.symlink_to(path.resolve())
            path = link
        try:
            return _Whole(self, self._stack.enter_context(Reader(path)))
        except Exception as error:
            if suffix == ".db3":
                raise BagError(f"{self.path}: {' '.join(str(error).split())[:200]}") from None
            raise

    def _cut(self, path: Path, shown: Path) -> _Part:
        part = TruncatedMcap(path)
        size, reason = path.stat().st_size, part.reason or "its index is damaged"
        messages = sum(part.counts.values())
        self.warnings.append(
            f"{shown}: {reason}: usable up to byte {part.usable_bytes} of {size}: {messages} messages"
            + (
                f", {(part.end_ns - part.start_ns) * 1e-9:.3f} s, the last at {_seconds(part.end_ns)}"
                if messages
                else ""
            )
        )
        return _Cut(part)

    def _decompressed(self, path: Path) -> Path:
        folder = Path(self._stack.enter_context(tempfile.TemporaryDirectory()))
        target = folder / path.name.removesuffix(".zstd").removesuffix(".zst")
        problem = "it is cut off in its first block"
        try:
            with path.open("rb") as source, target.open("wb") as out:
                most = GROWTH * path.stat().st_size + LARGEST
                for part in zstandard.ZstdDecompressor().read_to_iter(source):
                    out.write(part)
                    if out.tell() > most:
                        raise BagError(f"{path}: grows to more than {most >> 20} MB: not decompressed")
        except zstandard.ZstdError as error:
            problem = str(error)
            self.warnings.append(f"{path}: decompressed as far as it goes: {error}")
        if not target.stat().st_size:
            raise BagError(f"{path}: cannot be decompressed: {problem}")
        return target

    def _typestore(self) -> Typestore:
        """Jazzy's definitions, and for our own messages those that the bag carries: it may be older than we are."""
        store = typestore()
        definitions = {kind: text for part in self._parts for kind, text in part.definitions.items()}
        own = {kind: text for kind, text in definitions.items() if kind.startswith(OWN)}
        foreign = {kind: text for kind, text in definitions.items() if kind not in store.types or kind in own}
        if not foreign:
            return store
        from rosbags.typesys import Stores, get_typestore

        merged = get_typestore(Stores.ROS2_JAZZY)
        for kind, text in foreign.items():
            try:
                merged.register(get_types_from_msg(text, kind))
            except Exception as error:
                self.warnings.append(f"{self.path}: the definition of {kind} cannot be read: {error}")
        # Where the bag's definition of one of our messages is damaged or absent, ours serves.
        merged.register({kind: fields for kind, fields in store.fielddefs.items() if kind not in merged.fielddefs})
        return merged


class _Whole:
    """What rosbags reads."""

    def __init__(self, bag: Bag, reader: Reader) -> None:
        self._bag = bag
        self._reader = reader
        connections = reader.connections
        self.topics = {each.topic: each.msgtype for each in connections}
        self.counts: dict[str, int] = {}
        for each in connections:
            self.counts[each.topic] = self.counts.get(each.topic, 0) + each.msgcount
        self.definitions = {
            each.msgtype: each.msgdef.data for each in connections if each.msgdef.format == MessageDefinitionFormat.MSG
        }
        self.start_ns, self.end_ns = reader.start_time, reader.end_time - 1

    def blocks(self, topics: Collection[str]) -> Iterator[RawBlock]:
        wanted = {each.topic for each in self._reader.connections if each.topic in topics}
        if not wanted:
            return
        last = 0
        try:
            for block in self._blocks(wanted):
                if len(block):
                    last = int(block.log_time[-1])
                yield block
        except GeneratorExit:
            raise
        except Exception as error:  # a damaged chunk fails in any way; what came before is good
            reason = " ".join(str(error).split())[:120] or type(error).__name__
            where = f"after the message at {_seconds(last)}" if last else "at the first message"
            self._bag.warnings.append(f"{self._reader.path}: damaged {where}, the rest is not read: {reason}")

    def _blocks(self, topics: Collection[str]) -> Iterator[RawBlock]:
        files = getattr(self._reader.storage, "storages", [self._reader.storage])  # of a folder; or it is a file itself
        direct = [indexed_blocks(Path(str(file.path)), topics) for file in files if isinstance(file, McapReader)]
        if len(direct) == len(files) and None not in direct:
            for blocks in direct:
                yield from blocks or ()
            return
        yield from grouped(self._messages(files, topics))

    def _messages(self, files: Collection[Any], topics: Collection[str]) -> Iterator[Raw]:
        """One by one, as rosbags reads them."""
        for file in files:
            connections = [each for each in file.connections if each.topic in topics]
            # Without chunks messages lie as they were written, which need not be in order.
            read = file.messages_scan if isinstance(file, McapReader) and not file.chunks else file.messages
            for connection, log_time, raw in read(connections) if connections else ():
                yield connection.topic, log_time, bytes(raw)


class _Cut:
    """What is left of a truncated file."""

    def __init__(self, part: TruncatedMcap) -> None:
        self._part = part
        self.topics, self.definitions, self.counts = part.topics, part.definitions, part.counts
        self.start_ns, self.end_ns = part.start_ns, part.end_ns

    def blocks(self, topics: Collection[str]) -> Iterator[RawBlock]:
        return grouped(item for item in self._part.messages() if item[0] in topics)


def _seconds(stamp_ns: int) -> str:
    return f"{stamp_ns // 10**9}.{stamp_ns % 10**9:09d} s"


def open_bag(path: str | Path, topics: Collection[str]) -> Iterator[tuple[str, int, Any]]:
    """Topic, log time [ns] and message of some topics of a bag, one after the other.

    Raises:
        BagError: the bag cannot be read or lacks a topic.
    """
    with Bag(path) as bag:
        missing = [topic for topic in topics if topic not in bag.topics]
        if missing:
            raise BagError(missing_topics(bag, missing))
        yield from bag.messages(topics)


def missing_topics(bag: Bag, missing: Collection[str]) -> str:
    """The sentence for topics that a bag lacks, or has no message of: those looked for and those there are."""
    found = ", ".join(t if bag.counts.get(t) else f"{t} (no message)" for t in sorted(bag.topics)) or "none"
    return f"{bag.path}: no topic {', '.join(missing)}; topics of the bag: {found}"
