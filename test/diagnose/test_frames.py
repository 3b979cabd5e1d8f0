# SPDX-License-Identifier: BSD-3-Clause
"""The axes of root link and base frame are a matter of taste: what is predicted and found must not depend on them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
import pytest
from diagnose_tools import index, rms, standing, t
from effect_tools import PAPER, config, predicted, same, trunk_config
from scipy.spatial.transform import Rotation
from synthetic import LEFT, MOTORS, RIGHT, T0, robot, rooted, walk

from coman_reduced_model.bag.session import Session
from coman_reduced_model.core.base.stream_names import JOINTS
from coman_reduced_model.core.base.types import Foot, ImuMessage, Phase
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.effects.catalogue import build_effects
from coman_reduced_model.core.pipeline import Pipeline
from coman_reduced_model.core.robot.robot import Robot
from coman_reduced_model.diagnose.data.masks import masks
from coman_reduced_model.diagnose.data.recording import FEET, Recording, load
from coman_reduced_model.diagnose.data.world import World
from coman_reduced_model.diagnose.physics.balance import evaluate
from coman_reduced_model.diagnose.physics.hypotheses import unknowns
from coman_reduced_model.diagnose.workflow import diagnose
from coman_reduced_model.sim.disturbances import make
from coman_reduced_model.sim.record import record


@dataclass(frozen=True)
class Root:
    """A root link above the trunk, and which of both is `robot.base_frame`."""

    rpy: str
    kind: str = "fixed"
    base: str = "base_link"

    @property
    def urdf(self) -> str:
        return rooted(self.rpy, kind=self.kind)

    def robot(self) -> Robot:
        return Robot(self.urdf, replace(Config().robot, base_frame=self.base))

    @property
    def R(self) -> np.ndarray:  # noqa: N802
        """The trunk in the root link (3, 3)."""
        return Rotation.from_euler("xyz", [float(x) for x in self.rpy.split()]).as_matrix()


TURNED = "0 0 3.141592653589793"
ROOTS = {
    "turned by 180 degrees": Root(TURNED),
    "its base frame": Root(TURNED, base="root_link"),
    "turned by 90 degrees, its base frame": Root("0 0 1.5707963267948966", base="root_link"),
    "a turned torso above a waist": Root("0 0 -2.0", "revolute"),
    "upside down": Root("3.141592653589793 0 0.5"),
}


@pytest.fixture(params=ROOTS.values(), ids=ROOTS.keys())
def root(request) -> Root:
    return request.param


# --- core ---

PUSHED = (("external_force", {"x": 5.0, "y": -3.0}), ("ground_slope", {"roll": 0.01, "pitch": -0.02}))
LOADED = (("payload", {"mass": 1.0, "x": 0.05, "z": 0.1}), ("com_offset", {"x": 0.01, "y": 0.02}))


@pytest.mark.parametrize("base", [PAPER, trunk_config()], ids=["point mass", "trunk"])
def test_predictions_do_not_depend_on_the_root_link(base, root):
    settings = base
    for name, values in (*PUSHED, *(LOADED if root.base == "base_link" else ())):
        settings = config(name, base=settings, **values)
    expected, _ = predicted(walk(1.0), settings)
    results, _ = predicted(walk(1.0), settings, root.robot())
    same(results, expected, 1e-9)
    measured = np.array([p.measured_tilt for p in results])
    np.testing.assert_allclose(measured, [p.measured_tilt for p in expected], atol=1e-12)


@pytest.mark.parametrize(("name", "values"), LOADED)
def test_loads_are_in_the_base_frame(name, values):
    root, at = ROOTS["turned by 90 degrees, its base frame"], np.array([values.get(axis, 0.0) for axis in "xyz"])
    there = root.R @ at + ([0.05, 0.02, -0.1] if name == "payload" else 0.0)  # a place, or a shift
    expected, _ = predicted(walk(1.0), config(name, **values))
    results, _ = predicted(walk(1.0), config(name, **{**values, **dict(zip("xyz", there, strict=True))}), root.robot())
    same(results, expected, 1e-9)


def channels(machine: Robot, frame: str, R: np.ndarray) -> dict[str, np.ndarray]:
    """What the monitor watches in the last phase of a walk, the trunk leaning by an IMU that sits in it as R (3, 3)."""
    pipeline = Pipeline(machine, Config().replaced({"prediction.horizons": []}))
    take = {
        JOINTS: pipeline.on_joint,
        MOTORS: pipeline.on_motor,
        **{stream: lambda message, foot=foot: pipeline.on_wrench(foot, message)
           for foot, stream in ((Foot.LEFT, LEFT), (Foot.RIGHT, RIGHT))},
    }  # fmt: skip
    found = []
    for stream, message in walk(2.6):
        if stream == JOINTS:
            lean = Rotation.from_euler("zyx", [0.4, 0.03, -0.02 * np.sin(1e-9 * (message.stamp_ns - T0))]).as_matrix()
            turned = Rotation.from_matrix(lean @ R).as_quat()
            pipeline.on_imu(ImuMessage(message.stamp_ns, frame, turned, np.zeros(3), np.array([0.0, 0.0, 9.81])))
        take[stream](message)
        laws = pipeline.monitor.laws
        if laws.looks > 10:
            found.append(laws.mean(0).values)
    return dict(zip(laws.names, np.array(found).T, strict=True))


@pytest.mark.slow
def test_what_the_monitor_watches_does_not_depend_on_the_root_link(root):
    expected, found = channels(robot(), "base_link", np.eye(3)), channels(root.robot(), "base_link", np.eye(3))
    assert {name for name, value in expected.items() if np.isfinite(value).any()} >= {"tilt/roll", "tilt/pitch"}
    for name, value in expected.items():
        np.testing.assert_allclose(found[name], value, atol=1e-8 * (1.0 + np.nanmax(np.abs(np.append(value, 0.0)))),
                                   err_msg=name)  # fmt: skip


def test_an_imu_that_the_urdf_lacks_sits_in_the_base_frame():
    machine = Root(TURNED, base="root_link").robot()
    known, lacking = (channels(machine, frame, np.eye(3)) for frame in ("root_link", "imu_that_nobody_drew"))
    for name, value in known.items():
        np.testing.assert_array_equal(lacking[name], value, err_msg=name)
    assert machine.sensor_frame("l_foot") is None  # behind the joints of a leg


# --- residuals of the diagnosis ---


def wandering() -> Recording:
    """Both soles turn against each other, in odom and with all joints; the numbers mean nothing."""
    recording, _ = standing()
    nj = len(robot().joint_names)
    q = 0.05 * np.sin(2.0 * np.pi * (0.4 + 0.1 * np.arange(nj)) * t[:, None] + np.arange(nj))
    phase = np.select([t < 1.3, t < 2.6], [Phase.LEFT, Phase.RIGHT], Phase.DOUBLE)
    return recording.changed(
        q=q, motor_q=q + recording.motor_q, phase=phase, yaw={foot: 0.3 * t + 0.2 * foot for foot in FEET},
        left_share=np.select([phase == Phase.LEFT, phase == Phase.RIGHT], [1.0, 0.0], 0.5),
        up=np.column_stack([0.02 * np.sin(t), 0.03 * np.cos(t), np.ones(len(t))]),
    )  # fmt: skip


def rerooted(recording: Recording, root: Root, machine: Robot) -> Recording:
    """The same of a robot with another root link, whose waist stands still."""
    order = [robot().joint_names.index(n) if n in robot().joint_names else -1 for n in machine.joint_names]

    def joints(values: np.ndarray) -> np.ndarray:
        return np.append(values, np.zeros((len(values), 1)), axis=1)[:, order]

    streams = {name: joints(getattr(recording, name)) for name in ("q", "tau", "motor_q")}
    return recording.changed(**streams, up=recording.up @ root.R.T, count=np.zeros(len(order)))


BELIEVED = {"pull": np.array([4.0, -3.0]), "slope": np.array([0.02, -0.03]), "tilting": 2e-4, "sinking": 1e-6,
            "softness": 1e-4}  # fmt: skip


def test_residuals_do_not_depend_on_the_root_link(root):
    machine = root.robot()
    ours, world = wandering(), standing()[1].changed(**BELIEVED)
    theirs = rerooted(ours, root, machine)
    other = World.nominal(machine, Config()).changed(**BELIEVED)
    expected = evaluate(ours, world, masks(ours, world)).residuals
    found = evaluate(theirs, other, masks(theirs, other)).residuals
    assert {"force/x", "moment/y", "tilt/roll", "tilt/pitch", "torque/LKneeSag"} <= set(expected)
    for name, value in expected.items():
        scale = 1.0 + np.nanmax(np.abs(np.append(value, 0.0)))
        np.testing.assert_allclose(found[name], value, rtol=0.0, atol=1e-8 * scale, err_msg=name)


def test_loads_that_are_found_are_those_of_the_model(root):
    """Each unknown of a load does to the diagnosis's robot what the effect of that value does to the predictor's."""
    machine = root.robot()
    recording = rerooted(wandering(), root, machine)
    world = World.nominal(machine, Config())
    known = {unknown.name: unknown for unknown in unknowns(recording, world)}

    def dynamic(model: pin.Model) -> np.ndarray:
        return np.array([inertia.toDynamicParameters()[:4] for inertia in model.inertias])  # mass and first moments

    for name, key, value in (("com_offset", "x", 0.02), ("com_offset", "y", -0.01), ("payload", "mass", 1.5)):
        found = known[f"{name}@.{key}"].apply(recording, world, value)[1].model
        expected = build_effects(config(name, **{key: value}).effects, machine)[1].model
        np.testing.assert_allclose(dynamic(found), dynamic(expected), atol=1e-12, err_msg=name)
    moment = known["payload@.x"].apply(*known["payload@.mass"].apply(recording, world, 1.5), 1.5 * 0.03)[1].model
    expected = build_effects(config("payload", mass=1.5, x=0.03).effects, machine)[1].model
    np.testing.assert_allclose(dynamic(moment), dynamic(expected), atol=1e-12)


# --- odom ---


def pulled(force: np.ndarray, yaw: dict[Foot, np.ndarray], toes: float = 0.0) -> Recording:
    """Standing straight, toes turned out, while something pulls at the trunk's COM by a force (2,) [N] along odom."""
    recording, world = standing()
    n, q = len(t), np.zeros(recording.q.shape)
    q[:, index("LHipYaw")], q[:, index("RHipYaw")] = toes, -toes
    posture, machine = robot().posture(), robot()
    posture.update(q[0], np.zeros(q.shape[1]))
    trunk = machine.model.inertias[1].lever
    wrench = {}
    for foot in FEET:
        R, p = posture.R[foot], posture.p[foot]
        level = Rotation.from_euler("z", -yaw[foot][0]).as_matrix() @ np.append(force, 0.0)  # along the sole
        weight = np.array([0.0, 0.0, -machine.mass * world.gravity])
        moment = np.cross(R.T @ (posture.com - p), weight) + np.cross(R.T @ (trunk - p), level)
        wrench[foot] = np.tile(np.concatenate([-0.5 * (level + weight), -0.5 * moment]), (n, 1))
    return recording.changed(q=q, wrench=wrench, yaw=yaw)


@pytest.mark.parametrize("toes", [0.0, 0.2])
@pytest.mark.parametrize("heading", [0.0, 1.2])
def test_a_pull_is_along_odom_whatever_way_the_robot_looks(heading, toes):
    """The first support sole is the left one, turned out by its toes."""
    yaw = {Foot.LEFT: np.full(len(t), heading), Foot.RIGHT: np.full(len(t), heading - 2.0 * toes)}
    recording, world = pulled(np.array([5.0, -2.0]), yaw, toes), standing()[1]
    where = masks(recording, world)
    without = evaluate(recording, world, where).residuals
    middle = Rotation.from_euler("z", toes - heading).as_matrix() @ [5.0, -2.0, 0.0]
    assert np.nanmean(without["force/x"]) == pytest.approx(-middle[0], abs=1e-6)  # along the middle of the soles
    assert np.nanmean(without["force/y"]) == pytest.approx(-middle[1], abs=1e-6)
    right = evaluate(recording, world.changed(pull=np.array([5.0, -2.0])), where).residuals
    for axis in "xyz":
        assert rms(right[f"force/{axis}"]) < 1e-6 and rms(right[f"moment/{axis}"]) < 1e-6


@pytest.mark.parametrize("axis", ["roll", "pitch"])
@pytest.mark.parametrize("heading", [0.0, 1.2])
def test_a_slope_is_about_the_axes_of_odom_whatever_way_the_robot_looks(heading, axis):
    recording, world = standing()
    slope = 0.02 * np.eye(2)[("roll", "pitch").index(axis)]
    down = np.array([np.sin(slope[1]), -np.sin(slope[0]), 0.0])  # in odom, as effects/ground_slope.py
    level = Rotation.from_euler("z", -heading).as_matrix() @ -down
    leaning = recording.changed(
        up=np.tile(level + [0.0, 0.0, np.cos(0.02)], (len(t), 1)),
        yaw={foot: np.full(len(t), heading) for foot in FEET},
    )
    where = masks(leaning, world)
    before, after = (evaluate(leaning, w, where).residuals for w in (world, world.changed(slope=slope)))
    size = np.hypot(*(np.nanmean(before[f"tilt/{each}"]) for each in ("roll", "pitch")))
    assert size == pytest.approx(np.sin(0.02), rel=1e-6)
    assert rms(after["tilt/roll"]) < 1e-5 and rms(after["tilt/pitch"]) < 1e-5


# --- walks with something hidden ---

SLOPE = np.radians(2.0)
HIDDEN = {"external_force": {"x": 5.0}, "ground_slope": {"pitch": SLOPE}}


@pytest.fixture(scope="session")
def walks(tmp_path_factory):
    """Walks of the virtual robot with an effect hidden, straight ahead and turning by a radian or more."""
    known: dict[tuple[str, str], str] = {}

    def call(effect: str, gait: str):
        if (effect, gait) not in known:
            folder = tmp_path_factory.mktemp("walks") / gait
            hidden = [make(effect, dict(HIDDEN[effect]))]
            record(gait, folder, disturbances=hidden, seed=5, duration_s=7.0 if gait == "test1" else 13.0)
            known[effect, gait] = folder
        return known[effect, gait]

    return call


@pytest.mark.slow
def test_a_recording_is_the_same_whatever_the_root_link(walks, tmp_path):
    root, urdf = ROOTS["a turned torso above a waist"], tmp_path / "robot.urdf"
    urdf.write_text(root.urdf)
    bag = walks("external_force", "turn")
    (ours, _), (theirs, _) = (load(bag, Config(), path) for path in (None, urdf))
    np.testing.assert_allclose(theirs.up, ours.up @ root.R.T, atol=1e-9)
    for foot in FEET:
        np.testing.assert_allclose(theirs.yaw[foot], ours.yaw[foot], atol=1e-9)


@pytest.mark.slow
def test_odom_of_the_diagnosis_is_that_of_the_predictor(walks):
    bag = walks("external_force", "turn")
    recording, _ = load(bag, Config())
    with Session(bag, Config()) as session:
        run = list(session.predictions())
    yaw = np.array([np.arctan2(p.T_odom_sole[1, 0], p.T_odom_sole[0, 0]) for p in run])
    at = 1e-9 * (np.array([p.stamp_ns for p in run]) - run[0].stamp_ns)
    feet = np.array([p.support.support_foot for p in run])
    assert np.ptp(yaw) > 1.0
    near = np.searchsorted(at, recording.t).clip(0, len(at) - 1)
    found = np.where(feet[near] == Foot.LEFT, recording.yaw[Foot.LEFT], recording.yaw[Foot.RIGHT])
    # A grid point may lie on the other side of a change of support than its sample.
    assert np.mean(np.abs(found - yaw[near]) > 0.003) < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("effect", list(HIDDEN))
@pytest.mark.parametrize(
    ("gait", "root"),
    [
        ("test1", ROOTS["turned by 90 degrees, its base frame"]),
        ("turn", None),
    ],
    ids=["another base frame", "turning gait"],
)
def test_what_was_hidden_comes_back_and_makes_the_prediction_better(effect, gait, root, walks, tmp_path):
    settings, urdf = Config(), None
    if root is not None:
        settings, urdf = settings.replaced({"robot.base_frame": root.base}), tmp_path / "robot.urdf"
        urdf.write_text(root.urdf)
    found = diagnose([walks(effect, gait)], [], settings, urdf=urdf, assume=[effect], second_process=False)
    (entry,) = found.result["effects"]
    value = {key: each["value"] for key, each in entry["parameters"].items()}
    if effect == "external_force":
        assert value.get("x", 0.0) == pytest.approx(5.0, abs=0.8) and abs(value.get("y", 0.0)) < 0.8
    else:
        assert value.get("pitch", 0.0) == pytest.approx(SLOPE, abs=0.006) and abs(value.get("roll", 0.0)) < 0.006
    gap = found.result["gap"]["train"]
    assert gap["after"]["com/x"] < 0.5 * gap["before"]["com/x"]
    assert gap["after"]["com/y"] < 1.1 * gap["before"]["com/y"]
