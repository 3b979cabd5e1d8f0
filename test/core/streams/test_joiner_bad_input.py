# SPDX-License-Identifier: BSD-3-Clause
"""Streams joined by stamp when messages are bad: what is used, what is counted."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from joiner_tools import MS, NO_MOTOR, add, both, config, exact, joined, joint, motor, steady, wrench
from mutations import clock_mutations, spoil
from synthetic import LEFT, RIGHT, T0, names, robot, robot_with_arm, walk

from coman_reduced_model.core.base.stream_names import JOINTS, MOTORS
from coman_reduced_model.core.base.types import JointMessage, Phase, WrenchMessage
from coman_reduced_model.core.pipeline import Pipeline
from coman_reduced_model.core.streams.joiner import Joiner
from coman_reduced_model.core.streams.joint_map import JointMap
from coman_reduced_model.core.streams.stream import Refused

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


@pytest.mark.slow
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


def test_motors_outside_the_legs_that_say_nan_are_where_their_link_is():
    """From then on too; what the message after says of them counts again."""
    every, link = (*names(), "Arm"), np.linspace(0.1, 0.5, 13)
    joiner, index = Joiner(robot_with_arm(), config()), robot_with_arm().joint_names.index("Arm")
    arms = []
    for ms, arm in ((0, np.nan), (5, 0.2)):
        joints = (JOINTS, JointMessage(T0 + round(ms * MS), every, link, link, None))
        said = motor(ms, np.append(np.full(12, 0.05), arm), names=every, velocity=np.zeros(13))
        (sample,) = [sample for item in (joints, said, *both(ms)) for sample in add(joiner, *item)]
        assert np.isfinite(sample.motor_q).all() and np.isfinite(sample.motor_qd).all()
        arms.append(sample.motor_q[index])
    assert arms == pytest.approx([link[12], 0.2]) and not joiner.rejections.counts


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


def test_velocities_that_a_joint_outside_the_legs_does_not_have_are_differentiated():
    """As of a hand without sensors: all joint states would be refused."""
    joints, position = JointMap((*names(), "ArmSag"), names()), np.zeros(13)

    def velocities(which: int, value: float) -> np.ndarray | None:
        velocity = np.where(np.arange(13) == which, value, 1.0)
        return joints.sort(JointMessage(T0, (*names(), "ArmSag"), position, velocity, None)).qd

    assert velocities(12, np.nan) is None and np.array_equal(velocities(12, 1.0), np.ones(13))
    for which, value in ((3, np.nan), (12, np.inf)):
        with pytest.raises(Refused, match="velocity of"):
            velocities(which, value)


def test_a_joint_outside_the_legs_without_a_position_is_held_at_zero():
    """As a wheel or a hand that only knows its speed: nothing would ever be predicted."""
    joints, listed = JointMap((*names(), "ArmSag"), names()), (*names(), "ArmSag")
    position = np.append(np.full(12, 0.1), np.nan)
    state = joints.sort(JointMessage(T0, listed, position, np.ones(13), None))
    assert (state.q[12], state.qd[12]) == (0.0, 0.0) and joints.unlisted == ("ArmSag",)
    assert joints.sort(JointMessage(T0, listed, np.full(13, 0.7), None, None)).q[12] == 0.7 and joints.unlisted == ()
    for which, value in ((3, np.nan), (12, np.inf)):
        with pytest.raises(Refused, match="position of"):
            joints.sort(JointMessage(T0, listed, np.where(np.arange(13) == which, value, 0.1), np.zeros(13), None))


def test_joints_that_the_last_message_did_not_list_are_those_that_are_held():
    """Two publishers of one stream, one of the legs alone."""
    joints, whole = JointMap((*names(), "ArmSag"), names(), np.nan), (*names(), "ArmSag")
    for listed in (names(), whole, names(), whole):
        n = len(listed)
        state = joints.sort(JointMessage(T0, listed, np.full(n, 0.1), np.zeros(n), None))
        assert joints.unlisted == (() if listed is whole else ("ArmSag",))
        assert np.isnan(state.q[12]) == (listed is not whole)


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


@pytest.mark.slow
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


def test_motor_states_without_velocities_begin_a_new_run():
    """The first message after a jump back gives none yet: it is refused, and nothing else."""
    run = [(s, replace(m, velocity=None) if s == MOTORS else m) for s, m in walk(0.2, 100.0)]
    samples, joiner = joined([*run, *((s, replace(m, stamp_ns=m.stamp_ns - 10 * 10**9)) for s, m in run)], config())
    assert len(samples) == 40 and samples[-1].motor_qd is not None
    assert set(joiner.rejections.counts) == {f"{MOTORS}/no_velocity"}
