"""Engines of batched environments as one function of arrays, and C MuJoCo as one of them.

The others are in `mjx_engines`.
"""

import os
from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array
from mujoco.batch import Batch, SimulationError

from .arm import SceneState, settled_act

Fields = Mapping[str, Array]
"""Model fields in which a world differs from the compiled model, by their names in MjModel."""


@runtime_checkable
class StepEngine(Protocol):
    """Engine whose `step` is pure and may be jitted and vmapped."""

    name: str

    def step(self, fields: Fields, state: SceneState, ctrl: Array, steps: int) -> SceneState:
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

    def step(self, fields: Fields, state: SceneState, ctrl: Array, steps: int) -> SceneState:
        """See `StepEngine.step`. Results do not depend on the number of threads."""
        state = state._replace(ctrl=ctrl)
        shapes = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, jnp.float32), state)
        call = lambda fields, state: self._on_host(fields, state, steps)
        return jax.pure_callback(call, shapes, dict(fields), state, vmap_method="broadcast_all")

    def _on_host(self, fields: dict[str, Any], state: SceneState, steps: int) -> SceneState:
        state = SceneState(*(np.asarray(x) for x in state))
        leading = state.qpos.shape[:-1]
        worlds = int(np.prod(leading))
        batch = self._batches.get(worlds)
        if batch is None:
            batch = self._batches[worlds] = Batch(self.model, worlds, self._threads)
        for name, values in fields.items():
            target = batch.expand(name)
            target[:] = np.asarray(values).reshape(target.shape)
        for name, values in dynamic(state).items():
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
        values = [batch.bind(name) for name in dynamic(state)] + bodies
        out = SceneState(*(np.array(v, np.float32) for v in values))
        out.qpos[failed] = np.nan
        return SceneState(*(v.reshape(*leading, *v.shape[1:]) for v in out))


def _divergences(batch: Batch) -> np.ndarray:
    bad = mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQACC
    return batch.warning[:, bad[0] : bad[1] + 1, 1].sum(axis=1)


def dynamic(state: SceneState) -> dict[str, Any]:
    """Return all fields but the bodies' poses, which follow from them."""
    return dict(list(state._asdict().items())[:-2])


def initial_world(model: mujoco.MjModel, qpos: Any, ctrl: Any) -> SceneState:
    """Return a world at rest whose bodies' poses are not set: give it to `step` with 0 steps."""
    zero = lambda *shape: jnp.zeros(shape, jnp.float32)
    ctrl = jnp.asarray(ctrl, jnp.float32)
    return SceneState(
        jnp.asarray(qpos, jnp.float32),
        *(zero(model.nv), settled_act(model, ctrl, jnp), zero(model.nv)),
        ctrl,
        *(zero(model.nbody, 3), zero(model.nbody, 4)),
    )
