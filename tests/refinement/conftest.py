"""A crowded table with noisy layouts, compiled once for the tests of this folder."""

import jax
import jax.numpy as jnp
import pytest

from neoworld_mjx.physics.model import compile_scene
from tests.support.scenes import noisy_layouts, stored_scene


@pytest.fixture(scope="session")
def crowd():
    scene = compile_scene(stored_scene("crowded_3"), samples=96)
    return scene, jax.tree.map(jnp.asarray, noisy_layouts(scene, 96, seed=4))
