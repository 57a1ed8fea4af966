"""Comparison of two compiled models, field by field."""

import mujoco
import numpy as np

# Search structures (bounding-volume trees, hull graphs) break ties by rounding, which affects speed
# but not results. Meshes are compared in the body frame: MuJoCo rotates each to its principal axes,
# which are not unique for a symmetric mesh.
_SKIP = ("names", "paths", "bvh_", "oct_", "mesh_", "key_qpos")
SINGLE = ("mesh_vertices", "dof_length")
"""Fields that MuJoCo stores in single precision or derives from single-precision values."""
MOST_ERROR, MOST_ERROR_SINGLE = 1e-9, 1e-6
"""Largest relative difference of a field, and of a field of SINGLE, that is one of rounding."""


def meshes_in_bodies(model: mujoco.MjModel) -> dict[str, np.ndarray]:
    """Return the vertices [m] of every mesh geom in its body's frame, in MuJoCo's order."""
    vertices = {}
    for g in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH):
        mesh = model.geom_dataid[g]
        first, n = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, model.geom_quat[g])
        vertices[model.geom(g).name] = (
            model.mesh_vert[first : first + n] @ rotation.reshape(3, 3).T + model.geom_pos[g]
        )
    return vertices


def field_errors(ours: mujoco.MjModel, theirs: mujoco.MjModel) -> dict[str, float]:
    """Return the largest difference of each field, relative to the field's largest value.

    Errors of integer fields are 0 or inf. "mesh_vertices" is the largest distance of a vertex from
    the nearest vertex of the other mesh, over its extent.
    """
    errors = {"mesh_vertices": 0.0}
    our_meshes, their_meshes = meshes_in_bodies(ours), meshes_in_bodies(theirs)
    for name, b in their_meshes.items():
        gap = np.linalg.norm(our_meshes[name][:, None] - b[None], axis=-1)
        worst = max(gap.min(axis=0).max(), gap.min(axis=1).max()) / np.ptp(b, axis=0).max()
        errors["mesh_vertices"] = max(errors["mesh_vertices"], float(worst))
    plain = theirs.geom_type != mujoco.mjtGeom.mjGEOM_MESH
    for name in dir(theirs):
        b = None if name.startswith(("_", *_SKIP)) else getattr(theirs, name)
        if not isinstance(b, np.ndarray) or b.size == 0:
            continue
        a = getattr(ours, name)
        if a.shape != b.shape:
            errors[name] = float("inf")
            continue
        if name.startswith("geom_"):
            a, b = a[plain], b[plain]
        if b.dtype.kind != "f":
            errors[name] = 0.0 if np.array_equal(a, b) else float("inf")
        elif b.size:
            errors[name] = float(np.abs(a - b).max() / max(np.abs(b).max(), 1e-12))
    return errors


def loose_fields(errors: dict[str, float]) -> dict[str, float]:
    """Return the fields that differ by more than their precision allows."""
    return {
        n: e
        for n, e in errors.items()
        if not e <= (MOST_ERROR_SINGLE if n in SINGLE else MOST_ERROR)
    }
