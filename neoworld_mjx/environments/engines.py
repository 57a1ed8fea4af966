"""Engines of batched environments behind one function of arrays: native, warp and mjx.

The state of a world holds only what the next step needs, so all engines share it, and worlds can be
reset, gathered and stored like any arrays.
"""

import contextlib
import copy
import io
import os
from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float
from mujoco.batch import Batch, SimulationError

from ..engines import ENGINES
from ..errors import EngineError, choices
from ..physics.array_types import AnyArray
from ..physics.mjx_model import make_data, mjx_step, put_compiled, with_fields
from ..physics.warp_engine import warp_device
from .arm import scene_state
from .controlled_scene import ControlledScene

# MJX prints a message if the optional warp is missing.
with contextlib.redirect_stdout(io.StringIO()):
    from mujoco import mjx

Fields = Mapping[str, Array]
"""Model fields in which a world differs from the compiled model, by their names in MjModel."""


class WorldState(NamedTuple):
    """State of one world; engines map over leading axes with `jax.vmap`."""

    qpos: Float[AnyArray, " nq"]
    qvel: Float[AnyArray, " nv"]
    act: Float[AnyArray, " na"]
    qacc_warmstart: Float[AnyArray, " nv"]
    ctrl: Float[AnyArray, " nu"]
    xpos: Float[AnyArray, "nbody 3"]
    """Positions of the bodies at `qpos` [m]."""
    xquat: Float[AnyArray, "nbody 4"]


@runtime_checkable
class StepEngine(Protocol):
    """Engine whose `step` is pure and may be jitted and vmapped."""

    name: str

    def step(self, fields: Fields, state: WorldState, ctrl: Array, steps: int) -> WorldState:
        """Apply controls for a number of time steps; 0 steps only update the bodies' poses.

        A world that diverges has positions that are not finite.
        """
        ...


class NativeSteps:
    """C MuJoCo: all worlds of a batch in threads, called back by JAX."""

    name = "native"

    def __init__(self, model: mujoco.MjModel, threads: int = 0) -> None:
        """Use `threads` threads; 0 uses all cores that the process may use."""
        if threads == 0 and hasattr(os, "sched_getaffinity"):
            threads = len(os.sched_getaffinity(0))
        self.model, self._threads = model, threads
        self._batches: dict[int, Batch] = {}

    def step(self, fields: Fields, state: WorldState, ctrl: Array, steps: int) -> WorldState:
        """See `StepEngine.step`. Results do not depend on the number of threads."""
        state = state._replace(ctrl=ctrl)
        shapes = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, jnp.float32), state)
        call = lambda fields, state: self._on_host(fields, state, steps)
        return jax.pure_callback(call, shapes, dict(fields), state, vmap_method="broadcast_all")

    def _on_host(self, fields: dict[str, Any], state: WorldState, steps: int) -> WorldState:
        state = WorldState(*(np.asarray(x) for x in state))
        leading = state.qpos.shape[:-1]
        worlds = int(np.prod(leading))
        batch = self._batches.get(worlds)
        if batch is None:
            batch = self._batches[worlds] = Batch(self.model, worlds, self._threads)
        for name, values in fields.items():
            target = batch.expand(name)
            target[:] = np.asarray(values).reshape(target.shape)
        for name, values in _dynamic(state).items():
            target = batch.bind(name)
            target[:] = values.reshape(target.shape)
        bodies = [batch.bind(name) for name in ("xpos", "xquat")]
        before = _divergences(batch)
        failed = np.zeros(worlds, bool)
        try:
            if steps:
                batch.step(nstep=steps, stage=mujoco.mjtStage.mjSTAGE_POS.value)
            else:
                batch.forward(stage=mujoco.mjtStage.mjSTAGE_POS.value)
        except SimulationError as error:
            failed[error.ids] = True
        # MuJoCo resets a world whose accelerations are not finite, and counts a warning.
        failed |= _divergences(batch) > before
        values = [batch.bind(name) for name in _dynamic(state)] + bodies
        out = WorldState(*(np.array(v, np.float32) for v in values))
        out.qpos[failed] = np.nan
        return WorldState(*(v.reshape(*leading, *v.shape[1:]) for v in out))


def _divergences(batch: Batch) -> np.ndarray:
    bad = mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQACC
    return batch.warning[:, bad[0] : bad[1] + 1, 1].sum(axis=1)


class WarpSteps:
    """MuJoCo Warp through upstream MJX, on NVIDIA GPUs, which compiles once for a scene."""

    name = "warp"

    def __init__(self, model: mujoco.MjModel, worlds: int, contacts: int, constraints: int) -> None:
        """Allocate for `worlds` worlds with an average of `contacts` contacts in a shared pool.

        Args:
            model: the compiled model.
            worlds: largest number of worlds in a batch.
            contacts: average number of contacts of a world.
            constraints: largest number of constraints of a world.

        Raises:
            EngineError: MuJoCo Warp cannot simulate the model.
        """
        model = copy.copy(model)
        # Warp never resets a diverged world, and rejects the flag.
        model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        # In MuJoCo Warp this flag selects C MuJoCo's algorithm for pairs of boxes.
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_NATIVECCD)
        try:
            self._model = mjx.put_model(model, impl="warp")
            self._data = mjx.make_data(
                model, impl="warp", naconmax=worlds * contacts, njmax=constraints
            )
        except (NotImplementedError, ValueError) as error:
            raise EngineError(f"engine warp cannot simulate the scene: {error}") from None

    def step(self, fields: Fields, state: WorldState, ctrl: Array, steps: int) -> WorldState:
        """See `StepEngine.step`. Results vary in the last bits between runs."""
        model = self._model.replace(**fields)
        data = self._data.replace(**_dynamic(state._replace(ctrl=ctrl)))
        if steps:
            data = jax.lax.fori_loop(0, steps, lambda _, d: mjx.step(model, d), data)
        return _state(mjx.kinematics(model, data))


class MjxSteps:
    """The project's step of MJX, on anything that JAX compiles for."""

    name = "mjx"

    def __init__(self, model: mujoco.MjModel, initial_qpos: np.ndarray) -> None:
        """Put the model on the device.

        Raises:
            EngineError: MJX cannot simulate the scene.
        """
        self._model = put_compiled(model, initial_qpos)
        self._data = jax.tree.map(jnp.asarray, make_data(self._model))

    def step(self, fields: Fields, state: WorldState, ctrl: Array, steps: int) -> WorldState:
        """See `StepEngine.step`."""
        model = with_fields(self._model, dict(fields)) if fields else self._model
        data = self._data.replace(**_dynamic(state._replace(ctrl=ctrl)))
        if steps:
            data = mjx_step(model, data, steps)
        # Body poses in the data lag one time step behind qpos.
        return _state(mjx.kinematics(model.mjx, data))


def _dynamic(state: WorldState) -> dict[str, Any]:
    """Return all fields but the bodies' poses, which follow from them."""
    return dict(list(state._asdict().items())[:-2])


def _state(data: mjx.Data) -> WorldState:
    return WorldState(*(getattr(data, name) for name in WorldState._fields))


def initial_world(model: mujoco.MjModel, qpos: Any, ctrl: Any) -> WorldState:
    """Return a world at rest whose bodies' poses are not set: give it to `step` with 0 steps."""
    zero = lambda *shape: jnp.zeros(shape, jnp.float32)
    return WorldState(
        jnp.asarray(qpos, jnp.float32),
        *(zero(model.nv), zero(model.na), zero(model.nv)),
        jnp.asarray(ctrl, jnp.float32),
        *(zero(model.nbody, 3), zero(model.nbody, 4)),
    )


def open_steps(controlled: ControlledScene, engine: str, worlds: int) -> StepEngine:
    """Return an engine for batches of at most `worlds` worlds.

    Raises:
        EngineError: the engine is unknown, cannot run here, or cannot simulate the scene.
    """
    model = copy.copy(controlled.model)
    # A `WorldState` has no values of sensors.
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
    if engine == "native":
        return NativeSteps(model)
    if engine == "warp":
        warp_device()
        return WarpSteps(model, worlds, *capacity(controlled))
    if engine == "mjx":
        return MjxSteps(model, controlled.initial_qpos)
    raise EngineError(f"engine: {choices(engine, sorted(ENGINES))}")


PROBE_STEPS, PROBE_ACTIONS = 400, 8


def capacity(controlled: ControlledScene) -> tuple[int, int]:
    """Return the contacts and constraints for which a world needs memory.

    They are two and four times the largest numbers in C MuJoCo under random controls, because
    MuJoCo Warp may generate more contact points, its pool also holds pairs that pass the broad
    phase, and a policy makes other contacts. Warp prints a line if they do not suffice.
    """
    model, rng = controlled.model, np.random.default_rng(0)
    data = mujoco.MjData(model)
    contacts, constraints = 0, 0
    low, high = controlled.action_bounds
    for _ in range(PROBE_ACTIONS):
        mujoco.mj_resetData(model, data)
        data.qpos[:] = controlled.initial_qpos
        data.ctrl[:] = controlled.initial_ctrl
        mujoco.mj_forward(model, data)
        for _ in range(PROBE_STEPS // 20):
            action = rng.uniform(low, high).astype(np.float32)
            data.ctrl[:] = controlled.controls(action, scene_state(data))
            mujoco.mj_step(model, data, 20)
            contacts, constraints = max(contacts, data.ncon), max(constraints, data.nefc)
    pool = 2 * contacts + 32
    rows = 4 * max(constraints, 4 * contacts) + 64
    return -(-pool // 16) * 16, -(-rows // 32) * 32
