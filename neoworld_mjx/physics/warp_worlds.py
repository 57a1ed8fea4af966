"""Worlds of a scene on a GPU: one MuJoCo Warp model and data, loaded with one population at a time.

Kernels are launched over the first `count` worlds only. Stopped candidates therefore cost nothing
once the running candidates have moved to the front.
"""

import copy
import math
from typing import Any, NamedTuple

import jax
import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..errors import EngineError
from .layout import Poses
from .model import MESH, CompiledScene, StaticScene
from .native import open_batch

PROBE_CANDIDATES, PROBE_STEPS, PROBE_EVERY = 24, 75, 5
"""Number of candidates, of steps, and of steps between two counts of contacts in `probe`."""

WORLDS_MEMORY_SHARE = 0.4
"""Share of a device's free memory for the worlds of one scene."""

WARP_ITERATIONS = 100
"""Largest number of solver iterations, which is limited since all worlds wait for the slowest."""


class Capacity(NamedTuple):
    """Sizes of the allocated device memory."""

    worlds: int
    contacts: int
    """Average number of contacts per world. All worlds share a pool of contacts."""
    constraints: int
    """Number of constraints of each world."""


def probe(scene: CompiledScene, poses: Poses) -> Capacity:
    """Return the capacity for twice the contacts of a few evenly chosen candidates in C MuJoCo."""
    pick = np.unique(np.linspace(0, poses.scale.shape[0] - 1, PROBE_CANDIDATES).astype(int))
    batch = open_batch(scene, jax.tree.map(np.asarray, poses)[pick])
    contacts, constraints = [0], [0]
    for k in range(len(pick)):
        model = batch.get_model(k)
        data = mujoco.MjData(model)
        data.qpos[:] = batch.bind("qpos")[k]
        for _ in range(PROBE_STEPS // PROBE_EVERY):
            mujoco.mj_step(model, data, PROBE_EVERY)
            contacts.append(data.ncon)
            constraints.append(data.nefc)
    # MuJoCo Warp may generate more contact points than C MuJoCo, and the contact pool also holds
    # the pairs that pass the broad phase.
    pool = 2 * max(contacts) + 32
    rows = 2 * max(max(constraints), 4 * max(contacts)) + 32
    return Capacity(worlds=0, contacts=-(-pool // 16) * 16, constraints=-(-rows // 32) * 32)


class Worlds:
    """Model, data and captured steps of one scene for up to `capacity.worlds` candidates."""

    SHARED = int(mjw.OverflowType.BROADPHASE | mjw.OverflowType.NARROWPHASE | mjw.OverflowType.CCD)
    """Overflows in which any world may lose contacts."""
    PER_WORLD = int(
        mjw.OverflowType.NEFC | mjw.OverflowType.NJMAX_NNZ | mjw.OverflowType.EPA_HORIZON
    )
    """Overflows that affect a single world."""

    def __init__(self, static: StaticScene, capacity: Capacity, device: Any) -> None:
        """Allocate memory for a scene on a warp device.

        Raises:
            EngineError: MuJoCo Warp cannot simulate the scene.
        """
        self.static, self.capacity, self.device = static, capacity, device
        mjm = copy.copy(static.mjm)
        # Warp never resets a diverged world, and rejects the flag.
        mjm.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        mjm.opt.iterations = min(mjm.opt.iterations, WARP_ITERATIONS)
        # In MuJoCo Warp this flag selects C MuJoCo's algorithm for pairs of boxes.
        mjm.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_NATIVECCD)
        self.count = n = capacity.worlds
        self._graphs: dict[int, Any] = {}
        self._source: dict[str, wp.array] = {}
        with wp.ScopedDevice(device):
            try:
                batched = dict.fromkeys((*_BATCHED, "geom_dataid"), n) if n else {}
                self.model = mjw.put_model(mjm, batch_sizes=batched)
                self.data = mjw.make_data(
                    mjm,
                    nworld=max(n, 1),
                    naconmax=max(n, 1) * capacity.contacts,
                    njmax=capacity.constraints,
                )
            except (NotImplementedError, ValueError) as error:
                raise EngineError(
                    f"engine warp cannot simulate scene {static.spec.name}: {error}; "
                    "use --engine native"
                ) from None
            self.model.opt.warn_overflow = 0
            if static.mjm.nmesh and n:
                self._copy_meshes_per_world()

    def with_doubled_pool(self) -> "Worlds":
        """Return empty worlds with twice the capacity for contacts."""
        capacity = self.capacity._replace(contacts=2 * self.capacity.contacts)
        return type(self)(self.static, capacity, self.device)

    def load(self, fields: dict[str, Any], qpos: np.ndarray) -> None:
        """Load candidates into the first worlds, at rest.

        Args:
            fields: values of model fields, JAX arrays in single precision, shape [pop, n]. They
                include "geom_xpos" and "geom_xmat" of the data, and "mesh_vert".
            qpos: initial states, shape [pop, nq].
        """
        with wp.ScopedDevice(self.device):
            self._source = {name: _words(_on_device(v, self.device)) for name, v in fields.items()}
            if "mesh_vert" in self._source:
                vertices = self.model.mesh_vert
                wp.copy(_words(vertices), self._source.pop("mesh_vert").flatten())
            zeros = np.zeros((len(qpos), self.static.mjm.nv), np.float32)
            self.data.overflow.zero_()
            self.data.time.zero_()
            self.data.qfrc_applied.zero_()
            self._scrub()
            self._place(np.arange(len(qpos)), qpos, zeros, zeros)

    def compact(
        self,
        rows: np.ndarray,
        qpos: np.ndarray,
        qvel: np.ndarray,
        qacc: np.ndarray,
        *,
        scrub: bool = False,
    ) -> None:
        """Continue with a subset of the worlds.

        Args:
            rows: indices of the worlds that continue, shape [count]. A world may be repeated.
            qpos: coordinates of these worlds.
            qvel: velocities of these worlds.
            qacc: accelerations of these worlds, from which the solver starts.
            scrub: if True, zero memory in which diverged worlds may have left NaN.
        """
        with wp.ScopedDevice(self.device):
            if scrub:
                self._scrub()
            self._place(self._rows[rows], qpos, qvel, qacc)

    def step(self, steps: int) -> None:
        """Step the worlds in use."""
        with wp.ScopedDevice(self.device):
            if not self.device.is_cuda:
                for _ in range(steps):
                    mjw.step(self.model, self.data)
                return
            if self.count not in self._graphs:
                self._capture()
            for _ in range(steps):
                wp.capture_launch(self._graphs[self.count])

    def push(self, applied: np.ndarray, qvel: np.ndarray) -> None:
        """Set the applied forces and velocities [count, nv] of the worlds in use."""
        with wp.ScopedDevice(self.device):
            for into, values in ((self.data.qfrc_applied, applied), (self.data.qvel, qvel)):
                wp.copy(into[: self.count], wp.array(np.ascontiguousarray(values, np.float32)))

    def read(
        self, *, moving: bool = True
    ) -> tuple[NDArray, NDArray | None, NDArray | None, NDArray]:
        """Return qpos, qvel, qacc and overflow flags of the worlds in use.

        Unless `moving` is True, qvel and qacc are None.
        """
        d, n = self.data, self.count
        qvel, qacc = (x[:n].numpy() if moving else None for x in (d.qvel, d.qacc_warmstart))
        return d.qpos[:n].numpy(), qvel, qacc, d.overflow[:n].numpy()

    def fitting_worlds(self) -> int:
        """Return the number of worlds that fit into the device's free memory."""
        if not self.device.is_cuda:
            return 1 << 16
        world_bytes = sum(_memory_bytes(x) for x in (self.model, self.data)) / max(
            self.capacity.worlds, 1
        )
        free = self.device.free_memory + world_bytes * self.capacity.worlds
        fit = int(WORLDS_MEMORY_SHARE * free / (2 * world_bytes))
        return max(64, 1 << (fit.bit_length() - 1))

    def _copy_meshes_per_world(self) -> None:
        """Give every world a separate copy of all meshes, numbered world * nmesh + mesh."""
        m, base, n = self.model, self.static.mjm, self.capacity.worlds
        shift = np.arange(n)[:, None]
        mesh_ids = np.where(
            base.geom_type == MESH, base.geom_dataid + shift * base.nmesh, base.geom_dataid
        )
        m.geom_dataid.assign(mesh_ids.astype(np.int32))
        m.mesh_vertadr = _ints((base.mesh_vertadr + shift * base.nmeshvert).ravel())
        m.mesh_vert = wp.array(np.tile(base.mesh_vert, (n, 1)), dtype=wp.vec3)
        # Addresses into tables of topology and normals, which are independent of scales.
        for name in ("vertnum", "graphadr", "polynum", "polyadr", "polymapadr", "polymapnum"):
            setattr(m, f"mesh_{name}", _ints(np.tile(getattr(base, f"mesh_{name}"), n)))

    def _place(
        self, rows: np.ndarray, qpos: np.ndarray, qvel: np.ndarray, qacc: np.ndarray
    ) -> None:
        """Fill the first worlds with the loaded candidates `rows`."""
        m, d, count = self.model, self.data, len(rows)
        self._rows = rows
        self.count = d.nworld = count
        d.naconmax = d.naccdmax = count * self.capacity.contacts
        index = _ints(rows)
        for name, source in self._source.items():
            into = _words(getattr(d if name in _DATA else m, name))
            wp.launch(_gather, dim=(count, source.shape[1]), inputs=[index, source, into])
        if self.static.mjm.nmesh:
            base = self.static.mjm
            mesh_ids = base.geom_dataid + rows[:, None] * base.nmesh
            mesh_ids = np.where(base.geom_type == MESH, mesh_ids, base.geom_dataid).astype(np.int32)
            wp.copy(m.geom_dataid[:count], wp.array(mesh_ids, dtype=int))
        for into, values in ((d.qpos, qpos), (d.qvel, qvel), (d.qacc_warmstart, qacc)):
            if values.size:
                wp.copy(into[:count], wp.array(np.ascontiguousarray(values, np.float32)))

    def _scrub(self) -> None:
        """Zero memory in which diverged worlds may have left NaN, as zero times NaN is NaN."""
        for part in (self.data.efc, self.data.contact):
            for value in vars(part).values():
                if isinstance(value, wp.array) and value.dtype == wp.float32:
                    value.zero_()

    def _capture(self) -> None:
        # Kernels must be compiled and loaded outside a capture. The step that does so is undone.
        d = self.data
        state = (d.qpos, d.qvel, d.qacc_warmstart, d.time, d.overflow)
        if not self._graphs:
            saved = [wp.clone(x) for x in state]
            mjw.step(self.model, d)
            for into, values in zip(state, saved, strict=True):
                wp.copy(into, values)
        with wp.ScopedCapture(self.device) as capture:
            mjw.step(self.model, d)
        self._graphs[self.count] = capture.graph


_BATCHED = (
    *("body_pos", "body_quat", "body_ipos", "body_mass", "body_inertia", "body_subtreemass"),
    *("body_invweight0", "dof_invweight0", "geom_pos", "geom_size", "geom_rbound", "geom_aabb"),
    *("jnt_pos", "jnt_range", "jnt_stiffness", "jnt_actfrcrange", "dof_armature", "dof_damping"),
    *("dof_frictionloss", "geom_friction", "qpos0", "qpos_spring", "eq_data"),
)
_DATA = ("geom_xpos", "geom_xmat")


@wp.kernel
def _gather(
    index: wp.array(dtype=wp.int32),
    source: wp.array2d(dtype=wp.uint32),
    into: wp.array2d(dtype=wp.uint32),
):
    i, j = wp.tid()
    into[i, j] = source[index[i], j]


def _words(array: wp.array) -> wp.array:
    """View a contiguous array of 32-bit numbers, vectors or matrices as [rows, words]."""
    rows = array.shape[0]
    words = array.size * wp.types.type_size_in_bytes(array.dtype) // 4
    view = wp.array(
        ptr=array.ptr,
        shape=(rows, words // max(rows, 1)),
        dtype=wp.uint32,
        device=array.device,
    )
    view._keep = array  # the view does not own the memory
    return view


def _ints(values: np.ndarray) -> wp.array:
    return wp.array(np.ascontiguousarray(values, np.int32), dtype=int)


def _on_device(value: Any, device: Any) -> wp.array:
    """Convert a JAX array to a warp array, without a copy if both are on the same GPU."""
    source = next(iter(value.devices()))
    if device.is_cuda and source.platform == "gpu" and source.local_hardware_id == device.ordinal:
        return wp.from_jax(value.block_until_ready())
    return wp.array(np.asarray(value), dtype=float, device=device)


def _memory_bytes(part: Any) -> int:
    total = 0
    for value in vars(part).values():
        if isinstance(value, wp.array):
            total += math.prod(value.shape) * wp.types.type_size_in_bytes(value.dtype)
        elif hasattr(value, "__dataclass_fields__"):
            total += _memory_bytes(value)
    return total
