"""Object tests of many objects on a GPU: several objects a model, each model on its own stream.

Objects of a model do not collide with each other; each world holds one run of each of them.
Runs of different kinds share a model, as held objects hang high above the floor and each world has
its own gravity.
"""

from collections.abc import Sequence
from typing import Any

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp
from numpy.typing import NDArray

from benchmarks.battery import Prepared
from neoworld_mjx.errors import EngineError
from neoworld_mjx.physics.mjcf import to_mjspec

LIFT = 10.0
"""Height [m] by which held objects are lifted."""
AT_ONCE = 10
"""Steps per launch of a CUDA graph."""
ITERATIONS = 50
"""Maximum iterations of the constraint solver; all worlds of a model wait for the slowest."""
PROBED_STEPS, PROBE_EVERY = 150, 5
_FIELDS = ("dof_armature", "dof_invweight0", "body_invweight0")


class Batch:
    """All objects on one device."""

    def __init__(self, prepared: Sequence[Prepared], together: int, device: Any) -> None:
        """Group objects with similar numbers of runs into models.

        Raises:
            EngineError: MuJoCo Warp does not support them.
        """
        self.device = device
        self.count = len(prepared)
        order = sorted(range(self.count), key=lambda k: -len(prepared[k].runs))
        self.groups = [
            (chosen, Group([prepared[k] for k in chosen], self.device))
            for chosen in (
                order[first : first + together] for first in range(0, self.count, together)
            )
        ]

    @property
    def models(self) -> int:
        """Number of models."""
        return len(self.groups)

    def run(self) -> list[NDArray]:
        """Simulate all runs; return the final qpos [runs, nq] of each object."""
        for _, group in self.groups:
            group.begin()
        steps = self.groups[0][1].steps
        for _ in range(steps // AT_ONCE):
            for _, group in self.groups:
                group.advance()
        wp.synchronize_device(self.device)
        ends: list[Any] = [None] * self.count
        for rows, group in self.groups:
            for k, end in zip(rows, group.ends(), strict=True):
                ends[k] = end
        return ends


class Group:
    """Several objects in one model, with a world for each of their runs."""

    def __init__(self, objects: Sequence[Prepared], device: Any) -> None:
        self.objects, self.device = objects, device
        self.steps = objects[0].forces.shape[1]
        if self.steps % AT_ONCE:
            raise EngineError(f"{self.steps} steps are not whole launches of {AT_ONCE}")
        mjm = _one_model(objects)
        heavy = max(sum(_gravity(p)) for p in objects)
        self.worlds = worlds = heavy + max(len(p.runs) - sum(_gravity(p)) for p in objects)
        # World of each run: runs with gravity first, then those without.
        self.world = [
            np.concatenate([np.arange(sum(g)), heavy + np.arange(len(g) - sum(g))])
            for g in map(_gravity, objects)
        ]
        qpos = np.tile(mjm.qpos0, (worlds, 1))
        qvel = np.zeros((worlds, mjm.nv))
        fields = {name: np.repeat(getattr(mjm, name)[None], worlds, 0) for name in _FIELDS}
        joint = np.zeros((self.steps, worlds, mjm.nv), np.float32)
        body = np.zeros((self.steps, worlds, mjm.nbody, 6), np.float32)
        self.qpos_of: list[slice] = []
        q = v = 0
        b = 1
        for p, at in zip(objects, self.world, strict=True):
            own = p.simulation.model
            columns, dofs = slice(q, q + own.nq), slice(v, v + own.nv)
            bodies = slice(b, b + own.nbody - 1)
            qpos[:, columns] = p.starts[0, 1 : 1 + own.nq]
            qpos[at, columns] = p.starts[:, 1 : 1 + own.nq]
            qpos[at, q + 2] += _lift(p)
            qvel[at, dofs] = p.starts[:, 1 + own.nq : 1 + own.nq + own.nv]
            for w, model in zip(at, p.models, strict=True):
                for name in _FIELDS:
                    if name == "body_invweight0":
                        fields[name][w, bodies] = model.body_invweight0[1:]
                    else:
                        fields[name][w, dofs] = getattr(model, name)
            joint[:, at, dofs] = p.forces[:, :, : own.nv].transpose(1, 0, 2)
            on = p.forces[:, :, own.nv :].reshape(len(at), self.steps, own.nbody, 6)
            body[:, at, bodies] = on[:, :, 1:].transpose(1, 0, 2, 3)
            self.qpos_of.append(columns)
            q, v, b = q + own.nq, v + own.nv, b + own.nbody - 1
        gravity = np.tile(mjm.opt.gravity, (worlds, 1))
        gravity[heavy:] = 0.0
        contacts, constraints = _room(objects)
        with wp.ScopedDevice(device):
            self.stream = wp.Stream(device) if device.is_cuda else None
            try:
                self.model = mjw.put_model(mjm, batch_sizes=dict.fromkeys(_FIELDS, worlds))
            except (NotImplementedError, ValueError) as error:
                raise EngineError(f"MuJoCo Warp cannot carry these objects: {error}") from None
            self.data = mjw.make_data(
                mjm, nworld=worlds, naconmax=worlds * contacts, njmax=constraints
            )
            self.model.opt.warn_overflow = 0
            self.model.opt.gravity = wp.array(gravity.astype(np.float32), dtype=wp.vec3)
            for name, values in fields.items():
                into = getattr(self.model, name)
                into.assign(values.astype(np.float32).reshape(*into.shape, -1).squeeze())
            self.start = [wp.array(x.astype(np.float32)) for x in (qpos, qvel)]
            self.joint = wp.array(joint)
            self.body = wp.array(body, dtype=wp.spatial_vector)
            self.time = wp.zeros(1, dtype=int)
            self.graph: Any = None

    def begin(self) -> None:
        """Reset all worlds to their initial states."""
        with wp.ScopedDevice(self.device), wp.ScopedStream(self.stream):
            d = self.data
            wp.copy(d.qpos, self.start[0])
            wp.copy(d.qvel, self.start[1])
            for array in (d.qacc_warmstart, d.time, d.overflow, self.time):
                array.zero_()
            if self.graph is None and self.device.is_cuda:
                self._step()  # Compiles and loads kernels, which is not possible during capture.
                with wp.ScopedCapture(stream=self.stream) as capture:
                    for _ in range(AT_ONCE):
                        self._step()
                self.graph = capture.graph
                self.begin()

    def advance(self) -> None:
        """Simulate AT_ONCE more steps."""
        if self.graph is not None:
            wp.capture_launch(self.graph, stream=self.stream)
            return
        with wp.ScopedDevice(self.device):
            for _ in range(AT_ONCE):
                self._step()

    def ends(self) -> list[NDArray]:
        """Return qpos [runs, nq] of each object.

        Raises:
            EngineError: contacts or constraints did not fit.
        """
        flags = int(np.bitwise_or.reduce(self.data.overflow.numpy()))
        if flags:
            names = ", ".join(flag.name or "" for flag in mjw.OverflowType if flag & flags)
            raise EngineError(f"something of some worlds did not fit: {names}")
        qpos = self.data.qpos.numpy().astype(float)
        ends = []
        for p, at, columns in zip(self.objects, self.world, self.qpos_of, strict=True):
            end = qpos[at, columns]
            end[:, 2] -= _lift(p)
            ends.append(end)
        return ends

    def _step(self) -> None:
        d = self.data
        for forces, into in ((self.joint, d.qfrc_applied), (self.body, d.xfrc_applied)):
            wp.launch(_load, dim=into.shape, inputs=[self.time, forces, into])
        mjw.step(self.model, d)
        wp.launch(_tick, dim=1, inputs=[self.time, self.steps])


def _gravity(p: Prepared) -> list[bool]:
    return [run.world != "weightless" for run in p.runs]


def _lift(p: Prepared) -> NDArray:
    return np.array([0.0 if run.world == "free" else LIFT for run in p.runs])


def _one_model(objects: Sequence[Prepared]) -> mujoco.MjModel:
    """Compile objects into one model; each collides only with itself and the floor."""
    options = objects[0].simulation.options
    mjspec = mujoco.MjSpec()
    mjspec.compiler.degree = False
    mjspec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    mjspec.compiler.alignfree = False
    mjspec.option.timestep = options.timestep_s
    mjspec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    floor = mjspec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE)
    floor.size, floor.friction, floor.condim = [0, 0, 1.0], [0.0, 0.0, 0.0], 3
    floor.contype, floor.conaffinity = 0, (1 << len(objects)) - 1
    for k, p in enumerate(objects):
        attached = to_mjspec(p.simulation.spec, timestep=options.timestep_s)
        for key in list(attached.keys):
            attached.delete(key)
        for geom in attached.geoms:
            if geom.contype or geom.conaffinity:
                geom.contype = geom.conaffinity = 1 << k
        mjspec.attach(attached, prefix=f"{k}:", frame=mjspec.worldbody.add_frame())
    mjm = mjspec.compile()
    v = 0
    for k, p in enumerate(objects):
        own = p.simulation.model
        if [mjm.joint(mjm.dof_jntid[v + i]).name for i in range(own.nv)] != [
            f"{k}:{own.joint(own.dof_jntid[i]).name}" for i in range(own.nv)
        ]:
            raise EngineError(f"{p.simulation.spec.name}: its joints are not in one row")
        mjm.dof_solimp[v : v + own.nv] = own.dof_solimp
        v += own.nv
    mjm.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_NATIVECCD)
    mjm.opt.iterations = min(mjm.opt.iterations, ITERATIONS)
    return mjm


def _room(objects: Sequence[Prepared]) -> tuple[int, int]:
    """Return the contacts and constraints to allocate for a world, counted with C MuJoCo."""
    contacts = constraints = 0
    for p in objects:
        most_contacts = most_constraints = 0
        # The falls, and the runs with joints at the ends of their ranges.
        for k in np.unique(np.linspace(0, len(p.runs) - 1, 6).astype(int)):
            model = p.models[k]
            data = mujoco.MjData(model)
            data.qpos[:] = p.starts[k, 1 : 1 + model.nq]
            for _ in range(PROBED_STEPS // PROBE_EVERY):
                mujoco.mj_step(model, data, PROBE_EVERY)
                most_contacts = max(most_contacts, data.ncon)
                most_constraints = max(most_constraints, data.nefc, 4 * data.ncon)
        contacts += 4 * most_contacts + 32
        constraints += 4 * most_constraints + 64
    return contacts, -(-constraints // 32) * 32


@wp.kernel
def _load(
    time: wp.array(dtype=wp.int32), forces: wp.array3d(dtype=Any), into: wp.array2d(dtype=Any)
):
    w, i = wp.tid()
    into[w, i] = forces[time[0], w, i]


@wp.kernel
def _tick(time: wp.array(dtype=wp.int32), most: int):
    time[0] = wp.min(time[0] + 1, most - 1)
