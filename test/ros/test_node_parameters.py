# SPDX-License-Identifier: BSD-3-Clause
"""Parameters of nodes at run time: what each has, what changes, what is refused and why."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from coman_reduced_model_msgs.msg import ComPrediction, ComReference, SupportState
from geometry_msgs.msg import PointStamped
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.parameter import Parameter
from ros_testing import PERIOD_NS, Standing, stamp_of
from std_srvs.srv import Trigger

from coman_reduced_model.errors import ConfigError
from coman_reduced_model.ros.interface import qos

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures("nodes_compiled")]


class Parameters:
    """Those of one node, through its services."""

    def __init__(self, peer, node):
        self._peer, self._node = peer, node

    def __getitem__(self, name):
        request = GetParameters.Request(names=[name])
        (value,) = self._peer.call(GetParameters, f"/{self._node}/get_parameters", request).values
        return value

    def set(self, name, value):
        """Why it was refused; empty if it was not."""
        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        (result,) = self._peer.call(SetParameters, f"/{self._node}/set_parameters", request).results
        assert result.successful == (not result.reason)
        return result.reason

    def names(self):
        """Without those that every node has."""
        listed = self._peer.call(ListParameters, f"/{self._node}/list_parameters", ListParameters.Request())
        of_ros = ("qos_overrides", "use_sim_time", "start_type_description_service")
        return {name for name in listed.result.names if not name.startswith(of_ros)}

    def described(self, *names):
        request = DescribeParameters.Request(names=list(names))
        return self._peer.call(DescribeParameters, f"/{self._node}/describe_parameters", request).descriptors


def sections(names):
    return {name.partition(".")[0] for name in names}


def test_each_node_declares_its_own(start, peer):
    """All three take the same file, whose section /** has keys of all."""
    given = ("--params-file", "config/coman.yaml")
    nodes = [start.node(name, *given) for name in ("predictor", "trajectory", "virtual_robot")]
    predictor, trajectory, robot = (Parameters(peer, n).names() for n in ("predictor", "trajectory", "virtual_robot"))
    assert sections(predictor) == {
        "robot", "streams", "support", "model", "prediction", "output", "monitor", "effects", "robot_description",
    }  # fmt: skip
    assert sections(trajectory) == {"gait", "robot", "output"} and "robot.left.joints" not in trajectory
    assert sections(robot) == {"virtual_robot", "gait", "robot", "output"}
    unused = Parameters(peer, "trajectory").set("monitor.threshold", 7.0)
    assert unused == "monitor.threshold: the node trajectory has no use for it"
    assert "did you mean 'gait.steps'?" in Parameters(peer, "trajectory").set("gait.stepps", 3)
    for node in nodes:
        assert node.stop() == 0


def test_a_baseline_is_found_from_the_file_that_names_it(tmp_path, monkeypatch):
    """Also where the URDF is that of the topic, and where a launch file adds a file of its own."""
    from coman_reduced_model.ros.interface.parameters import _directory

    (tmp_path / "usual.yaml").write_text("")
    (tmp_path / "launch").mkdir()
    files = [tmp_path / "robot.yaml", tmp_path / "launch" / "parameters.yaml"]
    monkeypatch.setattr("sys.argv", ["predictor", *(word for each in files for word in ("--params-file", str(each)))])
    for urdf in ("", "/somewhere/robot.urdf"):
        assert _directory(urdf, "usual.yaml") == tmp_path
    assert _directory("", "") == _directory("", "other.yaml") == Path()


def test_parameter_files_are_checked_together(tmp_path):
    """As ROS takes them: a later one may hold what only fits with an earlier one."""
    from coman_reduced_model.ros.interface.parameters import check_files

    for name, values in (("robot", "support.contact_off: 0.01"), ("mine", "support.contact_on: 0.03")):
        (tmp_path / f"{name}.yaml").write_text(f"/**:\n  ros__parameters:\n    {values}\n")
    files = [word for name in ("robot", "mine") for word in ("--params-file", str(tmp_path / f"{name}.yaml"))]
    check_files(["predictor", "--ros-args", *files], "predictor")
    with pytest.raises(ConfigError, match="contact_off"):
        check_files(["predictor", "--ros-args", *files[2:]], "predictor")


def test_predictor(start, peer):
    node = start.node("predictor", output__points_rate=200.0)
    standing, parameters = Standing(peer), Parameters(peer, "predictor")
    standing.describe()
    standing.wait_until_heard()

    def phase(**shares):
        standing.samples(60, **shares)
        peer.wait(lambda: stamp_of(peer.predictions[-1]) == standing.stamp, "the last prediction")
        return peer.predictions[-1].support.phase

    standing.samples(10)
    peer.wait(lambda: peer.predictions, "predictions")
    # A light touch of the right foot counts as contact, until the threshold says otherwise.
    assert phase(left=1.0, right=0.0) == SupportState.LEFT
    assert phase(left=0.7, right=0.3) == SupportState.DOUBLE
    assert parameters.set("support.contact_on", 0.6) == ""
    assert phase(left=1.0, right=0.0) == SupportState.LEFT
    assert phase(left=0.7, right=0.3) == SupportState.LEFT
    assert parameters.set("support.contact_on", 5.0)
    assert "must be below support.contact_on = 0.6" in parameters.set("support.contact_off", 0.7)
    assert "read-only parameter: robot.gravity" in parameters.set("robot.gravity", 1.6)
    assert "nowhere.yaml" in parameters.set("monitor.baseline", "/nowhere.yaml")
    assert parameters["support.contact_on"].double_value == 0.6 and parameters["monitor.baseline"].string_value == ""
    wait, contact = parameters.described("streams.max_wait", "support.contact_on")
    assert wait.read_only and "[s]" in wait.description
    assert not contact.read_only and contact.floating_point_range[0].to_value == 0.9
    # Rates of outputs, and the monitor.
    points = []
    peer.node.create_subscription(PointStamped, "com/measured", points.append, 10)
    peer.wait(lambda: phase() and points, "points")
    assert parameters.set("output.points_rate", 0.0) == ""
    peer.spin(0.3)
    points.clear()
    phase()
    peer.spin(0.3)
    assert not points
    assert parameters.set("monitor.enabled", False) == ""
    assert parameters.set("output.diagnostics_rate", 20.0) == ""
    disabled = "monitor disabled (monitor.enabled)"
    peer.wait(lambda: peer.statuses["predictor: mismatch"][1] == disabled, "no monitor")
    reports = peer.reports
    peer.wait(lambda: peer.reports > reports + 40, "40 reports", 30.0)  # at 1 Hz, they would take 40 s
    assert parameters.set("monitor.enabled", True) == ""
    peer.wait(lambda: peer.statuses["predictor: mismatch"][1] != disabled, "a monitor")
    assert node.stop() == 0


def test_the_predictor_is_reset(start, peer):
    node = start.node("predictor")
    standing = Standing(peer)
    early = peer.call(Trigger, "/predictor/reset", Trigger.Request())
    assert not early.success and "waiting for the URDF on /robot_description" in early.message
    standing.describe()
    standing.wait_until_heard()

    def flags():
        count = len(peer.predictions)
        standing.samples(20)
        peer.wait(lambda: stamp_of(peer.predictions[-1]) == standing.stamp, "the last prediction")
        return [each.flags & ComPrediction.FLAG_RESET for each in peer.predictions[count:]]

    standing.samples(10)
    peer.wait(lambda: peer.predictions, "predictions")
    assert not any(flags()[5:])
    done = peer.call(Trigger, "/predictor/reset", Trigger.Request())
    assert done.success and "odom" in done.message
    assert sum(map(bool, flags())) == 1, "the free run begins again, once"
    reports = peer.reports
    peer.wait(lambda: peer.reports > reports + 1, "diagnostics")
    assert peer.statuses["predictor: prediction"][2]["restarts"] == "0", "the joint states were not interrupted"
    assert node.stop() == 0


def test_missing_inputs_are_said_in_the_console(start, peer):
    node = start.node("predictor")
    node.wait_for("no usable message for 5 s on /robot_description (no publisher)")
    standing = Standing(peer)
    standing.describe()
    standing.wait_until_heard()
    for _ in range(3):  # all but the motors; the left wrench in an unknown frame
        standing.stamp += PERIOD_NS
        standing.joints.publish(standing.joint())
        for foot, publisher in standing.wrenches.items():
            publisher.publish(standing.wrench(foot, 85.0, frame="nowhere" if foot == 1 else None))
    node.wait_for("/motor_states (1 publisher; wanted by prediction.reference: motor; `none` does without)")
    node.wait_for("/left_foot/wrench (left_foot/wrench: ")
    assert "nowhere" in node.output
    standing.samples(10)
    node.wait_for("messages again on ")
    assert node.stop() == 0
    assert node.output.count("/motor_states (1 publisher") == 1, "once"


def test_a_gait_changes_with_the_next_plan(start, peer):
    messages = []
    peer.node.create_subscription(ComReference, "com/reference", messages.append, qos.sensor_input())
    node = start.node("trajectory", gait__autostart=False, gait__steps=2, gait__single_support=0.3)
    peer.wait(lambda: messages, "com/reference")
    parameters = Parameters(peer, "trajectory")

    def walk():
        assert peer.call(Trigger, "/trajectory/start", Trigger.Request()).success
        first = len(messages)

        def stands():
            return peer.call(Trigger, "/trajectory/stop", Trigger.Request()).message == "stands already"

        peer.wait(lambda: any(each.step == 0 for each in messages[first:]), "the first step")
        peer.wait(lambda: messages[-1].step >= 1, "the last step")
        peer.wait(stands, "stands")
        com = np.array([(m.position.x, m.position.z) for m in messages[first - 1 :]])
        assert np.abs(np.diff(com, axis=0)).max() < 0.01, "the COM does not jump"
        return messages[-1].left_sole.position.x - messages[first].left_sole.position.x

    assert walk() == pytest.approx(0.03, abs=1e-6)
    assert parameters.set("gait.step_length", 0.06) == ""
    node.wait_for("another gait from the next plan on")
    assert walk() == pytest.approx(0.06, abs=1e-6)
    assert "'moonwalk' is not allowed" in parameters.set("gait.name", "moonwalk")
    assert "read-only" in parameters.set("gait.com_height", 0.3)
    assert parameters["gait.name"].string_value == "test1"
    assert walk() == pytest.approx(0.06, abs=1e-6)
    assert node.stop() == 0
