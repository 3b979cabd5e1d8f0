# SPDX-License-Identifier: BSD-3-Clause
"""Streams joined by stamp: what a Sample holds, whatever the order of arrival and however bad the input."""

from __future__ import annotations

import math
from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mutations import clock_mutations, spoil
from synthetic import LEFT, RIGHT, T0, description, loads, names, posture, robot, robot_with_arm, walk

from coman_reduced_model.core.base.input_warning import WarningKind
from coman_reduced_model.core.base.stream_names import JOINTS, MOTORS, REFERENCE
from coman_reduced_model.core.base.types import Flags, Foot, ImuMessage, JointMessage, Phase, Reference, WrenchMessage
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.pipeline import Pipeline
from coman_reduced_model.core.robot.robot import Robot
from coman_reduced_model.core.streams.joiner import Joiner

MS = 1_000_000


def config(**changes):
    return Config().replaced({key.replace("__", "."): value for key, value in changes.items()})


NO_MOTOR = config(prediction__reference="none")


def add(joiner, stream, message):
    if stream in (LEFT, RIGHT):
        return joiner.add_wrench(Foot.LEFT if stream == LEFT else Foot.RIGHT, message)
    return {JOINTS: joiner.add_joint, MOTORS: joiner.add_motor, REFERENCE: joiner.add_reference}[stream](message)


def joined(messages, settings=None, flush=True):
    """Samples of messages in this order of arrival, and the joiner."""
    joiner = Joiner(robot(), settings or config())
    samples = [sample for stream, message in messages for sample in add(joiner, stream, message)]
    return (samples + joiner.flush() if flush else samples), joiner


def joint(ms, q=0.0, **changes):
    position = np.full(12, q) if np.isscalar(q) else q
    return JOINTS, replace(JointMessage(T0 + round(ms * MS), names(), position, np.zeros(12), None), **changes)


def motor(ms, q=0.0, **changes):
    return MOTORS, joint(ms, q, **changes)[1]


def wrench(stream, ms, fz=100.0, frame=None):
    frame = ("l_sole" if stream == LEFT else "r_sole") if frame is None else frame
    return stream, WrenchMessage(T0 + round(ms * MS), frame, np.array([0.0, 0.0, fz]), np.zeros(3))


def both(ms, fz=100.0):
    return [wrench(LEFT, ms, fz), wrench(RIGHT, ms, fz)]


def steady(count, period_ms=5.0, start_ms=0.0):
    """Joint states and wrenches with equal stamps."""
    times = [start_ms + k * period_ms for k in range(count)]
    return [message for t in times for message in (joint(t), *both(t))]


def exact(value):
    """Anything as a text that differs if a bit does."""
    if isinstance(value, np.ndarray):
        return value.tobytes().hex()
    if is_dataclass(value):
        return {field.name: exact(getattr(value, field.name)) for field in fields(value)}
    return repr(value)


# --- what is joined ---


def test_equal_stamps_complete_at_once():
    joiner = Joiner(robot(), NO_MOTOR)
    for t in (0, 5, 10):
        assert [add(joiner, *message) for message in (joint(t), wrench(RIGHT, t))] == [[], []]
        (sample,) = add(joiner, *wrench(LEFT, t))
        assert sample.stamp_ns == T0 + t * MS


def test_values_between_two_messages_are_interpolated():
    messages = [wrench(LEFT, 0, 100.0), wrench(RIGHT, 0, 0.0), motor(0, 0.0), joint(3)]
    messages += [wrench(LEFT, 4, 200.0), wrench(RIGHT, 4, 40.0), motor(4, 0.4)]
    (sample,), _ = joined(messages)
    assert sample.left_wrench[2] == pytest.approx(175.0)
    assert sample.right_wrench[2] == pytest.approx(30.0)
    assert sample.motor_q == pytest.approx(np.full(12, 0.3))


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


# --- stamps ---


def counts(messages, settings=NO_MOTOR):
    samples, joiner = joined(messages, settings)
    return len(samples), dict(joiner.rejections.counts)


def test_bad_stamps_are_rejected_and_counted():
    messages = steady(40)
    for name, bad in {
        "zero_stamp": joint(0, stamp_ns=0),
        "stamp_repeated": joint(5 * 19),
        "stamp_back": joint(5 * 10),
        "stamp_jump": joint(3_600_000),
    }.items():
        count, rejected = counts([*messages[:60], bad, *messages[60:]])
        assert (count, rejected) == (40, {f"joint_states/{name}": 1})


@pytest.mark.parametrize("stream", [JOINTS, LEFT])
@pytest.mark.parametrize("wild_ms", [3_600_000, -3_600_000, 500])
@pytest.mark.parametrize("place", [0, 1, 50, 119])
def test_one_wild_stamp_costs_one_message_at_most(stream, wild_ms, place):
    """Wherever it comes, also first and last: the rest of the run is as it would be without it."""
    messages = steady(40)
    wild = joint(wild_ms) if stream == JOINTS else wrench(stream, wild_ms)
    samples, joiner = joined([*messages[:place], wild, *messages[place:]], NO_MOTOR)
    good = [sample for sample in samples if T0 <= sample.stamp_ns < T0 + 200 * MS]
    assert len(good) == 40
    assert sum(sample.left_wrench is None for sample in good) <= (2 if place <= 1 else 0)
    assert sum(joiner.rejections.counts.values()) <= 1


def test_a_gap_is_no_wild_stamp_and_restarts_the_prediction():
    pipeline = Pipeline(robot(), NO_MOTOR)
    for stream, message in [*steady(40), *steady(40, start_ms=1000.0)]:
        pipeline.feed(stream, message, lambda message: message)
    pipeline.flush()
    status = pipeline.status()
    assert (status.samples, status.restarts, status.rejected) == (80, 1, {})


def test_a_bag_that_loops_starts_afresh():
    settings = config()
    messages = walk(1.0)
    pipeline = Pipeline(robot(), settings)
    runs = []
    for _ in range(3):
        out = [p for stream, message in messages for p in pipeline.feed(stream, message, lambda message: message)]
        runs.append(out)
    runs[-1] += pipeline.flush()
    status = pipeline.status()
    assert status.restarts == 2 and status.rejected == {} and status.samples == 600
    flat = [prediction for run in runs for prediction in run]
    first, last = flat[:200], flat[-200:]
    assert [p.stamp_ns for p in first] == [p.stamp_ns for p in last]
    assert [exact(p.measured_com) for p in first[5:]] == [exact(p.measured_com) for p in last[5:]]
    assert [exact(p.predicted_com) for p in first[5:]] == [exact(p.predicted_com) for p in last[5:]]


def test_one_stream_whose_clock_is_set_back_and_again_forth_recovers():
    messages = [m for k in range(100) for m in (joint(5 * k), wrench(RIGHT, 5 * k), wrench(LEFT, 5 * k))]
    moved = []
    for stream, message in messages:
        t = (message.stamp_ns - T0) / MS
        if stream == LEFT and 200 < t < 300:
            message = replace(message, stamp_ns=message.stamp_ns - 10_000 * MS)
        moved.append((stream, message))
    samples, _ = joined(moved, NO_MOTOR)
    missing = [(sample.stamp_ns - T0) / MS for sample in samples if sample.left_wrench is None]
    assert len(samples) == 100 and missing and min(missing) > 200 and max(missing) < 310


@pytest.mark.parametrize(("wrenches_go_back_ms", "lead_s"), [(10_000.0, 0.0), (0.0, 10.0)])
def test_joint_states_that_go_back_while_the_wrenches_go_on(wrenches_go_back_ms, lead_s):
    """A wrench of the run before is no clock of the new one; those that come after it are."""
    times = range(200, 300, 5)
    back = [(joint(t - 10_000.0), *both(t - wrenches_go_back_ms)) for t in times]
    between = both(200)  # after the last joint state of the old run, before the first of the new one
    samples, joiner = joined([*steady(40), *between, *(item for items in back for item in items)], NO_MOTOR)
    assert [(sample.stamp_ns - T0) / MS for sample in samples[40:]] == [t - 10_000.0 for t in times]
    lead = joiner.clock_lead_s
    assert [lead[stream] for stream in (LEFT, RIGHT)] == pytest.approx([lead_s] * 2, abs=0.006)


mutated_walk = walk(0.5, 100.0, reference=True)


@given(st.lists(clock_mutations, min_size=1, max_size=4), st.sampled_from(["motor", "topic", "none"]))
def test_whatever_clocks_do_every_message_is_used_or_counted(mutations, source):
    pipeline = Pipeline(robot(), config(prediction__reference=source))
    predictions = []
    for stream, message in spoil(mutated_walk, mutations):
        predictions += pipeline.feed(stream, message, lambda message: message)
    predictions += pipeline.flush()
    status = pipeline.status()
    assert len(predictions) == status.samples == status.streams[JOINTS].accepted
    for name, stream in status.streams.items():
        rejected = sum(count for key, count in status.rejected.items() if key.rpartition("/")[0] == name)
        assert stream.received == stream.accepted + rejected, name


# --- joints ---


def test_joints_come_in_any_order_and_extra_ones_are_ignored():
    order = np.random.default_rng(1).permutation(12)
    q = np.arange(12) * 0.1
    shuffled = (*(names()[i] for i in order), "gripper")
    message = joint(0, np.append(q[order], 9.0), names=shuffled, velocity=np.append(q[order], 9.0))
    (sample,), joiner = joined([message, *both(0)], NO_MOTOR)
    mine = [robot().joint_names.index(name) for name in names()]
    assert sample.q[mine] == pytest.approx(q) and sample.qd[mine] == pytest.approx(q)
    assert sample.tau is None
    assert joiner.extra_joints == ("gripper",) and not joiner.rejections.counts


def test_joints_that_no_message_lists_are_held_at_zero_unless_they_belong_to_a_leg():
    joiner = Joiner(robot_with_arm(), NO_MOTOR)
    (sample,) = [sample for item in [joint(0, 0.3), *both(0)] for sample in add(joiner, *item)]
    assert joiner.unlisted_joints == ("Arm",)
    arm = robot_with_arm().joint_names.index("Arm")
    assert sample.q[arm] == 0.0 and np.delete(sample.q, arm) == pytest.approx(np.full(12, 0.3))
    message = joint(0, np.zeros(11), names=names()[:-1], velocity=None)
    _, joiner = joined([message, *both(0)], NO_MOTOR)
    assert joiner.rejections.counts == {"joint_states/missing_joint": 1}
    assert names()[-1] in joiner.rejections.last["joint_states/missing_joint"]


def test_motor_states_may_lack_joints_without_motor_encoder():
    """Such a joint is taken as rigid: its motor is where its link is."""
    every = (*names(), "Arm")
    link = np.linspace(0.1, 0.5, len(every))
    joiner = Joiner(robot_with_arm(), config())
    messages = [(JOINTS, JointMessage(T0, every, link, link, None)), motor(0, 0.05), *both(0)]
    (sample,) = [sample for item in messages for sample in add(joiner, *item)]
    for name, q in zip(every, link, strict=True):
        index = robot_with_arm().joint_names.index(name)
        assert sample.motor_q[index] == pytest.approx(0.05 if name in names() else q)


BAD_JOINTS = {
    "nan": [{"position": np.full(12, np.nan)}, {"velocity": np.append(np.zeros(11), np.inf)}],
    "out_of_range": [{"position": np.full(12, 1e200)}, {"effort": np.append(np.full(11, np.nan), -1e300)}],
    "length": [{"position": np.zeros(11)}, {"velocity": np.zeros(13)}, {"effort": np.zeros(1)}],
    "missing_joint": [{"names": ("nobody", *names()[1:])}],
    "repeated_joint": [{"names": (names()[1], *names()[1:])}, {"names": (*names()[:-1], names()[0])}],
    "no_leg_joint": [{"names": tuple("abcdefghijkl")}],
}


@pytest.mark.parametrize(("reason", "change"), [(r, c) for r, changes in BAD_JOINTS.items() for c in changes])
@pytest.mark.parametrize("stream", [JOINTS, MOTORS])
def test_bad_joint_messages_are_rejected_and_counted(reason, change, stream):
    make = joint if stream == JOINTS else motor
    good = [m for t in range(0, 100, 5) for m in (joint(t), motor(t), *both(t))]
    samples, joiner = joined([*good[:40], make(47, **change), *good[40:]])
    if reason == "repeated_joint" and "missing_joint" in str(joiner.rejections.counts):
        reason = "missing_joint"
    assert joiner.rejections.counts == {f"{stream}/{reason}": 1}
    assert len(samples) == 20
    assert joiner.rejections.last[f"{stream}/{reason}"].startswith(f"{stream}: ")


def test_nan_of_a_joint_that_nobody_uses_harms_nothing():
    message = joint(0, np.append(np.zeros(12), np.nan), names=(*names(), "gripper"), velocity=None)
    second = joint(5, np.append(np.zeros(12), np.nan), names=(*names(), "gripper"), velocity=None)
    samples, _ = joined([message, second, *both(0), *both(5)], NO_MOTOR)
    assert len(samples) == 1  # the first has no velocity yet


def test_torques_that_a_joint_does_not_measure_stay_nan():
    effort = np.append(np.nan, np.ones(11))
    (sample,), joiner = joined([joint(0, effort=effort), *both(0)], NO_MOTOR)
    index = robot().joint_names.index(names()[0])
    assert math.isnan(sample.tau[index]) and np.nansum(sample.tau) == 11.0
    assert not joiner.rejections.counts


# --- wrenches ---


@pytest.mark.parametrize(
    ("frame", "fz", "reason"),
    [
        ("r_sole", 1.0, "frame"),
        ("no", 1.0, "frame"),
        ("", 1.0, "frame"),
        (None, math.nan, "nan"),
        (None, math.inf, "nan"),
        (None, -1e301, "out_of_range"),
    ],
)
def test_bad_wrenches_are_rejected_and_counted(frame, fz, reason):
    messages = steady(20)
    samples, joiner = joined([*messages[:30], wrench(LEFT, 48, fz, frame), *messages[30:]], NO_MOTOR)
    assert joiner.rejections.counts == {f"{LEFT}/{reason}": 1} and len(samples) == 20
    assert all(sample.left_wrench[2] == 100.0 for sample in samples)


# --- velocities ---


def test_missing_velocities_are_differentiated_and_never_zero():
    silent = [(s, replace(m, velocity=None) if s in (JOINTS, MOTORS) else m) for s, m in walk(1.0)]
    nan = [(s, replace(m, velocity=np.full(12, np.nan)) if s in (JOINTS, MOTORS) else m) for s, m in walk(1.0)]
    given_, _ = joined(walk(1.0))
    for messages in (silent, nan):
        samples, joiner = joined(messages)
        assert len(samples) == 199 and joiner.rejections.counts == {
            "joint_states/no_velocity": 1,
            "motor_states/no_velocity": 1,
        }
        # Half a window late: four samples of 5 ms.
        error = [sample.qd - known.qd for sample, known in zip(samples[9:], given_[6:], strict=False)]
        assert np.sqrt(np.mean(np.square(error))) < 0.15 * np.sqrt(np.mean(np.square([k.qd for k in given_])))


# --- anything at all ---

anything = st.floats(allow_nan=True, allow_infinity=True)
stamps = st.one_of(st.integers(-(2**63), 2**63), st.integers(T0, T0 + 10**9))
some_names = st.one_of(st.just(names()), st.lists(st.sampled_from((*names(), "x", "")), max_size=14).map(tuple))
arrays = st.one_of(
    st.lists(anything, max_size=14).map(np.array), st.lists(st.floats(-3, 3), min_size=12, max_size=12).map(np.array)
)
triples = st.lists(anything, min_size=3, max_size=3).map(np.array)
joint_messages = st.builds(
    JointMessage, stamps, some_names, arrays, st.one_of(st.none(), arrays), st.one_of(st.none(), arrays)
)
wrench_messages = st.builds(WrenchMessage, stamps, st.sampled_from(["l_sole", "r_sole", "", "x"]), triples, triples)
streams_and_messages = st.one_of(
    st.tuples(st.sampled_from([JOINTS, MOTORS]), joint_messages),
    st.tuples(st.sampled_from([LEFT, RIGHT]), wrench_messages),
)


@given(st.lists(st.tuples(st.integers(0, 119), streams_and_messages), max_size=20))
def test_whatever_comes_nothing_breaks_and_samples_hold_numbers(bad):
    messages = steady(40)
    for place, message in sorted(bad, key=lambda item: -item[0]):
        messages.insert(place, message)
    pipeline = Pipeline(robot(), NO_MOTOR)
    batches = [pipeline.take(stream, message, lambda message: message) for stream, message in messages]
    samples = [sample for batch in (*batches, pipeline.joiner.flush()) for sample in batch]
    pipeline.predict(samples)
    for sample in samples:
        assert np.isfinite(sample.q).all() and np.isfinite(sample.qd).all()
        for wrench_ in (sample.left_wrench, sample.right_wrench):
            assert wrench_ is None or np.isfinite(wrench_).all()
    status = pipeline.status()
    assert status.samples == len(samples)
    assert sum(status.rejected.values()) <= len(bad) + 41


def test_the_first_sample_of_single_support_has_its_phase():
    """The whole way: phases of the prediction are those of the loads."""
    pipeline = Pipeline(robot(), config())
    out = [p for stream, message in walk(3.0) for p in pipeline.feed(stream, message, lambda message: message)]
    phases = {p.support.phase for p in out[50:]}
    assert phases == {Phase.LEFT, Phase.RIGHT, Phase.DOUBLE}
