# SPDX-License-Identifier: BSD-3-Clause
"""A bag, open together with its robot, its input streams and the pipeline that predicts it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

from ..core.base.stream_names import JOINTS
from ..core.base.types import Prediction, Sample
from ..core.config.schema import Config
from ..core.pipeline import Pipeline
from ..core.robot.robot import Robot
from ..core.streams.blocks import Irregular
from ..core.streams.expected import expected_streams, why_expected
from ..errors import BagError, ConfigError
from ..messages import INPUT_TYPES, STRING
from ..progress import Progress
from ..topics import DESCRIPTION, INPUT_TOPICS, TopicNames
from .blocks import RawBlock
from .decode import decoder
from .decode_blocks import decode_block
from .reader import Bag, missing_topics

_PIECE = 2048  # messages joined before their samples are predicted: switching for each would cost a fifth of the time


class Session:
    """One recording and all that is needed to predict it. Use it in a `with` statement, or call `close`.

    Messages are read as they are asked for; the bag is never loaded whole. A session is for one pass: `batches`,
    `samples` and `predictions` all go through the same pipeline, which keeps its state.

    Attributes:
        bag: what is read.
        config: robot, streams and model.
        names: of the topics.
        streams: input stream by topic, for the topics that the bag has.
        robot: from `urdf`, from the configuration, or as the bag describes it.

    Example:
        >>> from coman_reduced_model import Session, bag_path
        >>> with Session(bag_path("test1")) as session:
        ...     print(f"{session.robot.mass:.1f} kg, {session.bag.duration_s:.1f} s")
        ...     first = next(session.predictions())
        17.3 kg, 12.0 s
    """

    def __init__(
        self,
        path: str | Path,
        config: Config | None = None,
        *,
        urdf: str | Path | None = None,
        names: TopicNames | None = None,
    ) -> None:
        """Open a bag.

        Args:
            path: folder of a rosbag2 recording, or one of its files.
            config: default: the nominal robot and model.
            urdf: file of the robot, instead of the one that configuration or bag name.
            names: namespace and remappings of the topics.

        Raises:
            BagError: the bag cannot be read, lacks a topic that is needed, or describes no robot.
            ConfigError, RobotError: the configuration or the URDF cannot be used.
        """
        self.config = (config or Config()).with_urdf(urdf)
        self.names = names or TopicNames()
        self.bag = Bag(path)
        try:
            self.streams = input_streams(self.bag, self.config, self.names)
            self.robot = find_robot(self.config, self.bag, self.names, urdf)
        except BaseException:
            self.close()
            raise

    @cached_property
    def pipeline(self) -> Pipeline:
        """Joins the messages and predicts the samples; its counters and warnings grow as the bag is read.

        Raises:
            ConfigError: an effect of the configuration does not fit the robot.
        """
        return Pipeline(self.robot, self.config)

    @cached_property
    def decoders(self) -> dict[str, Callable[[bytes], Any]]:
        """By stream, what makes a message of its bytes."""
        return {stream: decoder(stream, self.bag.typestore) for stream in self.streams.values()}

    @property
    def warnings(self) -> tuple[str, ...]:
        """What could not be read and what looks wrong so far, a line each."""
        return (*self.bag.warnings, *map(str, self.pipeline.status().warnings))

    def messages(self) -> Iterator[tuple[str, int, bytes]]:
        """Stream, log time [ns] and serialised message of the input topics, one after the other."""
        streams = self.streams
        for topic, log_time, raw in self.bag.raw(streams):
            yield streams[topic], log_time, raw

    def batches(self, progress: Progress | None = None) -> Iterator[list[Sample]]:
        """The samples of the bag in order, some hundred at a time; no effect has corrected them."""
        span, count = max(self.bag.end_ns - self.bag.start_ns, 1), 0
        for block in self.bag.blocks(self.streams):
            for piece in block.pieces(_PIECE):
                samples = self._joined(piece)
                count += len(samples)
                yield samples
                if progress is not None:
                    progress((int(piece.log_time[-1]) - self.bag.start_ns) / span, f"{count} samples")
        samples = self.pipeline.joiner.flush()  # what still waits for other streams goes without them
        yield samples
        if progress is not None:
            progress(1.0, f"{count + len(samples)} samples")

    def _joined(self, block: RawBlock) -> list[Sample]:
        """The samples that a block completes."""
        streams, take, decoders = self.streams, self.pipeline.take, self.decoders
        try:
            return self.pipeline.joiner.add_block(decode_block(block, streams, self.bag.typestore))
        except Irregular:  # it needs a look at each message
            items = ((streams[topic], raw) for topic, _, raw in block)
            return [sample for stream, raw in items for sample in take(stream, raw, decoders[stream])]

    def samples(self, progress: Progress | None = None) -> Iterator[Sample]:
        """The samples of the bag, for a `Predictor` of one's own."""
        for batch in self.batches(progress):
            yield from batch

    def predictions(self, progress: Progress | None = None) -> Iterator[Prediction]:
        """The predictions of the pipeline, one a sample."""
        for batch in self.batches(progress):
            yield from self.pipeline.predict(batch)

    def predicted(self, progress: Progress | None = None) -> Iterator[tuple[Sample, Prediction]]:
        """The samples, as effects have corrected them, with their predictions."""
        for batch in self.batches(progress):
            yield from zip(batch, self.pipeline.predict(batch), strict=True)

    def close(self) -> None:
        """Close the bag."""
        self.bag.close()

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def read_urdf(path: str | Path) -> str:
    """The text of a URDF file.

    Raises:
        ConfigError: it cannot be read.
    """
    try:
        return Path(path).read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: the URDF cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: is not a text file") from None


def find_robot(config: Config, bag: Bag, names: TopicNames, urdf: str | Path | None = None) -> Robot:
    """The robot: of the file `urdf`, else of the configuration (robot.urdf), else as the bag describes it.

    Raises:
        ConfigError, BagError, RobotError: there is none, or it cannot be used.
    """
    urdf = urdf or config.urdf
    if urdf is not None:
        return Robot(read_urdf(urdf), config.robot, str(urdf))
    text, source = described_urdf(bag, names)
    return Robot(text, config.robot, source)


def described_urdf(bag: Bag, names: TopicNames) -> tuple[str, str]:
    """The URDF that a bag holds, and its topic in words.

    Raises:
        BagError: there is none.
    """
    topic = names(DESCRIPTION)
    if topic not in bag.topics:
        raise BagError(f"{missing_topics(bag, [topic])}; name a URDF with --urdf or robot.urdf")
    if bag.topics[topic] != STRING:
        raise BagError(f"{bag.path}: {topic}: of type {bag.topics[topic]}, wanted {STRING}")
    message = bag.first(topic)
    if message is None:
        raise BagError(f"{bag.path}: {topic}: no message; name a URDF with --urdf or robot.urdf")
    return message.data, f"{bag.path}: {topic}"


def input_streams(bag: Bag, config: Config, names: TopicNames) -> dict[str, str]:
    """Stream by topic, for the topics of the bag that the predictor takes.

    Raises:
        BagError: one that is needed is missing, or has another type.
        ConfigError: two streams have one topic.
    """
    needed = [JOINTS, *expected_streams(config)]
    topics: dict[str, str] = {}
    for stream, topic in INPUT_TOPICS.items():
        twin = topics.setdefault(names(topic), stream)
        if twin != stream:
            raise ConfigError(f"--remap: {INPUT_TOPICS[twin]} and {topic} would both be {names(topic)}")
    missing = [topic for topic, stream in topics.items() if stream in needed and not bag.counts.get(topic)]
    if missing:
        why = dict.fromkeys(why_expected(topics[topic], config) for topic in missing)
        hints = "; ".join(each for each in why if each)
        raise BagError(missing_topics(bag, missing) + (f" ({hints})" if hints else ""))
    for topic, stream in list(topics.items()):
        if topic in bag.topics and bag.topics[topic] != INPUT_TYPES[stream]:
            problem = f"{bag.path}: {topic}: of type {bag.topics[topic]}, wanted {INPUT_TYPES[stream]}"
            if stream in needed:
                raise BagError(problem)
            bag.warnings.append(f"{problem}; left out")
            del topics[topic]
    if config.streams.wrench_source == "torques":
        _refuse_without_torques(bag, next(topic for topic, stream in topics.items() if stream == JOINTS))
    return {topic: stream for topic, stream in topics.items() if topic in bag.topics}


def _refuse_without_torques(bag: Bag, topic: str) -> None:
    message = bag.first(topic)
    if message is None or not len(message.effort):
        raise BagError(
            f"{bag.path}: {topic}: gives no torques (effort), which streams.wrench_source: torques needs; "
            "`contacts` and `sensors` do without"
        )
