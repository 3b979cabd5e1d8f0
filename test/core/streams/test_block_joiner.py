# SPDX-License-Identifier: BSD-3-Clause
"""Whole blocks of messages are joined to the last bit as the same messages one after the other."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from joiner_tools import MS, config, exact
from mutations import Mutation, clock_mutations, spoil, value_mutations
from synthetic import LEFT, RIGHT, T0, robot, robot_with_arm, walk

from coman_reduced_model.bag.blocks import block_of
from coman_reduced_model.bag.decode import decoder
from coman_reduced_model.bag.decode_blocks import decode_block
from coman_reduced_model.bag.types import bag_types, typestore
from coman_reduced_model.core.base.stream_names import CONTACTS, IMU, JOINTS, MOTORS, REFERENCE
from coman_reduced_model.core.base.types import ContactMessage, ImuMessage
from coman_reduced_model.core.pipeline import Pipeline
from coman_reduced_model.core.streams.blocks import Irregular
from coman_reduced_model.messages import INPUT_TYPES, contacts_to, imu_to, joint_to, reference_to, wrench_to

STREAMS = {stream: stream for stream in INPUT_TYPES}  # topics that are called as their streams
TO = {
    JOINTS: joint_to, MOTORS: joint_to, LEFT: wrench_to, RIGHT: wrench_to, REFERENCE: reference_to, IMU: imu_to,
    CONTACTS: contacts_to,
}  # fmt: skip


def serialised(messages):
    """As they are in a bag."""
    types, store = bag_types(), typestore()
    return [
        (stream, 0, bytes(store.serialize_cdr(TO[stream](types, message), INPUT_TYPES[stream])))
        for stream, message in messages
    ]


def one_by_one(pipeline, raws, decoders):
    return [sample for stream, _, raw in raws for sample in pipeline.take(stream, raw, decoders[stream])]


def state(pipeline):
    """What a joiner knows, as far as anybody sees it."""
    joiner = pipeline.joiner
    streams = {
        name: (s.last, s.received, s.accepted, s.overdue, repr(s.period_s)) for name, s in joiner.streams.items()
    }
    return streams, joiner.rejections.counts, joiner.incomplete, joiner.clock_lead_s, joiner.waiting


def compare(raws, config_, cuts, robot_=None):
    """Samples and state of both ways; how many blocks were taken as such."""
    single, blocks = (Pipeline(robot_ or robot(), config_) for _ in range(2))
    decoders = [{stream: decoder(stream) for stream in STREAMS} for _ in range(2)]
    taken = 0
    edges = [0, *sorted(cuts), len(raws)]
    for first, last in zip(edges, edges[1:], strict=False):
        piece = raws[first:last]
        if not piece:
            continue
        wanted = one_by_one(single, piece, decoders[0])
        try:
            got = blocks.joiner.add_block(decode_block(block_of(piece), STREAMS, typestore()))
            taken += 1
        except Irregular:
            got = one_by_one(blocks, piece, decoders[1])
        assert [exact(sample) for sample in got] == [exact(sample) for sample in wanted]
        assert state(blocks) == state(single)
        for sample in got:  # effects correct samples in place: nothing that is held may change with them
            for values in (sample.q, sample.qd, sample.motor_q, sample.left_wrench, sample.tau):
                if values is not None:
                    values += 1.0
    assert [exact(sample) for sample in blocks.joiner.flush()] == [exact(sample) for sample in single.joiner.flush()]
    assert state(blocks) == state(single)
    return taken


def with_imu(messages):
    """And an IMU at a third of the rate, of which some messages know no orientation."""
    for k, (stream, message) in enumerate(messages):
        yield stream, message
        if stream == JOINTS and k % 3 == 0:
            orientation = None if k % 2 else np.array([0.0, 0.0, 0.0, 1.0])
            yield IMU, ImuMessage(message.stamp_ns + 3 * MS, "imu", orientation, np.full(3, 0.1 * k % 1), np.ones(3))


@st.composite
def recordings(draw):
    """A walk as it arrives: clocks apart, messages dropped, streams late, some of them gone or without velocities."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    messages = walk(0.5, 100.0, draw(st.sampled_from([0.0, 0.0013])), reference=True)
    messages = [item for item in with_imu(messages) if rng.random() > draw(st.sampled_from([0.0, 0.05, 0.5]))]
    for stream in draw(st.sets(st.sampled_from([LEFT, RIGHT, MOTORS, REFERENCE, IMU]), max_size=2)):
        start, length = rng.uniform(-0.2, 0.4), draw(st.sampled_from([0.1, 1.0]))
        messages = [(s, m) for s, m in messages if s != stream or not start < (m.stamp_ns - T0) * 1e-9 < start + length]
    for stream in draw(st.sets(st.sampled_from([JOINTS, MOTORS]), max_size=1)):
        for name, message in messages:
            if name == stream:
                message.velocity = None
    late = {stream: rng.uniform(0.0, draw(st.sampled_from([0.0, 0.01, 0.1]))) for stream in TO}
    messages.sort(key=lambda item: item[1].stamp_ns + late[item[0]] * 1e9)
    return messages


@pytest.mark.slow
@settings(max_examples=60)
@given(
    recordings(),
    st.lists(st.one_of(clock_mutations, value_mutations), max_size=2),
    st.sampled_from(["motor", "topic", "none"]),
    st.lists(st.integers(0, 300), max_size=4),
)
def test_blocks_are_joined_as_their_messages_are(messages, mutations, source, cuts):
    settings_ = config(prediction__reference=source, streams__max_wait=0.02)
    raws = serialised(spoil(messages, mutations))
    compare(raws, settings_, [min(cut, len(raws)) for cut in cuts])


@pytest.mark.parametrize("arm", [False, True])
def test_a_plain_recording_is_taken_in_blocks(arm):
    raws = serialised(with_imu(walk(1.0, 200.0, reference=True)))
    cuts = range(0, len(raws), 100)
    assert compare(raws, config(), cuts, robot_with_arm() if arm else None) == len(cuts)


def test_a_known_delay_is_taken_off_in_blocks_too():
    delays = {"effects.wrench_delay.delay": [0.012], "effects.encoder_delay.delay": [0.004]}
    changed = config().replaced({"effects.active": ["wrench_delay", "encoder_delay"], **delays})
    assert compare(serialised(walk(0.5, 200.0, reference=True)), changed, [300]) == 2


@example(Mutation("value", frozenset([LEFT]), 0.5, 0.0, (0, float("nan"), False)))
@example(Mutation("twice", frozenset([MOTORS]), 0.5, 0.0))
@given(st.one_of(clock_mutations, value_mutations))
@settings(max_examples=10)
def test_one_bad_message_is_counted_as_without_blocks(mutation):
    compare(serialised(spoil(walk(0.3, 100.0, reference=True), [mutation])), config(), [60])


def test_without_foot_sensors_blocks_hold_no_wrenches_and_contacts_are_taken_one_by_one():
    messages = walk(0.5, 200.0, reference=True)
    raws = serialised(messages)
    assert compare(raws, config(streams__wrench_source="torques"), [300]) == 2
    with_contacts = serialised(
        each for s, m in messages for each in ((s, m), (CONTACTS, ContactMessage(m.stamp_ns, True, False))) if s != LEFT
    )
    assert compare(with_contacts, config(streams__wrench_source="contacts"), [300]) == 0
