"""Named scenes of sweeps and ablations: `bench:desk_laptop`, `crowded:10`.

`bench:desk_laptop@layout#1` is an initial scene with another noise level and number.
"""

import functools
from collections.abc import Callable, Mapping
from functools import partial
from typing import get_args

import numpy as np

from neoworld_mjx.errors import SpecError, choices
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.model import SceneModel
from neoworld_mjx.spec import SceneSpec, SceneTree
from neoworld_mjx.sweeps import Case

from .dataset.declaration import declaration
from .dataset.truth_scene import photographed
from .engines.table_scenes import Noise, crowded, noisy_layouts
from .fidelity.rendered_responses import exact_response
from .methods.layout_errors import layout_errors
from .noise.initial_scenes import NoiseLevel, initial_scene, noise_number

CROWDED_NOISE = Noise(xy=0.08, yaw=np.radians(20.0), log_scale=0.12)
"""Noise of the initial layouts of crowded scenes."""


def bench_case(name: str) -> Case:
    """Return an initial scene of one of the thirty scenes.

    Args:
        name: its name, with noise `all`, or NAME@LEVEL; #START behind it is the number of the
            initial scene, 0 by default. Odd ones are the evaluation half.

    Raises:
        SpecError: there is no such scene, noise level or number.
    """
    level_of, hash_, start = name.partition("#")
    if hash_ and not start.isdecimal():
        raise SpecError(f"scene bench:{name}: #START takes the number of an initial scene")
    scene, at, level = level_of.partition("@")
    if at and level not in get_args(NoiseLevel):
        raise SpecError(f"scene bench:{name}: noise {choices(level, get_args(NoiseLevel))}")
    noise: NoiseLevel = level if at else "all"  # pyright: ignore[reportAssignmentType]
    try:
        truth, response = _truth_and_response(scene)
    except SpecError as error:
        raise SpecError(f"scene bench:{name}: {error}") from None
    number = noise_number(scene, seed=0, start=int(start or 0))
    composed = initial_scene(truth, response, number, noise=noise).scene
    return Case(f"bench:{name}", composed, errors=partial(_layout_errors, truth))


@functools.lru_cache(maxsize=32)
def _truth_and_response(scene: str) -> tuple[SceneSpec, SceneTree]:
    """Return a scene as photographed and its exact parse, which all noise levels share."""
    truth = photographed(declaration(scene))
    return truth, exact_response(truth)


def crowded_case(objects: str) -> Case:
    """Return a table with a number of objects, and noisy initial layouts by seed.

    Raises:
        SpecError: the number is not from 1 to 100.
    """
    if not objects.isdecimal() or not 1 <= int(objects) <= 100:
        raise SpecError(f"scene crowded:{objects}: name a number of objects from 1 to 100")
    return Case(f"crowded:{objects}", crowded(int(objects)), start=_crowded_start)


SOURCES: Mapping[str, Callable[[str], Case]] = {
    "bench": bench_case,
    "crowded": crowded_case,
}
"""Functions from a name to a scene, by the kind before the colon."""


def _crowded_start(scene: SceneModel, seed: int) -> Layout:
    return noisy_layouts(scene, 1, seed=100 + seed, noise=CROWDED_NOISE)


def _layout_errors(truth: SceneSpec, scene: SceneSpec) -> dict[str, float]:
    errors = layout_errors(scene, truth)
    return {
        "xy_m": errors["xy_error_m"],
        "yaw_deg": errors["yaw_error_deg"],
        "scale": errors["scale_error"],
    }
