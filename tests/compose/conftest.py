"""Heights of the many positions that are tried, by a program that is optimized."""

import pytest


@pytest.fixture(autouse=True, scope="module")
def _optimized_heights():
    """Tests compile without optimization; here that would be four fifths of the time."""
    import jax

    from neoworld_mjx.physics import scene_arrays
    from neoworld_mjx.physics.layout import heights

    options = {"xla_backend_optimization_level": 1}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scene_arrays, "_heights", jax.jit(heights, compiler_options=options))
        yield
