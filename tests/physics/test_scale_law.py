"""Compiling a rearranged scene equals writing model fields into a compiled one."""

import mujoco
import numpy as np
import pytest

from neoworld_mjx.physics.model import compile_scene
from neoworld_mjx.physics.native import open_batch
from neoworld_mjx.spec import scale
from tests.support import scenes
from tests.support.scenes import random_layout

# Search structures (bounding-volume trees, hull graphs) break ties by rounding; they decide how
# fast, not what, is found. Meshes are compared where they lie, below: MuJoCo turns each to its
# principal axes, and a symmetric one has several.
SKIP = ("names", "paths", "bvh_", "oct_", "mesh_")


def meshes_in_bodies(model):
    """Vertices of every mesh geom in its body's frame, sorted."""
    found = {}
    for g in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH):
        mesh = model.geom_dataid[g]
        at, n = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, model.geom_quat[g])
        v = model.mesh_vert[at : at + n] @ turn.reshape(3, 3).T + model.geom_pos[g]
        order = np.lexsort(np.round(v, 6).T)
        found[model.geom(g).name] = v[order]
    return found


def field_errors(ours, theirs):
    """Largest relative difference of each float field of two models."""
    errors = {}
    ours_at, theirs_at = meshes_in_bodies(ours), meshes_in_bodies(theirs)
    for name in theirs_at:
        assert np.allclose(ours_at[name], theirs_at[name], rtol=0, atol=1e-7), name
    for name in dir(theirs):
        if name.startswith(("_", *SKIP)):
            continue
        b = getattr(theirs, name)
        if not isinstance(b, np.ndarray) or b.size == 0:
            continue
        a = getattr(ours, name)
        assert a.shape == b.shape, name
        if name.startswith("geom_"):
            plain = theirs.geom_type != mujoco.mjtGeom.mjGEOM_MESH
            a, b = a[plain], b[plain]
            if not b.size:
                continue
        if b.dtype.kind == "f":
            errors[name] = float(np.abs(a - b).max() / max(np.abs(b).max(), 1e-12))
        else:
            assert np.array_equal(a, b), name
    return errors


def spoon():
    """A capsule and an ellipsoid on a saucer, whose bowl is a mesh."""
    return scenes.without(scenes.coffee(), "cup")


@pytest.mark.parametrize("make", [scenes.blocks, spoon, scenes.furnished, scenes.lamp])
def test_model_fields_equal_a_recompiled_scene(make):
    scene = compile_scene(make())
    layouts = random_layout(scene, 2)
    poses = scene.place_exactly(layouts)
    batch = open_batch(scene, poses)
    for k in range(2):
        again = compile_scene(scene.apply(layouts, k, poses))
        errors = field_errors(batch.get_model(k), again.static.mjm)
        errors.pop("key_qpos", None)  # a keyframe is not read; the batch's qpos is compared below
        # dof_length comes from mesh sizes, which MuJoCo keeps in single precision.
        bound = {"dof_length": 1e-6}
        loose = {n: e for n, e in errors.items() if e > bound.get(n, 1e-9)}
        assert not loose, loose
        assert np.allclose(batch.bind("qpos")[k], again.static.start, atol=1e-12)


def test_scaled_motion_is_similar():
    """Froude: at 4 times the size everything happens half as fast, damping included."""
    turns = []
    for s in (1.0, 4.0):
        obj = scenes.on_table((scale(scenes.cabinet(), s), (0, 0), 0.0, {"fixed_base": True}))
        host = compile_scene(obj, timestep=0.0005 * s**0.5).static
        data = mujoco.MjData(host.mjm)
        data.qpos[:] = host.start
        mjm = host.mjm
        mjm.opt.gravity[:] = (3.0, 2.0, -9.81)
        for _ in range(600):
            mujoco.mj_step(mjm, data)
        turns.append((data.joint("cabinet-hinge").qpos[0], data.joint("cabinet-slide").qpos[0] / s))
    # An authored mass breaks similarity of the door's drag on the free base, hence a fixed one.
    assert turns[0][1] == pytest.approx(turns[1][1], rel=2e-2)
