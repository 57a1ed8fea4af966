"""Lower bound for JAX engines: `jax.vmap` over `mjx.step` in a scan."""

from collections.abc import Callable
from typing import Any

import jax

from neoworld_mjx.physics import mjx_engine
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.model import SceneModel


def bare_scan(
    scene: SceneModel, layouts: Layout, steps: int, chunk: int = mjx_engine.MJX_CHUNK
) -> Callable[[], Any]:
    """Prepare candidates as engine mjx does; return a function that steps them to the end.

    Candidates are placed and their model fields are written here, once. The function returns
    coordinates [pop, 1, nq], in chunks.

    Args:
        scene: the compiled scene.
        layouts: the candidates.
        steps: of each candidate.
        chunk: candidates simulated at once.
    """
    model = mjx_engine.on_device(scene)
    pop = layouts.yaw.shape[0]
    parts = []
    for first in range(0, pop, chunk):
        chunk_layouts = jax.tree.map(lambda leaf, at=first: leaf[at : at + chunk], layouts)
        parts.append(mjx_engine.prepare(scene, scene.place(chunk_layouts))[:2])
    jax.block_until_ready(parts)
    return lambda: [mjx_engine.bare_scan(model, fields, qpos, 1, steps) for fields, qpos in parts]
