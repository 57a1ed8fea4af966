"""A crowded table with noisy layouts, compiled once for the tests of this folder."""

import pytest


@pytest.fixture(scope="session")
def crowd():
    # This file is read before JAX may be imported: its options are set when tests are configured.
    import jax
    import jax.numpy as jnp

    from tests.support.scenes import compile_scene, noisy_layouts, stored_scene

    scene = compile_scene(stored_scene("crowded_3"), samples=96)
    return scene, jax.tree.map(jnp.asarray, noisy_layouts(scene, 96, seed=4))
