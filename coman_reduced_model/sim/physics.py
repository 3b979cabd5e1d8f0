# SPDX-License-Identifier: BSD-3-Clause
"""Physics steps of the virtual robot, compiled: motors, springs, and what the sensors will read of a step.

It takes MuJoCo's data as arrays that share its memory, and calls MuJoCo by the addresses of its functions.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np

from ..core.base.compiled import compiled
from ..core.base.types import Array, Integers
from .native import addresses, call
from .spring_laws import SpringLaws, add_torques

JOINTS, LEFT, RIGHT, IMU = range(4)  # streams that are sampled, each at its step of the period
_STEP, _REACTIONS, _SUBTREES, _VELOCITY, _ACCELERATION = range(5)  # of native.FUNCTIONS
_SITE = int(mujoco.mjtObj.mjOBJ_SITE)


class Body(NamedTuple):
    """MuJoCo's robot: views of its data, and where the joints of the robot (nj) are in them."""

    functions: Integers  # addresses, see native.FUNCTIONS
    model: int  # address
    data: int  # address
    qpos: Array
    qvel: Array
    ctrl: Array  # (nj,)
    actuator_force: Array  # (nj,)
    qfrc_applied: Array
    cfrc_ext: Array  # (bodies, 6) moment about the COM of the robot, force
    subtree_com: Array  # (bodies, 3)
    subtree_linvel: Array  # (bodies, 3)
    site_xpos: Array  # (sites, 3)
    site_xmat: Array  # (sites, 9)
    root: int  # body
    sites: Integers  # (3,) left sole, right sole, IMU
    q: Integers  # (nj,) in qpos
    v: Integers  # (nj,) in qvel
    stiffness: Array  # (nj,) [Nm/rad]
    damping: Array  # (nj,) [Nms/rad]
    lead: Array  # (nj,) [s] damping over stiffness
    dt: float  # [s]

    @classmethod
    def of(cls, model: mujoco.MjModel, data: mujoco.MjData, joints: Sequence[str]) -> Body:
        """The robot with these joints, in the order of its actuators."""
        found = [model.joint(name) for name in joints]
        q, v = (np.array([int(getattr(j, at)[0]) for j in found], dtype=np.int64) for at in ("qposadr", "dofadr"))
        stiffness, damping = model.actuator_gainprm[:, 0].copy(), -model.actuator_biasprm[:, 2]
        return cls(
            functions=addresses(),
            model=model._address,  # noqa: SLF001
            data=data._address,  # noqa: SLF001
            qpos=data.qpos,
            qvel=data.qvel,
            ctrl=data.ctrl,
            actuator_force=data.actuator_force,
            qfrc_applied=data.qfrc_applied,
            cfrc_ext=data.cfrc_ext,
            subtree_com=data.subtree_com,
            subtree_linvel=data.subtree_linvel,
            site_xpos=data.site_xpos,
            site_xmat=data.site_xmat,
            root=model.body("base_link").id,
            sites=np.array([model.site(name).id for name in ("l_sole", "r_sole", "imu_link")], dtype=np.int64),
            q=q,
            v=v,
            stiffness=stiffness,
            damping=damping,
            lead=damping / stiffness,
            dt=model.opt.timestep,
        )


class Drive(NamedTuple):
    """What moves the joints in a period of n steps, and what of it lasts."""

    theta: Array  # (n, nj) [rad] references of the motors
    rate: Array  # (n, nj) [rad/s]
    law: Integers  # springs that are not linear, see SpringLaws
    since: Array
    values: Array
    loop: Array  # inertia, kp, kd of the motors' position loops; empty: motors follow exactly
    motor: Array  # (2, nj) their positions [rad] and rates [rad/s]
    extra: Array  # (nj,) [Nm] torque of `law` in the last step
    history: Array  # (n, nj) [rad] joint positions before each step

    @classmethod
    def of(cls, steps: int, joints: int, laws: SpringLaws, loop: Sequence[float] = ()) -> Drive:
        """At rest at zero."""
        zeros = (np.zeros((steps, joints)) for _ in range(3))
        theta, rate, history = zeros
        lasting = np.array(loop, dtype=float), np.zeros((2, joints)), np.zeros(joints)
        return cls(theta, rate, laws.law, laws.since, laws.values, *lasting, history)


class Sampled(NamedTuple):
    """What is sampled in a period, each stream at its own step; positions and velocities before that step."""

    at: Integers  # (4,) step of each stream; -1: never
    before: Array  # (qpos and qvel,) the state before the last step that was sampled
    ground: Array  # (2, 6) of the ground on each foot: moment about `about`, force, in the world
    about: Array  # (3,) [m]
    # With the joints, also for the truth:
    qd: Array  # (nj,) [rad/s]
    tau: Array  # (nj,) [Nm] that the transmissions pass on
    motor: Array  # (2, nj) [rad, rad/s]
    com: Array  # (2, 3) [m, m/s]
    base: Array  # (7,) position, quaternion x y z w
    soles: Array  # (2, 4, 4)
    wrenches: Array  # (2, 6) of the ground on each foot, force and moment at its sole frame
    # With their own streams:
    felt: Array  # (2, 6) of the step that is sampled, or the mean of all since the last one
    average: bool  # of the two
    sums: Array  # (2, 6) since the last sample of each foot
    steps: Integers  # (2,) of them
    orientation: Array  # (4,) quaternion x y z w, world <- base
    motion: Array  # (2, 6) of the IMU in its frame: rotational and linear velocity; acceleration

    @classmethod
    def of(cls, body: Body, average: bool) -> Sampled:
        """Nothing yet."""
        nj, zeros = len(body.q), np.zeros
        return cls(
            at=np.full(4, -1),
            before=zeros(len(body.qpos) + len(body.qvel)),
            ground=zeros((2, 6)),
            about=zeros(3),
            qd=zeros(nj),
            tau=zeros(nj),
            motor=zeros((2, nj)),
            com=zeros((2, 3)),
            base=zeros(7),
            soles=np.tile(np.eye(4), (2, 1, 1)),
            wrenches=zeros((2, 6)),
            felt=zeros((2, 6)),
            average=average,
            sums=zeros((2, 6)),
            steps=np.zeros(2, dtype=np.int64),
            orientation=zeros(4),
            motion=zeros((2, 6)),
        )


@compiled
def begin_step(i: int, t: float, body: Body, drive: Drive, sampled: Sampled, forced: bool) -> bool:
    """Before step i of a period, at time t [s]: motors and springs; whether anything is sampled.

    Forced: outside forces are in `qfrc_applied`, and what springs do beside is added to them.
    """
    nj = len(body.q)
    sample = sampled.average
    for stream in range(4):
        sample |= sampled.at[stream] == i
    if sample:
        _copy(sampled.before, 0, body.qpos)
        _copy(sampled.before, len(body.qpos), body.qvel)
    slow = len(drive.law) > 0 or len(drive.loop) > 0
    deflection, rate = np.empty(nj), np.empty(nj)
    if len(drive.loop) == 0:
        _copy(drive.motor[0], 0, drive.theta[i])
        _copy(drive.motor[1], 0, drive.rate[i])
    if sampled.at[JOINTS] == i:
        for k in range(2):
            _copy(sampled.motor[k], 0, drive.motor[k])
    for j in range(nj):
        q, qd = body.qpos[body.q[j]], body.qvel[body.v[j]]
        drive.history[i, j] = q
        drive.extra[j] = 0.0
        deflection[j], rate[j] = drive.motor[0, j] - q, drive.motor[1, j] - qd
        body.ctrl[j] = drive.motor[0, j] + body.lead[j] * drive.motor[1, j]
    if slow:
        add_torques(drive.extra, drive.law, drive.since, drive.values, t, deflection, rate)
        for j in range(nj):
            base = body.qfrc_applied[body.v[j]] if forced else 0.0
            body.qfrc_applied[body.v[j]] = base + drive.extra[j]
    if len(drive.loop) > 0:
        _move_motors(i, body, drive, deflection, rate)
    return sample


@compiled
def _move_motors(i: int, body: Body, drive: Drive, deflection: Array, rate: Array) -> None:
    """A semi-implicit Euler step of motors with inertia, under the load of their springs: equation (1)."""
    inertia, kp, kd = drive.loop[0], drive.loop[1], drive.loop[2]
    theta, speed = drive.motor[0], drive.motor[1]
    for j in range(len(theta)):
        load = body.stiffness[j] * deflection[j] + body.damping[j] * rate[j] + drive.extra[j]
        torque = kp * (drive.theta[i, j] - theta[j]) + kd * (drive.rate[i, j] - speed[j])
        speed[j] += body.dt / inertia * (torque - load)
        theta[j] += body.dt * speed[j]


@compiled
def end_step(i: int, body: Body, drive: Drive, sampled: Sampled) -> None:
    """After a step that is sampled: poses and forces in MuJoCo's data are those of the state before it."""
    if sampled.at[JOINTS] == i:
        _sample_joints(body, drive, sampled)
    for foot in range(2):
        _feel(foot, i, body, sampled)
    if sampled.at[IMU] == i:
        for k in range(4):
            sampled.orientation[k] = sampled.before[4 + k] if k < 3 else sampled.before[3]
        for k in range(2):
            out = sampled.motion[k].ctypes.data
            site = (body.model, body.data, _SITE, body.sites[2], np.int64(out), 1)
            call(body.functions[_VELOCITY + k], site)


@compiled
def _feel(foot: int, i: int, body: Body, sampled: Sampled) -> None:
    """What the force sensor of a foot makes of a step."""
    sample, felt = sampled.at[LEFT + foot] == i, sampled.felt[foot]
    if sampled.average:
        now, total = np.empty(6), sampled.sums[foot]
        _ground_wrench(now, foot, body, sampled)
        total += now
        sampled.steps[foot] += 1
        if sample:
            _copy(felt, 0, total / sampled.steps[foot])
            total[:] = 0.0
            sampled.steps[foot] = 0
    elif sample:
        _ground_wrench(felt, foot, body, sampled)


@compiled
def _sample_joints(body: Body, drive: Drive, sampled: Sampled) -> None:
    for j in range(len(body.q)):
        v = body.v[j]
        qd = sampled.before[len(body.qpos) + v]
        sampled.qd[j] = qd
        # The integrator damps with the velocity after the step: this is the torque that it has applied.
        sampled.tau[j] = body.actuator_force[j] - body.damping[j] * (body.qvel[v] - qd) + drive.extra[j]
    call(body.functions[_SUBTREES], (body.model, body.data))
    _copy(sampled.com[0], 0, body.subtree_com[0])
    _copy(sampled.com[1], 0, body.subtree_linvel[0])
    for k in range(3):
        sampled.base[k], sampled.base[3 + k] = sampled.before[k], sampled.before[4 + k]
    sampled.base[6] = sampled.before[3]
    for foot in range(2):
        site = body.sites[foot]
        for row in range(3):
            for k in range(3):
                sampled.soles[foot, row, k] = body.site_xmat[site, 3 * row + k]
            sampled.soles[foot, row, 3] = body.site_xpos[site, row]
        _ground_wrench(sampled.wrenches[foot], foot, body, sampled)


@compiled
def _ground_wrench(out: Array, foot: int, body: Body, sampled: Sampled) -> None:
    """Force and moment (6,) of the ground on a foot, in and about its sole frame."""
    site = body.sites[foot]
    g = sampled.ground[foot]
    mx, my, mz, fx, fy, fz = g[0], g[1], g[2], g[3], g[4], g[5]
    about, at, R = sampled.about, body.site_xpos[site], body.site_xmat[site]
    x, y, z = about[0] - at[0], about[1] - at[1], about[2] - at[2]
    mx, my, mz = mx + (y * fz - z * fy), my + (z * fx - x * fz), mz + (x * fy - y * fx)
    for k in range(3):
        out[k] = fx * R[k] + fy * R[3 + k] + fz * R[6 + k]
        out[3 + k] = mx * R[k] + my * R[3 + k] + mz * R[6 + k]


@compiled
def mujoco_steps(
    first: int, last: int, t: float, body: Body, drive: Drive, sampled: Sampled, feet: Integers, forced: bool
) -> None:
    """Steps first to last - 1 of a period with MuJoCo; t [s] of step 0, bodies of each foot (2, k), -1: none."""
    robot = (body.model, body.data)
    for i in range(first, last):
        sample = begin_step(i, t + i * body.dt, body, drive, sampled, forced)
        call(body.functions[_STEP], robot)
        if sample:
            call(body.functions[_REACTIONS], robot)
            _copy(sampled.about, 0, body.subtree_com[body.root])
            _read_ground(body, sampled, feet)
            end_step(i, body, drive, sampled)


@compiled
def _read_ground(body: Body, sampled: Sampled, feet: Integers) -> None:
    for foot in range(2):
        for k in range(6):
            total = 0.0
            for b in feet[foot]:
                if b >= 0:
                    total += body.cfrc_ext[b, k]
            sampled.ground[foot, k] = total


@compiled
def _copy(out: Array, first: int, values: Array) -> None:
    for k in range(len(values)):
        out[first + k] = values[k]
