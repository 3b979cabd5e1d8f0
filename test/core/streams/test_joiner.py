# SPDX-License-Identifier: BSD-3-Clause
"""Streams joined by stamp: what a Sample holds, whatever the order of arrival and however bad the input."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from joiner_tools import MS, NO_MOTOR, add, both, config, exact, joined, joint, motor, steady, wrench
from synthetic import LEFT, RIGHT, T0, description, loads, posture, robot, walk

from coman_reduced_model.core.base.input_warning import WarningKind
from coman_reduced_model.core.base.stream_names import JOINTS, MOTORS, REFERENCE
from coman_reduced_model.core.base.types import Flags, Foot, ImuMessage, Phase, Reference, WrenchMessage
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.gait.walk import Walk
from coman_reduced_model.core.pipeline import Pipeline
from coman_reduced_model.core.robot.robot import Robot
from coman_reduced_model.core.streams.joiner import Joiner

# --- what is joined ---


def test_equal_stamps_complete_at_once():
    joiner = Joiner(robot(), NO_MOTOR)
    for t in (0, 5, 10):
        assert [add(joiner, *message) for message in (joint(t), wrench(RIGHT, t))] == [[], []]
        (sample,) = add(joiner, *wrench(LEFT, t))
        assert sample.stamp_ns == T0 + t * MS


def test_values_between_two_messages_are_interpolated():
    messages = [wrench(LEFT, 0, 100.0), wrench(RIGHT, 0, 0.0), motor(0, 0.0), joint(3)]
    messages += [wrench(LEFT, 4, 200.0), wrench(RIGHT, 4, 40.0), motor(4, 0.04)]
    (sample,), _ = joined(messages)
    assert sample.left_wrench[2] == pytest.approx(175.0)
    assert sample.right_wrench[2] == pytest.approx(30.0)
    assert sample.motor_q == pytest.approx(np.full(12, 0.03))


def test_on_a_walk_every_value_is_that_of_its_stamp():
    samples, joiner = joined(walk(2.0, offset_s=0.0011))
    weight = robot().mass * 9.81
    assert len(samples) == 400 and not joiner.rejections.counts
    for sample in samples[1:]:
        t = (sample.stamp_ns - T0) * 1e-9
        assert sample.q == pytest.approx(posture(t), abs=1e-12)
        assert sample.motor_q == pytest.approx(posture(t) + 0.01, abs=1e-3)
        assert sample.left_wrench[2] == pytest.approx(loads(t)[0] * weight, abs=1.5)
        assert sample.right_wrench[2] == pytest.approx(loads(t)[1] * weight, abs=1.5)


def test_a_wrench_in_another_frame_of_the_foot_arrives_at_the_sole():
    text = description().replace(
        "</robot>",
        '<link name="sensor"/><joint name="s" type="fixed"><parent link="l_sole"/><child link="sensor"/>'
        '<origin xyz="0 0 0.05" rpy="3.14159265358979 0 0"/></joint></robot>',
    )
    joiner = Joiner(Robot(text, Config().robot), NO_MOTOR)
    force, torque = np.array([10.0, 2.0, -300.0]), np.array([1.0, 2.0, 3.0])
    joiner.add_wrench(Foot.LEFT, WrenchMessage(T0, "sensor", force, torque))
    add(joiner, *wrench(RIGHT, 0))
    (sample,) = add(joiner, *joint(0))
    # Turned by half a turn about x; its force at 0.05 m above the sole turns about the sole.
    assert sample.left_wrench == pytest.approx([10.0, -2.0, 300.0, 1.0 + 0.05 * 2.0, -2.0 + 0.05 * 10.0, -3.0])


def test_samples_own_their_arrays():
    """Effects correct samples in place; a value that serves two samples must not be corrected twice."""
    messages = [*both(0), joint(0), joint(20), joint(40)]
    samples, _ = joined(messages, NO_MOTOR)
    for sample in samples:
        sample.left_wrench += 1000.0
    assert [sample.left_wrench[2] for sample in samples] == [1100.0] * 3


# --- order of arrival ---


@st.composite
def arrivals(draw):
    """A walk with drops and gaps, as it was sent, and in two orders of arrival."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    messages = [item for item in walk(0.6, 100.0, 0.0013, reference=True) if rng.random() > 0.05]
    for stream in draw(st.sets(st.sampled_from([LEFT, RIGHT, MOTORS, REFERENCE]))):
        start = rng.uniform(0.0, 0.5)
        messages = [(s, m) for s, m in messages if s != stream or not start < (m.stamp_ns - T0) * 1e-9 < start + 0.15]
    wait = draw(st.sampled_from([0.02, 0.05, 0.2]))
    orders = []
    for _ in range(2):
        delays = {stream: rng.uniform(0.0, wait / 2.0) for stream in (JOINTS, MOTORS, LEFT, RIGHT, REFERENCE)}
        orders.append(sorted(messages, key=lambda item: item[1].stamp_ns + delays[item[0]] * 1e9))  # noqa: B023
    return wait, orders, draw(st.sampled_from(["motor", "topic", "none"]))


@pytest.mark.slow
@given(arrivals())
def test_samples_do_not_depend_on_the_order_of_arrival(case):
    wait, orders, source = case
    settings = config(streams__max_wait=wait, prediction__reference=source)
    needed = {"left_wrench", "right_wrench", "stamp_ns", "q", "qd", "tau"}
    needed |= {"motor": {"motor_q", "motor_qd"}, "topic": {"reference"}, "none": set()}[source]
    results = []
    for order in orders:
        samples, joiner = joined(order, settings)
        results.append([{name: exact(getattr(sample, name)) for name in sorted(needed)} for sample in samples])
        assert not joiner.rejections.counts
    assert results[0] == results[1]


# --- streams that are late, gone, or not needed ---


def test_a_wrench_that_is_gone_holds_joint_states_for_max_wait_and_no_longer():
    messages = [*both(0), joint(0), *(item for t in range(5, 300, 5) for item in (joint(t), wrench(LEFT, t)))]
    joiner = Joiner(robot(), NO_MOTOR)
    emitted = {}
    for stream, message in messages:
        for sample in add(joiner, stream, message):
            emitted[sample.stamp_ns] = (message.stamp_ns - sample.stamp_ns) / MS, sample
    delays = [delay for delay, _ in emitted.values()]
    assert max(delays) == 55.0  # the first joint state that is more than 50 ms newer
    for stamp, (_, sample) in emitted.items():
        age = (stamp - T0) / MS
        assert (sample.right_wrench is None) == (age > 50)
        assert sample.left_wrench is not None
    assert joiner.incomplete[RIGHT] == sum(sample.right_wrench is None for _, sample in emitted.values()) > 0


def test_streams_that_are_not_needed_delay_nothing():
    joiner = Joiner(robot(), NO_MOTOR)
    add(joiner, *motor(0, 0.5))
    joiner.add_imu(ImuMessage(T0, "base_link", None, np.zeros(3), np.zeros(3)))
    for message in both(10):
        add(joiner, *message)
    (sample,) = add(joiner, *joint(10))
    assert sample.motor_q == pytest.approx(np.full(12, 0.5)) and sample.imu is not None and sample.reference is None


def planned(ms, preview=10):
    """A plan on a parabola, previewed every 20 ms."""
    t = 1e-3 * (ms + 20.0 * np.arange(preview + 1))[:, None]
    com, com_vel = 0.3 * t + 0.5 * t**2 * [1, 0, 0], 0.3 + t * [1, 0, 0]
    soles = np.eye(4), np.eye(4)
    rest = com[1:], com_vel[1:]
    return REFERENCE, Reference(
        T0 + round(ms * MS), com[0], com_vel[0], np.zeros(3), np.zeros(3), *soles, Phase.DOUBLE, 0, 0.02, *rest
    )


def test_a_plan_that_comes_twice_a_second_is_used_when_it_comes():
    """Each of its messages would be a jump of its stamps, if what may be so old could not come as seldom."""
    config = Config().replaced({"prediction.reference": "topic", "streams.max_reference_age": 1.0})
    joiner = Joiner(robot(), config)
    for ms in (0.0, 500.0, 1000.0, 1500.0):
        assert joiner.streams[REFERENCE].accept(T0 + round(ms * MS), planned(ms)[1]), "usable at once"
    assert joiner.streams[REFERENCE].period_s == pytest.approx(0.5)


@pytest.mark.parametrize("late_ms", [0.0, 3.0, 20.0, 47.0])
def test_a_plan_that_is_late_is_told_for_now(late_ms):
    """Nothing waits for the plan where motor states are the reference: its own preview tells where it is by now."""
    stamp = 500.0
    samples, _ = joined([planned(stamp - late_ms), motor(stamp), joint(stamp), *both(stamp)])
    got, (_, wanted) = samples[0].reference, planned(stamp)
    assert got.stamp_ns == wanted.stamp_ns
    n = len(got.preview_com)
    assert n >= 9 - late_ms // 20.0
    for field in ("com", "com_vel"):  # linear between points 20 ms apart
        np.testing.assert_allclose(getattr(got, field), getattr(wanted, field), atol=1e-4)
        np.testing.assert_allclose(getattr(got, f"preview_{field}"), getattr(wanted, f"preview_{field}")[:n], atol=1e-4)
    samples, _ = joined([planned(stamp - late_ms, preview=0), motor(stamp), joint(stamp), *both(stamp)])
    assert samples[0].reference.stamp_ns == planned(stamp - late_ms)[1].stamp_ns  # it cannot tell


def test_a_reference_that_is_expected_and_missing_is_none_not_zero():
    samples, joiner = joined(steady(40), config(prediction__reference="topic"))
    assert len(samples) == 40 and all(sample.reference is None for sample in samples)
    assert joiner.incomplete[REFERENCE] == 40


def test_a_stream_may_begin_late():
    late = [message for message in walk(1.0) if message[0] != RIGHT or message[1].stamp_ns > T0 + 400 * MS]
    samples, _ = joined(late)
    assert len(samples) == 200
    assert all((sample.right_wrench is None) == (sample.stamp_ns < T0 + 376 * MS) for sample in samples)


def test_buffers_are_bounded():
    joiner = Joiner(robot(), NO_MOTOR)
    for t in range(30_000):
        add(joiner, *wrench(LEFT, t))  # no joint states at all
    assert len(joiner.streams[LEFT].items) < 10_000
    for t in range(30_000):
        add(joiner, *joint(t / 1e5))  # 100 kHz, and nothing to join
    assert joiner.waiting < 10_000


def test_clocks_that_differ_are_told():
    for offset_ms, side in ((-3_600_000, "3600.0.. s behind"), (3_600_000, "3600.0.. s ahead of")):
        pipeline = Pipeline(robot(), NO_MOTOR)
        for t in range(0, 500, 5):
            pipeline.on_joint(joint(t)[1])
            for stream, message in both(t + offset_ms):
                pipeline.on_wrench(Foot.LEFT if stream == LEFT else Foot.RIGHT, message)
        flags = [prediction.flags for prediction in pipeline.flush()]
        assert all(Flags.STALE_WRENCH in each for each in flags)
        status = pipeline.status()
        assert status.samples == 100 and status.streams[LEFT].incomplete == 100
        found = [each for each in status.warnings if each.stream in (LEFT, RIGHT)]
        assert all(each.kind is WarningKind.CLOCK for each in found)
        told = [each.text for each in found]
        assert len(told) == 2 and all(pytest.approx(3600.0, abs=0.1) == float(line.split()[4]) for line in told)
        assert all(side.split()[-1] in line for line in told)


@pytest.mark.parametrize(("early_s", "warned"), [(0.3, False), (3600.0, True), (-0.3, True)])
def test_a_plan_may_come_early_and_not_late(early_s, warned):
    pipeline = Pipeline(robot(), NO_MOTOR.replaced({"prediction.reference": "topic"}))
    walk = Walk(pipeline.config)
    for t in range(0, 500, 5):
        pipeline.on_joint(joint(t)[1])
        for stream, message in both(t):
            pipeline.on_wrench(Foot.LEFT if stream == LEFT else Foot.RIGHT, message)
        pipeline.on_reference(walk.reference(joint(t)[1].stamp_ns + round(1e9 * early_s)))
    found = [each for each in pipeline.status().warnings if each.stream == REFERENCE]
    assert [each.kind for each in found] == [WarningKind.CLOCK] * warned


def test_a_stream_that_stopped_is_told_apart_from_a_clock_that_differs():
    pipeline = Pipeline(robot(), NO_MOTOR)
    for stream, message in [*steady(20), *(joint(t) for t in range(100, 1500, 5))]:
        if stream == JOINTS:
            pipeline.on_joint(message)
        else:
            pipeline.on_wrench(Foot.LEFT if stream == LEFT else Foot.RIGHT, message)
    warnings = pipeline.status().warnings
    (left,) = (each for each in warnings if each.stream == LEFT)
    assert left.kind is WarningKind.STOPPED and "no message for the last 1.4" in left.text


def delayed(messages, streams, by):
    """In the order of arrival where some streams come so many milliseconds later than their stamps say."""
    arrival = [message.stamp_ns + (by * MS if stream in streams else 0) for stream, message in messages]
    return [messages[i] for i in np.argsort(arrival, kind="stable")]


@pytest.mark.parametrize(("by", "late"), [(0.0, False), (40.0, False), (90.0, True), (2000.0, True)])
def test_messages_too_late_for_their_samples_are_counted(by, late):
    """A joint state waits 50 ms; without, or with an older value, its sample goes, and the message is late."""
    _, joiner = joined(delayed(steady(800), {LEFT}, by))
    assert joiner.streams[LEFT].accepted == 800 and joiner.streams[RIGHT].overdue == 0
    overdue = joiner.streams[LEFT].overdue
    assert 780 - by / 5 <= overdue <= 800 if late else overdue == 0


@pytest.mark.parametrize("jump_ms", [10_000.0, -10_000.0])
def test_nothing_is_late_where_all_clocks_jump(jump_ms):
    first = steady(400, start_ms=20_000.0)
    second = steady(400, start_ms=22_000.0 + jump_ms)
    feet_first = sorted(second, key=lambda each: (each[1].stamp_ns, each[0] == JOINTS))
    for messages in (second, feet_first):
        _, joiner = joined([*first, *messages])
        assert [stream.overdue for stream in joiner.streams.values()] == [0] * len(joiner.streams)
