"""A crowded table with noisy layouts, compiled once for the tests of this folder."""

import jax
import jax.numpy as jnp
import pytest
from neoworld_bench.engines.table_scenes import crowded, noisy_layouts

from neoworld_mjx.physics.model import compile_scene


@pytest.fixture(scope="session")
def crowd():
    scene = compile_scene(crowded(3), samples=96)
    return scene, jax.tree.map(jnp.asarray, noisy_layouts(scene, 96, seed=4))
