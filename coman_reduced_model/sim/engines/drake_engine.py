# SPDX-License-Identifier: BSD-3-Clause
"""Drake: rigid soles on a compliant floor (hydroelastic contact), a discrete plant solved by SAP.

The plant is built from the bodies and joints of MuJoCo's model, and shares nothing else with it: dynamics, contact and
integration are Drake's. Springs act as generalised forces; all dampers of joints are implicit.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import mujoco
import numpy as np
from pydrake.geometry import (
    AddCompliantHydroelasticProperties,
    AddCompliantHydroelasticPropertiesForHalfSpace,
    AddContactMaterial,
    AddRigidHydroelasticProperties,
    Box,
    HalfSpace,
    ProximityProperties,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    ContactModel,
    CoulombFriction,
    DiscreteContactApproximation,
)
from pydrake.multibody.tree import FixedOffsetFrame, PrismaticJoint, RevoluteJoint, RotationalInertia, SpatialInertia
from pydrake.systems.framework import DiagramBuilder
from scipy.spatial.transform import Rotation

from ...core.base.types import Array
from ...errors import ConfigError, EngineError
from ..contact import Contact
from ..physics import Body, Drive, Sampled, begin_step, end_step
from ..sensors import cross

logging.getLogger("drake").setLevel(logging.ERROR)  # it warns of half spaces and deformable bodies
SLAB_M = 0.01  # [m] thickness of the compliant layer of the floor: pressure = modulus * depth / thickness
SUNK_M = 1e-6  # [m] soles begin in the floor: exactly on it, Drake 1.51 may fail to cut the surfaces
BRISTLE = 1e-4  # [rad] within which dry friction holds like a spring
_CONJUGATE = np.array([1.0, -1.0, -1.0, -1.0])
_HINGE, _SLIDE = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE


def _turned(quaternion: Array, vector: Array) -> Array:
    """A vector (3,) turned by a unit quaternion w, x, y, z."""
    out = np.empty(3)
    mujoco.mju_rotVecQuat(out, vector, quaternion)
    return out


@contextmanager
def _failures() -> Iterator[None]:
    """Drake's failures, in one line.

    Raises:
        EngineError: Drake cannot go on.
    """
    try:
        yield
    except RuntimeError as error:
        raise EngineError(f"engine: drake cannot go on: {str(error).splitlines()[0]}") from None


class DrakeEngine:
    """See Engine."""

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, feet: Sequence[Sequence[int]], contact: Contact
    ) -> None:
        """See make_engine.

        Raises:
            ConfigError: the model has constraints that are not built here.
        """
        if model.neq:
            raise ConfigError("engine: drake: no clamped joints (allowed: mujoco)")
        self._model, self._data, self._dt = model, data, model.opt.timestep
        self._damping = model.dof_damping.copy()
        for i in range(model.nu):
            self._damping[self._dof(model.actuator_trnid[i, 0])] -= model.actuator_biasprm[i, 2]
        builder = DiagramBuilder()
        self._plant, _ = AddMultibodyPlantSceneGraph(builder, self._dt)
        plant = self._plant
        plant.set_discrete_contact_approximation(DiscreteContactApproximation.kLagged)
        plant.set_contact_model(ContactModel.kHydroelasticWithFallback)
        plant.SetUseSampledOutputPorts(False)  # outputs are those of the step that is taken
        plant.mutable_gravity_field().set_gravity_vector(model.opt.gravity)
        self._joints: list[tuple[Any, int]] = []  # Drake's joint, MuJoCo's joint
        self._body_of: dict[Any, int] = {}  # by geometry
        touching = [g for g in range(model.ngeom) if model.geom_contype[g]]
        self._tiled = sum(model.geom_bodyid[g] == 0 for g in touching) > 1
        bodies = [plant.world_body()]
        self._add_geometries([g for g in touching if model.geom_bodyid[g] == 0], bodies, contact)
        for b in range(1, model.nbody):
            bodies.append(self._add_body(b, bodies[model.body_parentid[b]]))
        self._foot_of = {int(bodies[b].index()): k for k, group in enumerate(feet) for b in group}
        self._add_geometries([g for g in touching if model.geom_bodyid[g]], bodies, contact)
        plant.Finalize()
        self._diagram = builder.Build()
        self._context = self._diagram.CreateDefaultContext()
        self._own = plant.GetMyMutableContextFromRoot(self._context)
        self._results = plant.get_contact_results_output_port()
        self._force = plant.get_applied_generalized_force_input_port()
        self._find_states(bodies[1])
        self._slip = np.zeros(model.nv)
        self._wrenches = np.zeros((2, 6))

    # --- the plant ---

    def _dof(self, joint: int) -> int:
        return int(self._model.jnt_dofadr[joint])

    def _add_body(self, b: int, parent: Any) -> Any:
        """A body with its joints; several joints of one body hang on bodies without mass between them."""
        model, plant = self._model, self._plant
        name = model.body(b).name
        R = Rotation.from_quat(model.body_iquat[b], scalar_first=True).as_matrix()
        central = R @ np.diag(model.body_inertia[b]) @ R.T
        inertia = RotationalInertia(
            central[0, 0], central[1, 1], central[2, 2], central[0, 1], central[0, 2], central[1, 2]
        )
        whole = SpatialInertia.MakeFromCentralInertia(model.body_mass[b], model.body_ipos[b], inertia)
        turn = RotationMatrix(Rotation.from_quat(model.body_quat[b], scalar_first=True).as_matrix())
        place = RigidTransform(turn, model.body_pos[b])
        first, count = int(model.body_jntadr[b]), int(model.body_jntnum[b])
        joints = [first + k for k in range(count)]
        if not joints:
            body = plant.AddRigidBody(name, whole)
            plant.WeldFrames(parent.body_frame(), body.body_frame(), place)
            return body
        if model.jnt_type[first] == mujoco.mjtJoint.mjJNT_FREE:
            return plant.AddRigidBody(name, whole)
        for k, joint in enumerate(joints):
            last = k == count - 1
            body = plant.AddRigidBody(name if last else f"{name}_{k}", whole if last else SpatialInertia.Zero())
            self._add_joint(joint, f"{name}_{k}", parent, place if k == 0 else RigidTransform(), body)
            parent = body
        return body

    def _add_joint(self, joint: int, name: str, parent: Any, place: RigidTransform, child: Any) -> None:
        model, plant = self._model, self._plant
        kinds = {_HINGE: RevoluteJoint, _SLIDE: PrismaticJoint}
        kind = kinds.get(mujoco.mjtJoint(model.jnt_type[joint]))
        if kind is None or np.any(model.jnt_pos[joint]):
            raise ConfigError(f"engine: drake: {model.joint(joint).name!r}: allowed: hinges and slides at the origin")
        frame = plant.AddFrame(FixedOffsetFrame(f"{name}_base", parent.body_frame(), place))
        dof = self._dof(joint)
        made = plant.AddJoint(
            kind(f"{name}_joint", frame, child.body_frame(), model.jnt_axis[joint], damping=float(self._damping[dof]))
        )
        if model.dof_armature[dof] > 0.0:
            actuator = plant.AddJointActuator(f"{name}_rotor", made)
            actuator.set_default_rotor_inertia(float(model.dof_armature[dof]))
            actuator.set_default_gear_ratio(1.0)
        self._joints.append((made, joint))

    def _add_geometries(self, geometries: Sequence[int], bodies: Sequence[Any], contact: Contact) -> None:
        for g in geometries:
            self._add_geometry(g, bodies[self._model.geom_bodyid[g]], contact)

    def _add_geometry(self, g: int, body: Any, contact: Contact) -> None:
        """Soles are rigid; the floor and its tiles give way."""
        model, properties = self._model, ProximityProperties()
        shape: Any
        mu = float(model.geom_friction[g, 0])
        AddContactMaterial(contact.dissipation, None, CoulombFriction(mu, mu), properties)
        turn = RotationMatrix(Rotation.from_quat(model.geom_quat[g], scalar_first=True).as_matrix())
        place, size = RigidTransform(turn, model.geom_pos[g]), 2.0 * model.geom_size[g]
        if model.geom_type[g] == mujoco.mjtGeom.mjGEOM_PLANE and self._tiled:
            # Drake 1.51 does not survive a half space beside some two hundred boxes: a large box.
            size, place = np.array([20.0, 20.0, 0.1]), RigidTransform(turn, model.geom_pos[g] - [0.0, 0.0, 0.05])
        if model.geom_type[g] == mujoco.mjtGeom.mjGEOM_PLANE and not self._tiled:
            AddCompliantHydroelasticPropertiesForHalfSpace(SLAB_M, contact.modulus, properties)
            shape = HalfSpace()
        elif body.index() == self._plant.world_body().index():
            # The pressure in a box grows from its surface to its middle.
            AddCompliantHydroelasticProperties(1.0, contact.modulus * 0.5 * float(size.min()) / SLAB_M, properties)
            shape = Box(*size)
        else:
            AddRigidHydroelasticProperties(1.0, properties)
            shape = Box(*size)
        geometry = self._plant.RegisterCollisionGeometry(body, place, shape, f"geom_{g}", properties)
        self._body_of[geometry] = int(body.index())

    def _find_states(self, base: Any) -> None:
        """Where each of MuJoCo's coordinates is in Drake's."""
        model = self._model
        self._base_q = base.floating_positions_start()
        self._base_v = base.floating_velocities_start_in_v()
        self._q = np.array([joint.position_start() for joint, _ in self._joints])
        self._v = np.array([joint.velocity_start() for joint, _ in self._joints])
        self._mj_q = np.array([int(model.jnt_qposadr[j]) for _, j in self._joints])
        self._mj_v = np.array([self._dof(j) for _, j in self._joints])
        self._stiffness = np.array([float(np.max(model.jnt_stiffness[j])) for _, j in self._joints])
        self._friction = model.dof_frictionloss[self._mj_v]
        self._nq = self._plant.num_positions()
        self._nv = self._plant.num_velocities()
        self._driven = np.array([self._dof(model.actuator_trnid[i, 0]) for i in range(model.nu)])
        self._driven_q = np.array([int(model.jnt_qposadr[model.actuator_trnid[i, 0]]) for i in range(model.nu)])

    # --- steps ---

    def reset(self, data: mujoco.MjData) -> None:
        """See Engine."""
        state = np.zeros(self._nq + self._nv)
        b, v = self._base_q, self._nq + self._base_v
        state[b : b + 4], state[b + 4 : b + 7] = data.qpos[3:7], data.qpos[:3]
        state[b + 6] -= SUNK_M
        state[self._q] = data.qpos[self._mj_q]
        state[v : v + 3], state[v + 3 : v + 6] = _turned(data.qpos[3:7], data.qvel[3:6]), data.qvel[:3]
        state[self._nq + self._v] = data.qvel[self._mj_v]
        self._own.SetDiscreteState(state)
        self._slip[:] = 0.0
        self._set_force(np.zeros(self._nv))
        mujoco.mj_kinematics(self._model, data)
        mujoco.mj_comPos(self._model, data)

    def steps(self, first: int, last: int, t: float, body: Body, drive: Drive, sampled: Sampled, forced: bool) -> None:
        """See Engine."""
        for i in range(first, last):
            if begin_step(i, t + i * self._dt, body, drive, sampled, forced):
                self._sampled_step(self._data)
                sampled.ground[:, :3], sampled.ground[:, 3:] = self._wrenches[:, 3:], self._wrenches[:, :3]
                sampled.about[:] = 0.0  # the origin of the world
                end_step(i, body, drive, sampled)
            else:
                self._step(self._data)

    def _step(self, data: mujoco.MjData) -> None:
        mujoco.mj_kinematics(self._model, data)
        mujoco.mj_comPos(self._model, data)
        self._set_force(self._forces(data))
        self._advance(data)

    def _sampled_step(self, data: mujoco.MjData) -> None:
        """The same, with poses, velocities and accelerations of the bodies of the state before it."""
        self._mirror(data)
        self._set_force(self._forces(data))
        self._read_contacts()
        q, v = data.qpos.copy(), data.qvel.copy()
        self._advance(data)
        after_q, after_v = data.qpos.copy(), data.qvel.copy()
        data.qpos[:], data.qvel[:] = q, v
        self._mirror(data)
        data.qacc[:] = (after_v - v) / self._dt
        mujoco.mj_rnePostConstraint(self._model, data)
        data.qpos[:], data.qvel[:] = after_q, after_v

    def _mirror(self, data: mujoco.MjData) -> None:
        """Poses and velocities of the bodies in MuJoCo's data, of the state there."""
        mujoco.mj_kinematics(self._model, data)
        mujoco.mj_comPos(self._model, data)
        mujoco.mj_comVel(self._model, data)

    def _forces(self, data: mujoco.MjData) -> Array:
        """Generalised forces (nv,) of Drake but for dampers of joints."""
        model = self._model
        actuators = model.actuator_gainprm[:, 0] * data.ctrl + model.actuator_biasprm[:, 1] * data.qpos[self._driven_q]
        data.actuator_force[:] = actuators + model.actuator_biasprm[:, 2] * data.qvel[self._driven]
        total = data.qfrc_applied.copy()
        total[self._driven] += actuators
        for body in np.flatnonzero(data.xfrc_applied.any(axis=1)):
            f = data.xfrc_applied[body]
            mujoco.mj_applyFT(model, data, f[:3], f[3:], data.xipos[body], int(body), total)
        rest, q, v = model.qpos_spring[self._mj_q], data.qpos[self._mj_q], data.qvel[self._mj_v]
        own = total[self._mj_v] + self._stiffness * (rest - q)
        if self._friction.any():
            slip = np.clip(self._slip[self._mj_v] + self._dt * v, -BRISTLE, BRISTLE)
            self._slip[self._mj_v] = slip
            own -= self._friction * slip / BRISTLE
        out = np.zeros(self._nv)
        out[self._v] = own
        out[self._base_v : self._base_v + 3] = _turned(data.qpos[3:7], total[3:6])
        out[self._base_v + 3 : self._base_v + 6] = total[:3]
        return out

    def _set_force(self, force: Array) -> None:
        self._force.FixValue(self._own, force)

    def _advance(self, data: mujoco.MjData) -> None:
        """One step of the plant; then MuJoCo's data hold the state after it."""
        with _failures():
            self._context.SetDiscreteState(self._diagram.EvalUniquePeriodicDiscreteUpdate(self._context))
        state = self._own.get_discrete_state_vector().value().copy()
        b, v = self._base_q, self._nq + self._base_v
        data.qpos[3:7], data.qpos[:3] = state[b : b + 4], state[b + 4 : b + 7]
        data.qpos[self._mj_q] = state[self._q]
        back = state[b : b + 4] * _CONJUGATE
        data.qvel[3:6], data.qvel[:3] = _turned(back, state[v : v + 3]), state[v + 3 : v + 6]
        data.qvel[self._mj_v] = state[self._nq + self._v]

    def _read_contacts(self) -> None:
        """Force and moment about the origin of the world, of the ground on each foot."""
        with _failures():
            results = self._results.Eval(self._own)
        self._wrenches[:] = 0.0
        for i in range(results.num_hydroelastic_contacts()):
            info = results.hydroelastic_contact_info(i)
            surface = info.contact_surface()
            on, by = self._body_of[surface.id_M()], self._body_of[surface.id_N()]
            force, moment = info.F_Ac_W().translational(), info.F_Ac_W().rotational()
            self._add_wrench(on, by, force, moment + cross(surface.centroid(), force))
        for i in range(results.num_point_pair_contacts()):
            pair = results.point_pair_contact_info(i)
            force = pair.contact_force()  # on body B
            self._add_wrench(
                int(pair.bodyB_index()), int(pair.bodyA_index()), force, cross(pair.contact_point(), force)
            )

    def _add_wrench(self, on: int, by: int, force: Array, moment: Array) -> None:
        for body, sign in ((on, 1.0), (by, -1.0)):
            if body in self._foot_of:
                self._wrenches[self._foot_of[body]] += sign * np.concatenate([force, moment])
