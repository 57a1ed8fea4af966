"""SceneModel: its repr, its errors for wrong types, and what JAX may transform."""

import inspect

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neoworld_mjx.errors import SpecError
from neoworld_mjx.physics import model
from neoworld_mjx.physics.engine import rollout
from neoworld_mjx.physics.layout import Layout, place
from neoworld_mjx.physics.model import load_scene
from neoworld_mjx.physics.model_fields import model_fields
from tests.support import scenes
from tests.support.scenes import compile_scene, random_layout


@pytest.fixture(scope="module")
def blocks():
    return compile_scene(scenes.blocks(), samples=16)


def test_a_type_error_names_the_function_to_call(blocks):
    # Shape checks at run time would refuse the arguments first.
    roll_out, load, compile_ = map(inspect.unwrap, (rollout, load_scene, model.compile_scene))
    layouts = Layout.zero(2, 4)
    with pytest.raises(SpecError, match=r"SceneSpec, not a SceneModel.*compile_scene"):
        roll_out(scenes.blocks(), layouts)
    with pytest.raises(SpecError, match=r"str, not a SceneModel.*load_scene"):
        roll_out("scene.json", layouts)
    with pytest.raises(SpecError, match="not a Layout"):
        roll_out(blocks, blocks.place(layouts))
    with pytest.raises(SpecError, match=r"shape \(2, 3\), not \(pop, 4\)"):
        roll_out(blocks, Layout.zero(2, 3))
    with pytest.raises(SpecError, match="compile_scene takes a SceneSpec"):
        load(scenes.blocks())
    with pytest.raises(SpecError, match="load_scene takes"):
        compile_("scene.json")


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
