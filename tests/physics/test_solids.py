"""Contacts of single pairs of geoms, against MuJoCo's exact distances."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from neoworld_mjx.errors import EngineError
from neoworld_mjx.physics.manifold import PosedSolid, geom_pairs, geom_solids, manifolds
from tests.support import scenes
from tests.support.scenes import compile_scene

GEOM = mujoco.mjtGeom
KINDS = (GEOM.mjGEOM_BOX, GEOM.mjGEOM_SPHERE, GEOM.mjGEOM_CAPSULE, GEOM.mjGEOM_CYLINDER)
KINDS += (GEOM.mjGEOM_MESH, GEOM.mjGEOM_ELLIPSOID)


@pytest.fixture(scope="module")
def pairs():
    """600 random pairs, 6 mm deep to 4 mm apart: kinds, exact distances and manifolds."""
    rng = np.random.default_rng(0)
    spec = mujoco.MjSpec()
    for k in range(24):
        body = spec.worldbody.add_body(name=f"b{k}")
        body.add_freejoint()
        kind = KINDS[k % len(KINDS)]
        geom = body.add_geom(type=kind, size=rng.uniform(0.01, 0.05, 3))
        if kind == GEOM.mjGEOM_MESH:
            mesh = spec.add_mesh(name=f"m{k}")
            mesh.uservert = rng.normal(0, 0.03, (12, 3)).ravel()
            geom.meshname = mesh.name
    m = spec.compile()
    data, fromto, count = mujoco.MjData(m), np.zeros(6), 600
    one = rng.integers(0, m.ngeom, count)
    two = (one + rng.integers(1, m.ngeom, count)) % m.ngeom
    turns, ways = rng.normal(size=(2, count, 4)), rng.normal(size=(count, 3))
    exact = np.zeros(count)
    pos, rot = np.zeros((2, count, 3)), np.zeros((2, count, 3, 3))
    for k, (a, b) in enumerate(zip(one, two, strict=True)):
        way, wanted = ways[k] / np.linalg.norm(ways[k]), rng.uniform(-0.006, 0.004)
        low, high = 0.0, m.geom_rbound[a] + m.geom_rbound[b] + 0.02
        for _ in range(18):
            middle = (low + high) / 2
            data.qpos[7 * a : 7 * a + 7] = [0, 0, 0, *turns[0, k]]
            data.qpos[7 * b : 7 * b + 7] = [*(way * middle), *turns[1, k]]
            mujoco.mj_kinematics(m, data)
            exact[k] = mujoco.mj_geomDistance(m, data, int(a), int(b), 1.0, fromto)
            low, high = (middle, high) if exact[k] < wanted else (low, middle)
        for side, geom in enumerate((a, b)):
            pos[side, k], rot[side, k] = data.geom_xpos[geom], data.geom_xmat[geom].reshape(3, 3)
    solids = jax.tree.map(jnp.asarray, geom_solids(m))

    def placed(side, geoms):
        own = jax.tree.map(lambda leaf: leaf[geoms], solids)
        at = jnp.asarray(pos[side] - pos[0], jnp.float32)
        return PosedSolid(own, at, jnp.asarray(rot[side], jnp.float32), jnp.ones(count))

    found = jax.jit(manifolds)(placed(0, one), placed(1, two))
    round_ = (m.geom_type[one] == GEOM.mjGEOM_ELLIPSOID) | (
        m.geom_type[two] == GEOM.mjGEOM_ELLIPSOID
    )
    return exact, jax.tree.map(np.asarray, found), round_


def test_no_overlap_is_missed_and_its_depth_is_right(pairs):
    exact, found, round_ = pairs
    deep = exact < -1e-3
    assert deep.sum() > 200
    depth = -found.dist.min(axis=1)
    assert np.all(depth[deep] > 1e-4)
    ratio = (depth / -exact)[deep & ~round_]
    assert np.median(ratio) == pytest.approx(1, abs=0.01)
    assert np.percentile(ratio, 5) > 0.7
    assert np.percentile(ratio, 95) < 1.1


def test_pairs_of_geoms_are_those_that_mujoco_collides():
    for make in (scenes.furnished, scenes.coffee):
        m = compile_scene(make()).static.mjm
        listed = geom_pairs(m)
        ours = {tuple(sorted(pair)) for pair in zip(listed.first, listed.second, strict=True)}
        data = mujoco.MjData(m)
        touching = set()
        # Everything at one place, so that whatever may touch does.
        m.body_pos[:] = 0
        data.qpos[m.jnt_qposadr[m.jnt_type == mujoco.mjtJoint.mjJNT_FREE]] = 0
        mujoco.mj_forward(m, data)
        for contact in data.contact:
            touching.add(tuple(sorted((int(contact.geom1), int(contact.geom2)))))
        assert len(touching) > 10
        assert touching <= ours
        bodies = {tuple(sorted(m.geom_bodyid[list(pair)])) for pair in touching}
        assert {tuple(sorted(m.geom_bodyid[list(pair)])) for pair in ours} >= bodies
        weld = m.body_weldid[m.geom_bodyid]
        assert all(weld[a] != weld[b] for a, b in ours)


def test_unsupported_geoms_are_refused():
    spec = mujoco.MjSpec()
    for k in range(2):
        spec.worldbody.add_body(name=f"b{k}").add_geom(size=[0.1] * 3, condim=4)
    with pytest.raises(EngineError, match="condim 3"):
        geom_pairs(spec.compile())
