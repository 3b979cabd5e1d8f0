# SPDX-License-Identifier: BSD-3-Clause
"""The trajectory node as users meet it: its services, and its plan in the time of a bag."""

from __future__ import annotations

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from coman_reduced_model_msgs.msg import ComReference
from nav_msgs.msg import Path as PathMessage
from ros_testing import stamp_of, vector
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from coman_reduced_model.ros.interface import qos

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures("nodes_compiled")]


class References:
    def __init__(self, peer):
        self.messages, self.paths = [], []
        peer.node.create_subscription(ComReference, "com/reference", self.messages.append, qos.sensor_input())
        peer.node.create_subscription(PathMessage, "com/reference_path", self.paths.append, qos.latched())

    def arrays(self):
        t = np.array([stamp_of(m) for m in self.messages]) * 1e-9
        return (
            t,
            np.array([vector(m.position) for m in self.messages]),
            np.array([vector(m.velocity) for m in self.messages]),
        )


def test_a_plan_is_published_ahead_of_its_time(start, peer):
    references = References(peer)
    node = start.node("trajectory", use_sim_time=True, gait__ahead=0.3)
    clock = peer.publisher(Clock, "/clock", qos.clock_output())
    now = 7_000_000_000

    def ahead():
        """Whether the newest point is ahead of the clock, which goes on: the first points may be missed."""
        nonlocal now
        now += 5_000_000
        clock.publish(Clock(clock=Time(sec=now // 10**9, nanosec=now % 10**9)))
        return references.messages and stamp_of(references.messages[-1]) > now

    peer.wait(ahead, "com/reference ahead of the clock")
    peer.wait(lambda: stamp_of(references.messages[-1]) == now + 300_000_000, "the plan 0.3 s ahead")
    assert node.stop() == 0


def test_trajectory_starts_stops_and_resets(start, peer):
    references = References(peer)
    node = start.node("trajectory", gait__autostart=False, gait__single_support=0.3, gait__double_support=0.1)
    peer.wait(lambda: references.messages and references.paths, "com/reference and its path")

    def call(name):
        answer = peer.call(Trigger, f"/trajectory/{name}", Trigger.Request())
        return answer.success, answer.message

    peer.spin(0.3)
    assert np.abs(references.arrays()[2]).max() < 1e-9, "stands until it is told to start"
    assert call("stop") == (False, "stands already")
    assert call("start")[0]
    success, message = call("start")
    assert not success and "walking already" in message
    peer.wait(lambda: references.messages[-1].step >= 1, "the second step")
    steps_before = references.messages[-1].step
    assert call("stop")[0]
    peer.wait(lambda: call("stop") == (False, "stands already"), "stands")
    last = references.messages[-1]
    assert steps_before < last.step <= steps_before + 5
    assert last.left_sole.position.x == pytest.approx(last.right_sole.position.x), "feet together"
    t, com, velocity = references.arrays()
    np.testing.assert_allclose(np.diff(t), 0.005, atol=1e-6)  # a grid, none left out
    moved = np.diff(com, axis=0) - 0.0025 * (velocity[1:] + velocity[:-1])
    assert np.abs(moved).max() < 3e-4, "the stop does not make the COM jump"
    assert call("start")[0], "from where it stands"
    peer.spin(0.1)
    assert references.messages[-1].left_sole.position.x == last.left_sole.position.x > 0.01
    assert call("reset")[0]
    peer.spin(0.1)
    assert references.messages[-1].left_sole.position.x == 0.0 and references.messages[-1].step == -1
    assert len(references.paths) >= 4
    assert node.stop() == 0


def test_a_walk_that_repeats_stops_and_stays(start, peer):
    """~/stop in mid-walk holds, also beyond the end of the plan; ~/start walks again, and repeats again."""
    references = References(peer)
    start.node("trajectory", gait__repeat=True, gait__steps=3, gait__single_support=0.3, gait__double_support=0.1)
    peer.wait(lambda: references.messages and references.messages[-1].step >= 1, "the second step")
    answer = peer.call(Trigger, "/trajectory/stop", Trigger.Request())
    assert answer.success, answer.message

    def stands() -> bool:
        return peer.call(Trigger, "/trajectory/stop", Trigger.Request()).message == "stands already"

    peer.wait(stands, "stands")
    place = references.messages[-1].left_sole.position.x
    peer.spin(1.5)  # a step takes 0.4 s
    assert stands() and references.messages[-1].left_sole.position.x == place
    assert peer.call(Trigger, "/trajectory/start", Trigger.Request()).success
    peer.wait(lambda: references.messages[-1].left_sole.position.x > place + 0.05, "more than one plan further")


def test_trajectory_in_the_time_of_a_bag(start, peer):
    """With use_sim_time and a start time, the plan is where the bag's clock says, also when it jumps back."""
    references = References(peer)
    clock = peer.publisher(Clock, "/clock", qos.clock_output())
    node = start.node("trajectory", use_sim_time=True, gait__start_time=1000.0)
    peer.wait(lambda: clock.get_subscription_count(), "the node listens to /clock")
    peer.spin(0.3)
    assert not references.messages, "no time, no reference"

    def play(first, last):
        references.messages.clear()
        for t in np.arange(first, last, 0.005):
            message = Clock()
            message.clock.sec, message.clock.nanosec = divmod(round(t * 1e9), 1_000_000_000)
            clock.publish(message)
            peer.spin(0.002)
        peer.spin(0.2)
        return references.arrays()

    t, com, _ = play(999.5, 1003.5)
    assert t[0] >= 999.5 and t[-1] > 1003.4
    np.testing.assert_allclose(np.diff(t), 0.005, atol=1e-6)
    again, com_again, _ = play(1001.0, 1003.0)
    common = {round(a, 4): c for a, c in zip(t, com, strict=True)}
    for a, c in zip(again, com_again, strict=True):
        np.testing.assert_allclose(c, common[round(a, 4)], atol=1e-9)
    assert node.stop() == 0
