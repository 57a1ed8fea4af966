"""Share of displacements of one object that S_sem scores lower than the ground truth."""

from collections.abc import Iterator, Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from neoworld_mjx.physics.array_types import AnyArray
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.model import compile_scene
from neoworld_mjx.physics.scene_arrays import SceneArrays, on_device, pad_scene
from neoworld_mjx.refinement.rewards import semantics

from ..rows import Row
from .rendered_scenes import photo_scene
from .step_errors import chosen_numbers

NEAR_M, FAR_M = 0.01, 0.05
"""Shortest and longest displacement."""


class SemanticRow(Row):
    """One scene."""

    scene: int
    truth: float
    """S_sem of the ground truth."""
    lower: float
    """Share of the displacements that score lower than the ground truth."""
    higher: dict[str, int]
    """Displacements that do not, by the object that they move."""


def semantic_rows(scenes: Sequence[int] = (), *, draws: int = 200) -> Iterator[SemanticRow]:
    """Compare the truth of scenes, as photographed without noise, with displacements.

    Args:
        scenes: numbers; none selects all forty.
        draws: displacements of each scene, each of one object along the ground.

    Raises:
        EngineError: there is no such scene.
    """
    for number in chosen_numbers(scenes):
        model = compile_scene(photo_scene(number))
        scene = on_device(pad_scene(model))
        layouts, objects = _displaced(scene, draws, number)
        scores = np.asarray(_scores(scene, layouts))
        high = objects[scores[1:] >= scores[0]].tolist()
        yield SemanticRow(
            scene=number,
            truth=float(scores[0]),
            lower=1 - len(high) / draws,
            higher={model.names[k]: high.count(k) for k in sorted(set(high))},
        )


@eqx.filter_jit
def _scores(scene: SceneArrays, layouts: Layout) -> Float[AnyArray, " pop"]:
    return semantics(scene, layouts).value


def _displaced(
    scene: SceneArrays, draws: int, number: int
) -> tuple[Layout, Int[np.ndarray, " draw"]]:
    """Return layouts [1 + draws], the ground truth first, and the object that each draw moves."""
    rng = np.random.default_rng((number, 47))
    objects = rng.choice(np.flatnonzero(np.asarray(scene.photo.scored)), draws)
    angle, far = rng.uniform(0, 2 * np.pi, draws), rng.uniform(NEAR_M, FAR_M, draws)
    xy = np.zeros((1 + draws, scene.count, 2), np.float32)
    xy[np.arange(1, 1 + draws), objects] = np.column_stack(
        [far * np.cos(angle), far * np.sin(angle)]
    )
    zero = np.zeros((1 + draws, scene.count), np.float32)
    return on_device(Layout(xy, zero, zero)), objects
