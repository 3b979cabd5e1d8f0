# SPDX-License-Identifier: BSD-3-Clause
"""`coman export`: a MuJoCo model with what was found in it walks more like the recording than the one before."""

from __future__ import annotations

import json

import mujoco
import numpy as np
import pytest
from sim_runs import Run

from coman_reduced_model.cli.main import run
from coman_reduced_model.core.config.files import save_config
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.sim.describe import mujoco_spec
from coman_reduced_model.sim.robot_table import COMAN

SECONDS = 2.5
HIDDEN = "joint_stiffness:scale=0.7+payload:mass=1.5,x=0.03,z=0.1+joint_friction:coulomb=1.0"
FOUND = {
    "effects.active": ["joint_stiffness", "payload", "joint_friction"],
    "effects.joint_stiffness.scale": [0.7],
    "effects.payload.mass": [1.5],
    "effects.payload.x": [0.03],
    "effects.payload.z": [0.1],
    "effects.joint_friction.coulomb": [1.0],
}


@pytest.fixture
def mjcf(tmp_path):
    """The virtual robot's own model, as a user's."""
    spec = mujoco_spec(COMAN)
    spec.compile()
    path = tmp_path / "robot.xml"
    path.write_text(spec.to_xml(), encoding="utf-8")
    return path


def export(tmp_path, mjcf, capsys, **changes):
    """The changed model and what the command says of it."""
    config = save_config(Config().replaced(changes), tmp_path / "model.yaml", force=True)
    out = tmp_path / "found.xml"
    assert run(["export", str(config), "--mjcf", str(mjcf), "--out", str(out), "--force", "--json"]) == 0
    return out, json.loads(capsys.readouterr().out)


def joints(path, motion, seconds):
    """Link positions (n, 12) [rad] at 200 Hz of a model from a file, whose motors follow a motion."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    start, dt = motion.start, model.opt.timestep
    data.qpos[:3] = start.base[0]
    order = [int(model.joint(name).qposadr[0]) for name in COMAN.joint_names]
    data.qpos[order] = start.q[0]
    lead = -model.actuator_biasprm[:, 2] / model.actuator_gainprm[:, 0]
    times = dt * np.arange(round(seconds / dt))
    standing, walking = np.zeros(round(1.0 / dt)), times  # as the virtual robot: it comes to rest first
    found = []
    for t in (standing, walking):
        theta, rate = motion(t)
        ctrl = theta + lead * (rate if t is walking else 0.0 * rate)
        for i, each in enumerate(ctrl):
            if t is walking and i % round(0.005 / dt) == 0:
                found.append(data.qpos[order].copy())
            data.ctrl[:] = each
            mujoco.mj_step(model, data)
    return np.array(found)


def test_the_simulation_comes_closer_to_the_recording(tmp_path, mjcf, capsys, walking):
    recorded = Run(walking, SECONDS, HIDDEN).truth("q")
    out, said = export(tmp_path, mjcf, capsys, **FOUND)
    before, after = (
        1e3 * np.sqrt(np.mean((joints(path, walking, SECONDS)[: len(recorded)] - recorded) ** 2))
        for path in (mjcf, out)
    )
    # [mrad]; 7.7 and 1.6 when this was written: what is left is the friction, which creeps otherwise in either.
    assert after < 0.3 * before
    assert any("LKneeSag: stiffness 126" in line for line in said["written"])
    assert any("base_link: mass" in line for line in said["written"])


def test_a_servo_of_velocity_and_what_is_welded_to_a_body_stay_as_they_are(tmp_path, mjcf, capsys):
    spec = mujoco.MjSpec.from_file(str(mjcf))
    knee = spec.joint("LKneeSag")
    (servo,) = [each for each in spec.actuators if each.target == knee.name]
    servo.biasprm[1:3] = 0.0, -servo.gainprm[0]
    knee.parent.add_body(name="pad").add_geom(size=[0.02, 0.02, 0.02], mass=0.5)
    mjcf.write_text(spec.to_xml(), encoding="utf-8")
    changes = {
        "effects.active": ["body_mass"],
        "effects.body_mass.where": ["LKneeSag"],
        "effects.body_mass.scale": [2.0],
    }
    _, said = export(tmp_path, mjcf, capsys, **changes)
    assert any("LKneeSag: stiffness and damping: its actuator is no position" in line for line in said["left_out"])
    assert any(line.startswith("body_mass: pad: fixed to") for line in said["left_out"])


def test_what_mujoco_cannot_express_is_said(tmp_path, mjcf, capsys):
    changes = {
        "effects.active": [
            "backlash",
            "wrench_bias",
            "motor_lag",
            "com_offset",
            "ground_compliance",
            "body_mass",
            "hysteresis",
        ],
        "effects.backlash.where": ["LKneeSag"],
        "effects.backlash.width": [0.01],
        "effects.body_mass.where": ["LKneeSag"],
        "effects.body_mass.scale": [1.5],
        "effects.motor_lag.time_constant": [0.01],
        "effects.com_offset.x": [0.01],
        "effects.ground_compliance.vertical": [1e-5],
        "effects.ground_compliance.rotational": [1e-3],
        "model.friction": 0.5,
    }
    out, said = export(tmp_path, mjcf, capsys, **changes)
    names = [line.split(":")[0] for line in said["left_out"]]
    assert sorted(names) == sorted([*2 * ["ground_compliance"], "backlash", "wrench_bias", "hysteresis", "armature"])
    before, after = (mujoco.MjModel.from_xml_path(str(path)) for path in (mjcf, out))
    trunk = before.body("base_link").id
    np.testing.assert_allclose(after.body_ipos[trunk] - before.body_ipos[trunk], [0.01, 0.0, 0.0], atol=1e-9)
    shank = before.joint("LKneeSag").bodyid[0]
    assert after.body_mass[shank] == pytest.approx(1.5 * before.body_mass[shank], rel=1e-5)
    np.testing.assert_allclose(after.actuator_dynprm[:, 0], 0.01)
    assert after.geom("l_foot").friction[0] == 0.5 and before.geom("l_foot").friction[0] != 0.5


@pytest.mark.parametrize("order", [1, -1])
def test_effects_act_in_the_order_of_the_catalogue(tmp_path, mjcf, capsys, order):
    """Not of the file: the drives are in series with the spring that it has in the end."""
    changes = {
        "effects.active": ["joint_stiffness", "motor_compliance"][::order],
        "effects.joint_stiffness.scale": [0.5],
        "effects.motor_compliance.compliance": [0.01],
    }
    out, _ = export(tmp_path, mjcf, capsys, **changes)
    config, model = Config(), mujoco.MjModel.from_xml_path(str(out))
    spring = 0.5 * config.robot.left.stiffness[config.robot.left.joints.index("LKneeSag")]
    knee = next(i for i in range(model.nu) if model.actuator_trnid[i, 0] == model.joint("LKneeSag").id)
    assert model.actuator_gainprm[knee, 0] == pytest.approx(spring / (1.0 + 0.01 * spring), rel=1e-4)


def test_the_com_of_a_trunk_moves_with_all_that_is_fixed_to_it(tmp_path, mjcf, capsys):
    spec = mujoco.MjSpec.from_file(str(mjcf))
    trunk = spec.body("base_link")
    half = float(np.sqrt(0.5))  # a quarter turn about z
    torso = trunk.add_body(name="torso", pos=[0.0, 0.0, 0.3], quat=[half, 0.0, 0.0, half])
    torso.add_geom(size=[0.05, 0.05, 0.05], mass=4.0)
    mjcf.write_text(spec.to_xml(), encoding="utf-8")
    changes = {"effects.active": ["com_offset"], "effects.com_offset.x": [0.01]}
    out, _ = export(tmp_path, mjcf, capsys, **changes)

    before, after = (mujoco.MjModel.from_xml_path(str(path)) for path in (mjcf, out))
    for name, moved in (("base_link", [0.01, 0.0, 0.0]), ("torso", [0.0, -0.01, 0.0])):
        np.testing.assert_allclose(after.body(name).ipos - before.body(name).ipos, moved, atol=1e-6)
        np.testing.assert_allclose(*(np.sort(each.body(name).inertia) for each in (after, before)), rtol=1e-4)


def test_soles_without_names_give_way(tmp_path, mjcf, capsys):
    spec = mujoco.MjSpec.from_file(str(mjcf))
    for joint in ("LAnkLat", "RAnkLat"):
        spec.joint(joint).parent.name = ""
    mjcf.write_text(spec.to_xml(), encoding="utf-8")
    changes = {"effects.active": ["ground_compliance"], "effects.ground_compliance.vertical": [2e-5]}
    _, said = export(tmp_path, mjcf, capsys, **changes)
    assert sum("gives way by" in line for line in said["written"]) == 2


def test_soles_give_way_as_found(tmp_path, mjcf, capsys):
    """Standing on both feet, each carries half of the weight."""
    compliance = 2e-5
    changes = {"effects.active": ["ground_compliance"], "effects.ground_compliance.vertical": [compliance]}
    out, _ = export(tmp_path, mjcf, capsys, **changes)
    model = mujoco.MjModel.from_xml_path(str(out))
    data = mujoco.MjData(model)
    lowest = data.geom_xpos
    for _ in range(round(1.5 / model.opt.timestep)):
        mujoco.mj_step(model, data)
    foot = model.geom("l_foot")
    depth = foot.size[2] - lowest[foot.id][2]
    weight = 9.81 * model.body_subtreemass[0]
    assert depth == pytest.approx(0.5 * compliance * weight, rel=0.3)


@pytest.mark.parametrize("folder", ["assets", ""])
def test_a_model_that_is_written_elsewhere_finds_its_meshes(tmp_path, mjcf, capsys, folder):
    spec = mujoco.MjSpec.from_file(str(mjcf))
    spec.meshdir = folder
    (tmp_path / folder).mkdir(exist_ok=True)
    (tmp_path / folder / "head.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n"
    )
    spec.add_mesh(name="head", file="head.obj")
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="head", contype=0, conaffinity=0)
    mjcf.write_text(spec.to_xml(), encoding="utf-8")
    out, config = tmp_path / "found" / "robot.xml", save_config(Config(), tmp_path / "model.yaml")
    out.parent.mkdir()
    assert run(["export", str(config), "--mjcf", str(mjcf), "--out", str(out)]) == 0
    assert mujoco.MjModel.from_xml_path(str(out)).nmesh == 1


@pytest.mark.parametrize(
    ("text", "words"),
    [("<mujoco/>", "no joint 'LHipSag'"), ("<robot", "not a model"), (None, "no such file")],
)
def test_a_file_that_cannot_be_used_is_refused_in_one_line(tmp_path, capsys, text, words):
    path = tmp_path / "robot.xml"
    if text is not None:
        path.write_text(text)
    config = save_config(Config(), tmp_path / "model.yaml")
    assert run(["export", str(config), "--mjcf", str(path), "--out", str(tmp_path / "out.xml")]) == 2
    err = capsys.readouterr().err
    assert words in err and len(err.strip().splitlines()) == 1 and not (tmp_path / "out.xml").exists()
