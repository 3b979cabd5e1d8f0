# SPDX-License-Identifier: BSD-3-Clause
"""Bad input to a running predictor: nothing kills it, everything is counted and said in /diagnostics.

One node serves all cases: that it goes on after each of them is part of what is tested.
"""

from __future__ import annotations

import math
import time
from array import array

import numpy as np
import pytest
from coman_reduced_model_msgs.msg import ComPrediction, ComReference, SupportState
from conftest import PATIENCE, Starter
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from ros_domains import domain_of_its_own
from ros_testing import NAMES, PERIOD_NS, WEIGHT, Peer, Q, Standing, stamp_of, vector

from coman_reduced_model.core.base.types import Flags, Foot

pytestmark = pytest.mark.ros
LEFT, RIGHT = Foot.LEFT, Foot.RIGHT


def is_valid(prediction: ComPrediction) -> bool:
    return not Flags(prediction.flags).invalid


class Rig:
    """A running predictor and what feeds it."""

    def __init__(self) -> None:
        self.start = Starter()
        self.node = self.start.node("predictor", output__diagnostics_rate=20.0)
        self.peer = Peer()
        self.standing = Standing(self.peer)
        self.references = self.peer.publisher(ComReference, "com/reference")
        self.standing.describe()
        self.standing.wait_until_heard()
        self.standing.samples(20)
        self.peer.wait(lambda: self.peer.predictions, "predictions")

    def report(self, part: str = "input") -> tuple[int, str, dict[str, str]]:
        """A diagnosis of what was sent so far."""
        reports = self.peer.reports
        self.peer.wait(lambda: self.peer.reports >= reports + 3, "diagnostics")
        return self.peer.statuses[f"predictor: {part}"]

    def says(self, what: str, **sending) -> int:
        """Level of the diagnosis of the input that says this; samples go on meanwhile."""
        deadline = time.monotonic() + PATIENCE
        while True:
            level, message, _ = self.report()
            if what in message:
                return level
            assert time.monotonic() < deadline, message
            self.standing.samples(20, **sending)

    def is_well(self) -> bool:
        return self.says("all streams are there") == 0

    def count(self, key: str) -> int:
        return int(self.report()[2].get(f"rejected: {key}", 0))

    def predicts(self, samples: int = 20, **arguments) -> ComPrediction:
        """Send good samples; the prediction for the last of them."""
        self.standing.samples(samples, **arguments)
        wanted = self.standing.stamp
        self.peer.wait(lambda: self.peer.predictions and stamp_of(self.peer.predictions[-1]) == wanted, "predictions")
        return self.peer.predictions[-1]

    def close(self) -> None:
        assert self.node.running
        assert self.node.stop() == 0 and "Traceback" not in self.node.output
        self.peer.close()


@pytest.fixture(scope="module")
def rig():
    with domain_of_its_own():
        rig = Rig()
        try:
            yield rig
            rig.close()
        finally:
            for process in rig.start.processes:
                process.kill()


def with_positions(message, values):
    message.position = array("d", values)
    return message


def renamed(names):
    return ("Knee", *names[1:])


def one_nan(value):
    return np.where(np.arange(12) == 3, value, Q)


# What is sent on joint_states, the counter that must rise, and a word of the sentence that must be said.
JOINTS = {
    "NaN": (lambda s: s.joint(one_nan(math.nan)), "nan", "LKneeSag"),
    "infinite": (lambda s: s.joint(one_nan(math.inf)), "nan", "inf"),
    "missing joint": (lambda s: s.joint(Q[1:], NAMES[1:]), "missing_joint", "LHipSag"),
    "renamed joint": (lambda s: s.joint(Q, renamed(NAMES)), "missing_joint", "LHipSag"),
    "joint twice": (lambda s: s.joint(np.append(Q, 0.0), (*NAMES, NAMES[1])), "repeated_joint", "LHipLat"),
    "no joints": (lambda s: s.joint(np.empty(0), ()), "no_leg_joint", "no joint of the legs"),
    "unequal arrays": (lambda s: with_positions(s.joint(), Q[:-1]), "length", "11 positions for 12 names"),
    "empty positions": (lambda s: with_positions(s.joint(), []), "length", "0 positions"),
    "stamp zero": (lambda s: s.joint(stamp=0), "zero_stamp", "header"),
    "stamp repeats": (lambda s: s.joint(stamp=s.stamp - PERIOD_NS), "stamp_repeated", "twice"),
    "stamp goes back": (lambda s: s.joint(stamp=s.stamp - 4 * PERIOD_NS), "stamp_back", "before"),
    "stamp jumps ahead": (lambda s: s.joint(stamp=s.stamp + 10**10), "stamp_jump", "after"),
    "stamp jumps back": (lambda s: s.joint(stamp=s.stamp - 10**11), "stamp_jump", "before"),
}


@pytest.mark.parametrize("case", JOINTS)
def test_bad_joint_state(rig, case):
    make, reason, sentence = JOINTS[case]
    key = f"joint_states/{reason}"
    before = rig.count(key)
    restarts = int(rig.report("prediction")[2]["restarts"])
    rig.standing.stamp += PERIOD_NS
    rig.standing.joints.publish(make(rig.standing))
    rig.predicts()
    assert rig.count(key) == before + 1
    values = rig.report()[2]
    assert sentence in values[f"rejected: {key}: last"]
    assert int(rig.report("prediction")[2]["restarts"]) == restarts, "one bad message restarts nothing"


def test_rejections_are_said_in_words(rig):
    rig.standing.joints.publish(rig.standing.joint(one_nan(math.nan)))

    def warned() -> bool:
        level, message, _ = rig.peer.statuses["predictor: input"]
        return level == 1 and "LKneeSag" in message

    rig.peer.wait(warned, "a warning")
    rig.predicts()
    assert rig.is_well(), "the warning goes with its cause"


def test_extra_joints_are_ignored_and_named(rig):
    s = rig.standing
    count = len(rig.peer.predictions)
    for _ in range(5):
        s.sample(joint_stream=False)
        s.joints.publish(s.joint(np.append(Q, 1.0), (*NAMES, "Neck")))
        rig.peer.spin(0.001)
    rig.predicts()
    assert len(rig.peer.predictions) == count + 25
    assert rig.report()[2]["joints that the URDF lacks (ignored)"] == "Neck"


def test_order_of_joints_does_not_matter(rig):
    s = rig.standing
    wanted = rig.predicts()
    s.sample(joint_stream=False)
    s.joints.publish(s.joint(Q[::-1], NAMES[::-1]))
    rig.peer.wait(lambda: stamp_of(rig.peer.predictions[-1]) == s.stamp, "its prediction")
    np.testing.assert_array_equal(vector(rig.peer.predictions[-1].measured_position), vector(wanted.measured_position))


WRENCHES = {
    "NaN": (lambda s: s.wrench(LEFT, math.nan), "nan", "nan"),
    "unknown frame": (lambda s: s.wrench(LEFT, 80.0, frame="tool"), "frame", "tool"),
    "frame of the other foot": (lambda s: s.wrench(LEFT, 80.0, frame="r_sole"), "frame", "not fixed"),
    "stamp zero": (lambda s: s.wrench(LEFT, 80.0, stamp=0), "zero_stamp", "header"),
    "stamp goes back": (lambda s: s.wrench(LEFT, 80.0, stamp=s.stamp - 4 * PERIOD_NS), "stamp_back", "before"),
}


@pytest.mark.parametrize("case", WRENCHES)
def test_bad_wrench(rig, case):
    make, reason, sentence = WRENCHES[case]
    key = f"left_foot/wrench/{reason}"
    before = rig.count(key)
    rig.standing.wrenches[LEFT].publish(make(rig.standing))
    prediction = rig.predicts()
    assert rig.count(key) == before + 1
    assert sentence in rig.report()[2][f"rejected: {key}: last"]
    assert prediction.support.total_force == pytest.approx(WEIGHT)


def test_bad_reference(rig):
    message = ComReference()
    message.header.frame_id = "odom"
    message.header.stamp.sec = 1000
    message.phase = 9
    rig.references.publish(message)
    message.phase, message.position.x = 3, math.nan
    rig.references.publish(message)
    message.position.x, message.preview_position = 0.0, array("d", [1.0, 2.0])
    rig.references.publish(message)
    rig.predicts()
    for reason in ("phase", "nan", "length"):
        assert rig.count(f"com/reference/{reason}") == 1


@pytest.mark.parametrize("stream", ["left_stream", "motor_stream", "joint_stream"])
def test_stream_that_stops_and_comes_back(rig, stream):
    rig.predicts()
    restarts = int(rig.report("prediction")[2]["restarts"])
    rig.standing.samples(120, **{stream: False})
    if stream != "joint_stream":
        name, flag = {
            "left_stream": ("left_foot/wrench", ComPrediction.FLAG_STALE_WRENCH),
            "motor_stream": ("motor_states", ComPrediction.FLAG_NO_REFERENCE),
        }[stream]
        assert rig.says(name, **{stream: False}) > 0
        prediction = rig.peer.predictions[-1]
        assert prediction.flags & flag
        assert math.isnan(prediction.predicted_position.x) or stream == "left_stream"
        assert prediction.measured_position.z > 0.2, "what is measured goes on"
    prediction = rig.predicts(40)
    assert is_valid(prediction) and math.isfinite(prediction.predicted_position.x)
    assert rig.is_well()
    assert int(rig.report("prediction")[2]["restarts"]) == restarts + (stream == "joint_stream")


def test_silence_is_said(rig):
    rig.predicts()
    rig.peer.wait(lambda: rig.peer.statuses["predictor: input"][0] == 3, "stale")
    assert "no message on /joint_states for" in rig.peer.statuses["predictor: input"][1]
    rig.predicts()
    assert rig.is_well()


@pytest.mark.parametrize("offset_s", [-2.0, 3.0])
def test_clock_that_differs(rig, offset_s):
    s, offset = rig.standing, round(offset_s * 1e9)
    rig.predicts()

    def differing() -> bool:
        for _ in range(60):
            s.sample(left_stream=False)
            s.wrenches[LEFT].publish(s.wrench(LEFT, 0.5 * WEIGHT, stamp=s.stamp + offset))
            rig.peer.spin(0.001)
        level, message, _ = rig.report()
        side = "ahead of" if offset_s > 0 else "behind"
        return level > 0 and "left_foot/wrench: its clock is" in message and f"s {side} joint_states" in message

    rig.peer.wait(differing, "a warning of the clock")
    rig.predicts(60)
    assert is_valid(rig.predicts(20))
    assert rig.is_well()


def test_swapped_feet(rig):
    # The left foot is lifted by the joints, and yet the left wrench carries the robot.
    q = Q.copy()
    q[:6] = (-0.6, 0.0, 0.0, 1.2, -0.6, 0.0)
    rig.predicts(400, q=q, left=1.0, right=0.0)
    assert rig.says("left and right swapped?", q=q, left=1.0, right=0.0) == 1
    jump(rig)
    rig.predicts(100)
    assert rig.is_well()


def jump(rig):
    """A gap in all streams: what was seen before counts no more."""
    rig.standing.stamp += 10**9


def test_wrong_sign_of_the_vertical_force(rig):
    jump(rig)
    prediction = rig.predicts(400, left=-0.5, right=-0.5)
    assert rig.says("wrong sign?", left=-0.5, right=-0.5) == 1
    assert prediction.support.phase == SupportState.FLIGHT and math.isnan(prediction.predicted_position.x)
    jump(rig)
    rig.predicts(100)
    assert rig.is_well()


def test_time_that_jumps_back_restarts(rig):
    rig.predicts()
    restarts = int(rig.report("prediction")[2]["restarts"])
    rig.standing.stamp -= 500 * 10**9
    prediction = rig.predicts(40)
    assert int(rig.report("prediction")[2]["restarts"]) == restarts + 1
    assert is_valid(prediction)


numbers = st.floats(allow_nan=True, allow_infinity=True)
lists = st.lists(numbers, max_size=14)
stamps = st.tuples(st.integers(-(2**31), 2**31 - 1), st.integers(0, 2**32 - 1))


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    names=st.lists(st.sampled_from((*NAMES, "", "x" * 300, "ü")), max_size=14),
    arrays=st.tuples(lists, lists, lists),
    stamp=stamps,
    force=numbers,
    frame=st.sampled_from(("l_sole", "", "odom", "/l_sole")),
)
def test_nothing_kills_the_node(rig, names, arrays, stamp, force, frame):
    s = rig.standing
    joint, wrench = s.joint(), s.wrench(LEFT, force, frame=frame)
    joint.name, joint.position, joint.velocity, joint.effort = names, *(array("d", values) for values in arrays)
    for message, publisher in ((joint, s.joints), (joint, s.motors), (wrench, s.wrenches[LEFT])):
        message.header.stamp.sec, message.header.stamp.nanosec = stamp
        publisher.publish(message)
    rig.peer.spin(0.001)
    assert rig.node.running


def test_after_all_that_it_predicts(rig):
    jump(rig)
    rig.predicts(200)
    values = rig.report()[2]
    assert not [key for key in values if key.startswith("internal error")]
    prediction = rig.predicts()
    assert is_valid(prediction)
    assert prediction.support.phase == SupportState.DOUBLE
    assert np.abs(vector(prediction.residual)).max() < 0.05
