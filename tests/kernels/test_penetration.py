"""Penetration depths: values and gradients, with culling and in plain jnp."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from neoworld_bench.engines.table_scenes import noisy_layouts
from neoworld_kernels import Colliders, PieceGroup, pair_depth_culled, pair_depth_reference
from scipy.spatial.transform import Rotation

from neoworld_mjx.physics.colliders import collect_colliders
from neoworld_mjx.physics.layout import rotation
from neoworld_mjx.physics.sampling import surface_samples
from neoworld_mjx.spec import Box, Capsule, Cylinder, Ellipsoid, Lathe, Mesh, SceneObject, Sphere
from tests.support.scenes import compile_scene, single, stored_scene

CORNERS = ((0.0, 0.0, 0.04), (0.03, 0.0, -0.02), (-0.02, 0.03, -0.02), (-0.02, -0.03, -0.02))
SHAPES = {
    "box": Box(size=(0.06, 0.05, 0.04)),
    "capsule": Capsule(radius=0.015, length=0.06),
    "sphere": Sphere(radius=0.03),
    "cylinder": Cylinder(radius=0.025, height=0.05),
    "ellipsoid": Ellipsoid(radii=(0.02, 0.03, 0.04)),
    "polytope": Mesh(vertices=CORNERS, faces=((0, 1, 2), (0, 2, 3), (0, 3, 1), (1, 3, 2))),
    "sector": Lathe(profile=((0.0, 0.0), (0.03, 0.0), (0.035, 0.05)), thickness=0.006),
}
POP = 70


class Mixed(NamedTuple):
    """One object of each kind of solid, in random poses that overlap."""

    where: tuple[jax.Array, jax.Array, jax.Array]
    samples: jax.Array
    colliders: Colliders
    run: dict[str, Callable]
    """Depths, and the gradient of `weight` times them by poses; by `jnp` of some kinds only."""
    weight: jax.Array
    truth: np.ndarray
    """Depths by the reference."""


@pytest.fixture(scope="module")
def mixed():
    tilted = (0.8, 0.36, 0.48, 0.0)
    items = tuple(
        SceneObject(name=kind, spec=single(kind, (shape, (0.005, 0.0, 0.01), tilted)))
        for kind, shape in SHAPES.items()
    )
    samples = jnp.stack([surface_samples(obj, 50) for obj in items])
    colliders = collect_colliders(items)
    assert all(len(group.owner) for group in colliders), "every kind occurs"
    rng = np.random.default_rng(0)
    shape = (POP, len(items))
    turns = Rotation.from_quat(rng.normal(size=(POP * len(items), 4))).as_matrix()
    rows = rng.normal(0, 0.035, (*shape, 3)), turns.reshape(*shape, 3, 3)
    where = [jnp.asarray(x, jnp.float32) for x in (*rows, rng.uniform(0.7, 1.4, shape))]
    weight = jnp.asarray(rng.uniform(0.5, 1.5, (*shape, len(items))), jnp.float32)

    def run(depth, among):
        def total(where):
            depths = depth(*where, samples, among)
            return jnp.sum(weight * depths), depths

        both = jax.jit(jax.value_and_grad(total, has_aux=True))

        def call(*where):
            (_, depths), grad = both(where)
            return np.asarray(depths), [np.asarray(g) for g in grad]

        return call

    reference = jax.jit(pair_depth_reference)
    # Reverse mode through the whole reference takes long to compile; kinds differ in `distance`
    # only, which the culled one differentiates of all kinds.
    some = without(colliders, "cylinder", "ellipsoid", "polytope", "sector")
    runs = {"jnp": run(pair_depth_reference, some), "culled": run(pair_depth_culled, colliders)}
    truth = np.asarray(reference(*where, samples, colliders))
    return Mixed(tuple(where), samples, colliders, runs, weight, truth)


def without(found, *kinds):
    drop = lambda group: PieceGroup(*(x[:0] for x in group))
    return found._replace(**{kind: drop(getattr(found, kind)) for kind in kinds})


@pytest.mark.parametrize("impl", ["jnp", "culled"])
def test_gradient_is_that_of_finite_differences(mixed, impl):
    pos, rot, scale = mixed.where
    weight, run = np.asarray(mixed.weight), mixed.run[impl]
    cost = lambda *where: np.sum(weight * run(*where)[0], axis=(1, 2), dtype=float)
    _, grad = run(*mixed.where)
    rng = np.random.default_rng(2)
    direction = rng.normal(size=pos.shape), rng.normal(size=pos.shape), rng.normal(size=scale.shape)
    direction = [
        w / np.linalg.norm(w.reshape(POP, -1), axis=1).reshape(-1, *(1,) * (w.ndim - 1))
        for w in direction
    ]
    # Turning by a small vector adds its cross products with the axes.
    turned = np.cross(direction[1][..., None, :], np.swapaxes(rot, -1, -2))
    moves = {
        "pos": (2e-4, (direction[0], 0.0 * rot, 0.0 * scale)),
        "rot": (5e-3, (0.0 * pos, np.swapaxes(turned, -1, -2), 0.0 * scale)),
        "scale": (5e-3, (0.0 * pos, 0.0 * rot, direction[2])),
    }
    for name, (step, move) in moves.items():
        derivative = sum(
            (g * m).reshape(POP, -1).sum(axis=1) for g, m in zip(grad, move, strict=True)
        )
        low, mid, high = (
            cost(*(x + k * step * m for x, m in zip(mixed.where, move, strict=True)))
            for k in (-1.0, 0.0, 1.0)
        )
        size = np.abs(derivative).max()
        # A kink is where the differences to both sides do not agree.
        even = np.abs((high - mid) - (mid - low)) / step < 0.02 * size
        assert even.mean() > 0.4, name
        assert np.abs((high - low) / (2 * step) - derivative)[even].max() < 0.02 * size, name
        assert (np.abs(derivative) > 0.05 * size)[even].mean() > 0.5, "most candidates overlap"


def test_culled_agrees_with_the_reference_on_all_kinds(mixed):
    depths, _ = mixed.run["culled"](*mixed.where)
    assert np.abs(depths - mixed.truth).max() <= 1e-6
    met = (mixed.truth > 1e-3).mean(axis=0) + np.eye(len(SHAPES))
    assert met.min() > 0.05, "all meet each other"


def test_culled_agrees_with_the_reference_on_a_crowded_scene():
    scene = compile_scene(stored_scene("crowded_3"))
    poses = jax.jit(lambda x: scene.place(x))(noisy_layouts(scene, 64))
    where = (poses.pos, rotation(poses.quat), poses.scale, scene.samples, scene.colliders)
    depths = np.asarray(jax.jit(pair_depth_culled)(*where))
    truth = np.asarray(jax.jit(pair_depth_reference)(*where))
    assert np.abs(depths - truth).max() <= 1e-6
    assert (truth > 0).sum() > 50


def test_a_nan_pose_affects_only_its_own_depths(mixed):
    pos, rot, scale = mixed.where
    depth = mixed.run["culled"]
    sound, _ = depth(pos, rot, scale)
    lost, grad = depth(pos.at[2, 1, 0].set(jnp.nan), rot, scale.at[4, 0].set(jnp.inf))
    hit = np.zeros(lost.shape, bool)
    hit[2, 1, :] = hit[2, :, 1] = hit[4, 0, :] = hit[4, :, 0] = True
    assert np.isnan(lost[hit]).all()
    assert np.array_equal(lost[~hit], sound[~hit])
    others = np.delete(np.arange(POP), [2, 4])
    assert all(np.isfinite(g[others]).all() for g in grad)


def test_the_gradient_is_finite_for_concentric_colliders(mixed):
    """Concentric colliders with parallel axes, where norms and angles have no derivative."""
    pos, rot, scale = (jnp.asarray(x) for x in mixed.where)
    depths, grad = mixed.run["culled"](
        0 * pos, jnp.broadcast_to(jnp.eye(3), rot.shape), 0 * scale + 1
    )
    assert (depths[0] > 0.001).sum() > 30
    assert all(np.isfinite(g).all() for g in grad)
