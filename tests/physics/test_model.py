"""SceneModel: its repr, its errors for wrong types, and what JAX may transform."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neoworld_mjx.physics.layout import place
from neoworld_mjx.physics.model_fields import model_fields
from tests.support import scenes
from tests.support.scenes import compile_scene, random_layout


@pytest.fixture(scope="module")
def blocks():
    return compile_scene(scenes.blocks(), samples=16)


def test_place_and_model_fields_may_be_jitted_and_vmapped(blocks):
    layouts = jax.tree.map(jnp.asarray, random_layout(blocks, 6))
    rows = jax.tree.map(lambda leaf: leaf.reshape(2, 3, *leaf.shape[1:]), layouts)
    poses = jax.jit(lambda z: blocks.place(z))(layouts)
    nested = jax.jit(jax.vmap(lambda z: blocks.place(z)))(rows)
    assert np.allclose(nested.pos.reshape(poses.pos.shape), poses.pos, atol=1e-6)
    fields = jax.jit(lambda some: model_fields(blocks, some))(poses)
    assert fields["body_pos"].shape == (6, blocks.static.mjm.nbody, 3)
    assert np.allclose(fields["geom_size"], model_fields(blocks, poses)["geom_size"])


def test_batched_placement_equals_placement_at_once(blocks, monkeypatch):
    layouts = random_layout(blocks, 7)
    whole = blocks.place_exactly(layouts)
    monkeypatch.setattr("neoworld_mjx.physics.layout.SNAPPED_AT_ONCE", 8)
    batched = jax.jit(lambda z: place(blocks.arrangement, z))  # traced anew, in parts
    assert np.allclose(batched(layouts).height, whole.height, atol=1e-6)
