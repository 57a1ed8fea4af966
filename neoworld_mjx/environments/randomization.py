"""Draws of `nw.sample` as initial states and model fields of the worlds of a batch."""

import copy
from dataclasses import dataclass

import jax
import mujoco
import numpy as np
from jaxtyping import Float

from ..errors import SpecError
from ..physics.model_fields import model_fields
from .controlled_scene import ControlledScene
from .samples import SceneSamples

FIELDS = (
    *("body_pos", "body_quat", "body_ipos", "body_mass", "body_inertia"),
    *("geom_pos", "geom_size", "geom_rbound", "geom_aabb", "geom_friction"),
    *("jnt_pos", "jnt_range", "dof_damping", "dof_frictionloss", "qpos0", "qpos_spring"),
)
"""Fields in which draws may differ. The derived fields follow by `mj_setConst`."""
DERIVED = ("body_subtreemass", "body_invweight0", "dof_invweight0")


@dataclass(frozen=True, eq=False)
class Variants:
    """Variants of a controlled scene that differ in fields of the model."""

    qpos: Float[np.ndarray, "variant nq"]
    ctrl: Float[np.ndarray, "variant nu"]
    """Initial controls."""
    fields: dict[str, np.ndarray]
    """Only fields in which the variants differ, each of shape [variant, ...]."""

    def __len__(self) -> int:
        return len(self.qpos)


def variants_of(controlled: ControlledScene, samples: SceneSamples) -> Variants:
    """Return the kept draws of a scene as variants of the scene with its robot or gripper.

    Raises:
        SpecError: no draw is kept, or the draws vary the sizes of meshes, which the worlds of a
            batch share.
    """
    if not len(samples.kept):
        raise SpecError(f"no draw of the scene is kept: {samples.phrase()}")
    poses = jax.tree.map(lambda leaf: np.asarray(leaf, float)[samples.kept], samples.poses)
    base = samples.model.static.mjm
    if base.nmesh and not np.allclose(poses.scale, 1.0, atol=1e-6):
        raise SpecError("worlds of a batch share their meshes: sample with sizes=False")
    values = model_fields(samples.model, poses, np)
    model, count = controlled.model, len(poses.scale)
    qpos = np.tile(controlled.initial_qpos, (count, 1))
    qpos[:, : base.nq] = values["qpos"]
    scratch, data = copy.copy(model), mujoco.MjData(model)
    fields: dict[str, list[np.ndarray]] = {name: [] for name in FIELDS + DERIVED}
    for k in range(count):
        for name in FIELDS:
            # The bodies, geoms and joints of the scene come first in the model.
            target, source = getattr(scratch, name), values.get(name)
            if source is not None:
                rows = source[k].reshape(-1, *target.shape[1:])
                target[: len(rows)] = rows
        mujoco.mj_setConst(scratch, data)
        for name, rows in fields.items():
            rows.append(getattr(scratch, name).astype(np.float32))
    stacked = {name: np.stack(rows) for name, rows in fields.items()}
    differing = {
        name: v for name, v in stacked.items() if not np.allclose(v, getattr(model, name), 1e-6)
    }
    ctrl = np.tile(controlled.initial_ctrl, (count, 1))
    return Variants(qpos.astype(np.float32), ctrl.astype(np.float32), differing)
