# SPDX-License-Identifier: BSD-3-Clause
"""Bags of any kind give the same messages; bags that are broken give what is whole, and say what is not."""

from __future__ import annotations

import json
import shutil
import sqlite3
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import IndexType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from synthetic import T0, description, walk, write_bag

from coman_reduced_model.bag.reader import Bag, open_bag
from coman_reduced_model.bag.truncated import TruncatedMcap
from coman_reduced_model.bag.types import typestore
from coman_reduced_model.bag.writer import BagWriter
from coman_reduced_model.errors import BagError, OutputError
from coman_reduced_model.messages import OWN

TOPICS = ("/robot_description", "/joint_states", "/motor_states", "/left_foot/wrench", "/right_foot/wrench")


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return write_bag(tmp_path_factory.mktemp("bags") / "walk", walk(1.0), skip=["com/reference"])


class Messages(list):
    """With a text of its own: pytest and hypothesis would print a megabyte."""

    def __repr__(self):
        return f"<{len(self)} messages>"


@pytest.fixture(scope="module")
def whole(bag):
    return read(bag)


def mcap_of(bag: Path) -> Path:
    return next(bag.glob("*.mcap"))


def read(path: Path, warned: bool = False):
    """All messages of a bag, serialised; it must say nothing unless `warned`."""
    with Bag(path) as opened:
        messages = Messages(opened.raw(TOPICS))
        assert bool(opened.warnings) == warned, opened.warnings
        assert len(messages) == opened.message_count
    return messages


def written(path: Path, messages, plugin=StoragePlugin.MCAP, mode=CompressionMode.NONE) -> Path:
    """The same messages in a bag of another kind."""
    store = typestore()
    kinds = {"/robot_description": "std_msgs/msg/String"}
    kinds |= dict.fromkeys(TOPICS[1:3], "sensor_msgs/msg/JointState")
    kinds |= dict.fromkeys(TOPICS[3:], "geometry_msgs/msg/WrenchStamped")
    writer = Writer(path, version=9, storage_plugin=plugin)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connections = {topic: writer.add_connection(topic, kind, typestore=store) for topic, kind in kinds.items()}
        for topic, log_time, raw in messages:
            writer.write(connections[topic], log_time, raw)
    return path


# --- whole bags ---


def test_what_was_written_is_read(bag, whole):
    assert len(whole) == 801
    with Bag(bag) as opened:
        assert opened.topics["/joint_states"] == "sensor_msgs/msg/JointState"
        assert opened.counts["/joint_states"] == 200 and opened.duration_s == pytest.approx(800 * 200e-6)
        assert opened.first("/robot_description").data == description()
        topic, log_time, message = next(opened.messages(["/joint_states"]))
        assert (topic, log_time) == ("/joint_states", T0 + 200_000)
        sent = walk(1.0)[0][1]
        assert message.position.tolist() == sent.position.tolist() and tuple(message.name) == sent.names


@pytest.mark.parametrize("plugin", list(StoragePlugin))
@pytest.mark.parametrize(
    "mode", [CompressionMode.NONE, CompressionMode.STORAGE, CompressionMode.FILE, CompressionMode.MESSAGE]
)
def test_storage_and_compression_do_not_matter(tmp_path, whole, plugin, mode):
    if plugin == StoragePlugin.SQLITE3 and mode == CompressionMode.STORAGE:
        mode = CompressionMode.NONE
    assert read(written(tmp_path / "bag", whole, plugin, mode)) == whole


def test_the_file_alone_will_do_and_so_will_a_folder_without_metadata(tmp_path, bag, whole):
    assert read(mcap_of(bag)) == whole
    shutil.copy(mcap_of(bag), tmp_path / "a.mcap")
    assert read(tmp_path, warned=True) == whole
    shutil.copy(mcap_of(bag), tmp_path / "renamed.bag")
    assert read(tmp_path / "renamed.bag") == whole
    assert read(bag / "metadata.yaml") == whole


def test_messages_that_are_compressed_one_by_one_are_read_from_the_file_alone(tmp_path, whole):
    packed = written(tmp_path / "bag", whole, mode=CompressionMode.MESSAGE)
    assert read(mcap_of(packed)) == whole


@pytest.mark.parametrize("options", [{"use_chunking": False}, {"index_types": IndexType.CHUNK, "chunk_size": 20000}])
def test_files_without_chunks_or_an_index_of_messages_are_read(tmp_path, bag, whole, options):
    """Of two messages the later one lies first, as when a recorder has several threads."""
    path = tmp_path / "other.mcap"
    with mcap_of(bag).open("rb") as source, path.open("wb") as target:
        summary = make_reader(source).get_summary()
        writer = McapWriter(target, **options)
        writer.start(profile="ros2", library="")
        channels = {}
        for channel in summary.channels.values():
            schema = summary.schemas[channel.schema_id]
            number = writer.register_schema(schema.name, schema.encoding, schema.data)
            channels[channel.topic] = writer.register_channel(channel.topic, channel.message_encoding, number)
        swapped = [*whole[:400], whole[401], whole[400], *whole[402:]]
        for topic, log_time, raw in swapped:
            writer.add_message(channels[topic], log_time, raw, log_time)
        writer.finish()
    found = read(path)
    assert sorted(found) == sorted(whole) and len(found) == len(whole)


def test_compressed_files(tmp_path, bag, whole):
    packed = tmp_path / "walk.mcap.zstd"
    packed.write_bytes(zstandard.compress(mcap_of(bag).read_bytes()))
    assert read(packed) == whole


def test_a_compressed_file_that_was_cut(tmp_path):
    raw = mcap_of(write_bag(tmp_path / "long", walk(1.0) * 10)).read_bytes()
    packed = zstandard.compress(raw)
    path = tmp_path / "cut.mcap.zstd"
    path.write_bytes(packed[: len(packed) * 9 // 10])
    with Bag(path) as opened:
        assert 4000 < sum(1 for _ in opened.raw(TOPICS)) < 8001
        assert all(str(path) in line for line in opened.warnings)
    path.write_bytes(packed[:1000])
    with pytest.raises(BagError, match=f"{path.name}: cannot be decompressed"):
        Bag(path)


@pytest.mark.parametrize("content", [b"", bytes(1000)])
def test_the_last_file_of_a_split_bag_that_holds_nothing_is_left_out(tmp_path, whole, content):
    shutil.copy(mcap_of(written(tmp_path / "whole", whole)), tmp_path / "a_0.mcap")
    shutil.rmtree(tmp_path / "whole")
    (tmp_path / "a_1.mcap").write_bytes(content)
    assert read(tmp_path, warned=True) == whole
    (tmp_path / "a_0.mcap").write_bytes(b"")
    with pytest.raises(BagError, match=r"a_0\.mcap: neither"):
        Bag(tmp_path)


def test_a_bag_split_over_several_files(tmp_path, whole):
    third = len(whole) // 3
    for name, part in (("b", whole[:third]), ("c", whole[third : 2 * third]), ("a", whole[2 * third :])):
        shutil.copy(mcap_of(written(tmp_path / f"x{name}", part)), tmp_path / f"{name}.mcap")
        shutil.rmtree(tmp_path / f"x{name}")
    assert read(tmp_path, warned=True) == whole


def test_files_that_were_recorded_side_by_side_are_merged_by_time(tmp_path, whole):
    for name, topics in (("a", TOPICS[:2]), ("b", TOPICS[2:])):
        written(tmp_path / f"x{name}", [item for item in whole if item[0] in topics])
        shutil.copy(mcap_of(tmp_path / f"x{name}"), tmp_path / f"{name}.mcap")
        shutil.rmtree(tmp_path / f"x{name}")
    assert read(tmp_path, warned=True) == whole


@given(st.lists(st.integers(0, 40), min_size=1, max_size=60), st.sampled_from([1, 200, 10**6]))
def test_chunks_that_overlap_are_read_in_the_order_of_the_log_times(tmp_path_factory, times, chunk_size):
    path = tmp_path_factory.mktemp("chunks") / "bag.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file, chunk_size=chunk_size)
        writer.start("ros2", "test")
        schema = writer.register_schema("std_msgs/msg/Empty", "ros2msg", b"")
        topics = [writer.register_channel(name, "cdr", schema) for name in ("/a", "/b")]
        for i, time in enumerate(times):
            writer.add_message(topics[i % 2], T0 + time, bytes([i]), T0 + time)
        writer.finish()
    messages = [(("/a", "/b")[i % 2], T0 + time, bytes([i])) for i, time in enumerate(times)]
    with Bag(path) as opened:
        for topics in (["/a", "/b"], ["/a"]):
            found = list(opened.raw(topics))
            assert sorted(found) == sorted(item for item in messages if item[0] in topics)
            assert [time for _, time, _ in found] == sorted(time for _, time, _ in found)


@pytest.mark.parametrize("lost", [0, 10])
def test_a_log_time_that_no_clock_has_loses_nothing(tmp_path, lost):
    """Of a damaged message; with and without the index at the end of the file."""
    path = tmp_path / "bag.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start("ros2", "test")
        schema = writer.register_schema("std_msgs/msg/Empty", "ros2msg", b"")
        topic = writer.register_channel("/a", "cdr", schema)
        for i, time in enumerate((T0, 2**64 - 1, T0 + 1)):
            writer.add_message(topic, time, bytes([i]), time)
        writer.finish()
    path.write_bytes(path.read_bytes()[: -lost or None])
    with Bag(path) as opened:
        found = [raw for block in opened.blocks(["/a"]) for _, _, raw in block]
    assert sorted(found) == [bytes([i]) for i in range(3)]


def test_metadata_that_is_wrong_does_not_keep_a_good_file_from_being_read(tmp_path, bag, whole):
    for text in ("", "a: [", "rosbag2_bagfile_information: {version: 99}", "\0"):
        folder = tmp_path / "bag"
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(bag, folder)
        (folder / "metadata.yaml").write_text(text)
        assert read(folder, warned=True) == whole


def test_messages_of_chosen_topics(bag):
    seen = [topic for topic, _, _ in open_bag(bag, ["/left_foot/wrench"])]
    assert seen == ["/left_foot/wrench"] * 200
    with pytest.raises(BagError, match=r"no topic /nope; topics of the bag: .*/joint_states"):
        next(open_bag(bag, ["/nope"]))


def test_reading_takes_no_memory_that_grows_with_the_bag(tmp_path):
    long = write_bag(tmp_path / "long", walk(1.0) * 60)
    with Bag(long) as opened:
        tracemalloc.start()
        size = sum(len(raw) for _, _, raw in opened.raw(TOPICS))
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
    assert peak < size / 2, (peak, size)


# --- broken bags ---


@settings(max_examples=40)
@given(data=st.data())
def test_a_bag_cut_at_any_byte_gives_the_messages_before(tmp_path_factory, bag, whole, data):
    raw = mcap_of(bag).read_bytes()
    cut = data.draw(st.integers(0, len(raw) - 1))
    path = tmp_path_factory.mktemp("cut") / "cut.mcap"
    path.write_bytes(raw[:cut])
    try:
        with Bag(path) as opened:
            messages = Messages(opened.raw(TOPICS))
            (warning,) = opened.warnings
    except BagError as error:
        assert str(path) in str(error) and "\n" not in str(error)
        assert cut < len(raw) // 2
        return
    assert messages == Messages(whole[: len(messages)])
    assert f"of {cut}" in warning and f"{len(messages)} messages" in warning


def test_a_cut_chunk_gives_the_whole_messages_in_it(tmp_path, bag, whole):
    """A bag has a few large chunks: losing the last would lose many seconds."""
    raw = mcap_of(bag).read_bytes()
    path = tmp_path / "cut.mcap"
    path.write_bytes(raw[: len(raw) * 8 // 10])
    assert len(read(path, warned=True)) > len(whole) // 2


@settings(max_examples=40)
@given(data=st.data())
def test_damaged_bytes_never_break_the_reader(tmp_path_factory, bag, whole, data):
    raw = bytearray(mcap_of(bag).read_bytes())
    for _ in range(data.draw(st.integers(1, 5))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.mktemp("damaged") / "damaged.mcap"
    path.write_bytes(raw)
    try:
        with Bag(path) as opened:
            assert sum(1 for _ in opened.raw(opened.topics)) <= 2 * len(whole)
    except BagError as error:
        assert "\n" not in str(error)
    assert TruncatedMcap(path).usable_bytes <= len(raw)


def test_channels_of_others_are_no_damage(tmp_path, bag, whole):
    """Their schemas are no text, or there is none: as Foxglove and other recorders write them beside ROS."""
    path = tmp_path / "mixed.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start()
        protobuf = writer.register_schema("foxglove.Log", "protobuf", b"\xff\xfe\x00")
        channels = [writer.register_channel("/log", "protobuf", protobuf), writer.register_channel("/json", "json", 0)]
        text = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channels.append(writer.register_channel("/text", "cdr", text))
        for k in range(30):
            for channel in channels:
                writer.add_message(channel, k, b"\x00\x01\x00\x00\x02\x00\x00\x00a\x00", k)
        writer.finish()
    path.write_bytes(path.read_bytes()[:-40])  # the end of the index
    assert TruncatedMcap(path).counts == {"/text": 30}
    with Bag(path) as opened:
        assert [message.data for _, _, message in opened.messages(["/text"])] == 30 * ["a"]


def test_what_is_no_bag_is_refused_in_one_line(tmp_path, bag):
    (tmp_path / "empty.mcap").touch()
    (tmp_path / "text.mcap").write_text("hello, this is no bag")
    (tmp_path / "ros1.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(100))
    (tmp_path / "folder").mkdir()
    broken = tmp_path / "broken.db3"
    sqlite3.connect(broken).execute("create table t (a int)").connection.close()
    with BagWriter(tmp_path / "none", {"/joint_states": "sensor_msgs/msg/JointState"}):
        pass
    for name, words in {
        "nowhere": "no such file",
        "empty.mcap": "empty",
        "text.mcap": "neither an MCAP nor an SQLite bag",
        "ros1.bag": "rosbags-convert",
        "folder": "no metadata.yaml",
        "broken.db3": "no such table|not",
        "none": "the bag has no messages",
    }.items():
        with pytest.raises(BagError, match=words) as caught:
            Bag(tmp_path / name)
        assert str(tmp_path) in str(caught.value) and "\n" not in str(caught.value)


def test_a_topic_with_two_types_is_refused(tmp_path, bag):
    with BagWriter(tmp_path / "x", {"/joint_states": "std_msgs/msg/String"}) as writer:
        writer.write_raw("/joint_states", T0, b"\0\1\0\0\1\0\0\0\0")
    (tmp_path / "two").mkdir()
    shutil.copy(mcap_of(tmp_path / "x"), tmp_path / "two" / "a.mcap")
    shutil.copy(mcap_of(bag), tmp_path / "two" / "b.mcap")
    with pytest.raises(BagError, match="/joint_states: of type"):
        Bag(tmp_path / "two")


# --- writing ---


def test_an_existing_bag_is_not_overwritten(bag):
    with pytest.raises(OutputError, match="exists"):
        BagWriter(bag, {})


def test_bags_carry_the_hashes_of_the_built_messages():
    """ROS refuses to connect or play what has another hash; rosidl and rosbags work it out independently."""
    import coman_reduced_model_msgs

    prefix = Path(coman_reduced_model_msgs.__file__).parents[4]
    found = list((prefix / "share" / OWN / "msg").glob("*.json"))
    assert {path.stem for path in found} >= {"ComPrediction", "ComReference", "SupportState", "HorizonPrediction"}
    for path in found:
        hashes = {each["type_name"]: each["hash_string"] for each in json.loads(path.read_text())["type_hashes"]}
        assert typestore().hash_rihs01(f"{OWN}/msg/{path.stem}") == hashes[f"{OWN}/msg/{path.stem}"]


def test_latched_topics_are_offered_transient_local(bag):
    from rosbags.interfaces import QosDurability
    from rosbags.rosbag2 import Reader

    with Reader(bag) as reader:
        durability = {each.topic: each.ext.offered_qos_profiles[0].durability for each in reader.connections}
    assert durability.pop("/robot_description") == QosDurability.TRANSIENT_LOCAL
    assert set(durability.values()) == {QosDurability.VOLATILE}


def test_log_times_are_kept(bag, whole):
    assert np.all(np.diff([log_time for _, log_time, _ in whole]) >= 0)
