"""Engines of batched environments that are MJX: MuJoCo Warp through it, and the project's step."""

import contextlib
import copy
import io

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array

from ..errors import EngineError
from ..physics.mjx_model import make_data, mjx_step, put_model, with_fields
from .arm import SceneState, scene_state
from .controlled_scene import ControlledScene
from .engines import Fields, dynamic

# MJX prints a message if the optional warp is missing.
with contextlib.redirect_stdout(io.StringIO()):
    from mujoco import mjx


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

    def step(self, fields: Fields, state: SceneState, ctrl: Array, steps: int) -> SceneState:
        """See `StepEngine.step`. Results vary in the last bits between runs."""
        model = self._model.replace(**fields)
        data = self._data.replace(**dynamic(state._replace(ctrl=ctrl)))
        if steps:
            data = jax.lax.fori_loop(0, steps, lambda _, d: mjx.step(model, d), data)
        return scene_state(mjx.kinematics(model, data))


class MjxSteps:
    """The project's step of MJX, on anything that JAX compiles for."""

    name = "mjx"

    def __init__(self, model: mujoco.MjModel, initial_qpos: np.ndarray) -> None:
        """Put the model on the device.

        Raises:
            EngineError: MJX cannot simulate the scene.
        """
        self._model = put_model(model, initial_qpos)
        self._data = jax.tree.map(jnp.asarray, make_data(self._model))

    def step(self, fields: Fields, state: SceneState, ctrl: Array, steps: int) -> SceneState:
        """See `StepEngine.step`."""
        model = with_fields(self._model, dict(fields)) if fields else self._model
        data = self._data.replace(**dynamic(state._replace(ctrl=ctrl)))
        if steps:
            data = mjx_step(model, data, steps)
        # Body poses in the data lag one time step behind qpos.
        return scene_state(mjx.kinematics(model.mjx, data))


PROBE_STEPS, PROBE_ACTIONS = 400, 8
LEAST_ROWS = 256
"""Least number of constraints of a world: 160 were too few for a Panda that worked on a door."""


def capacity(controlled: ControlledScene) -> tuple[int, int]:
    """Return the contacts and constraints for which a world needs memory.

    They are two and four times the largest numbers in C MuJoCo under random controls, because
    MuJoCo Warp may generate more contact points, its pool also holds pairs that pass the broad
    phase, and a policy makes other contacts; constraints are at least `LEAST_ROWS`. Warp prints a
    line if they do not suffice.
    """
    model, rng = controlled.model, np.random.default_rng(0)
    contacts, constraints = 0, 0
    low, high = controlled.action_bounds
    for _ in range(PROBE_ACTIONS):
        data = controlled.initial_data()
        for _ in range(PROBE_STEPS // 20):
            action = rng.uniform(low, high).astype(np.float32)
            data.ctrl[:] = controlled.controls(action, scene_state(data))
            mujoco.mj_step(model, data, 20)
            contacts, constraints = max(contacts, data.ncon), max(constraints, data.nefc)
    pool = 2 * contacts + 32
    rows = max(4 * max(constraints, 4 * contacts) + 64, LEAST_ROWS)
    return -(-pool // 16) * 16, -(-rows // 32) * 32
