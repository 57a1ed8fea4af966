"""Named scenes of sweeps and ablations: `bench:tower`, `crowded:10`, `photo:coffee`."""

from collections.abc import Mapping

import numpy as np

from neoworld_mjx.errors import SpecError, choices
from neoworld_mjx.measure import visible_box_iou
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.model import SceneModel
from neoworld_mjx.pipeline.bundled_examples import bundled_examples
from neoworld_mjx.spec import read_scene
from neoworld_mjx.sweeps.cases import Case, Source

from .engines.table_scenes import crowded
from .photographs.real_scenes import FOLDER
from .refine_scenes import LARGE, SCENES, errors, photographed, start


def bench_case(name: str) -> Case:
    """Return a scene of the refine suite with its initial layouts and its errors.

    Raises:
        SpecError: there is no such scene.
    """
    every = SCENES | LARGE
    if name not in every:
        raise SpecError(f"scene bench:{name}: {choices(name, every)}")
    return Case(f"bench:{name}", photographed(name), start=start, errors=errors)


def crowded_case(objects: str) -> Case:
    """Return a table with a number of objects.

    Raises:
        SpecError: the number is not from 1 to 100.
    """
    if not objects.isdecimal() or not 1 <= int(objects) <= 100:
        raise SpecError(f"scene crowded:{objects}: name a number of objects from 1 to 100")
    return Case(f"crowded:{objects}", crowded(int(objects)), start=start)


def photo_case(name: str) -> Case:
    """Return the composed scene of a bundled example, with its photograph.

    Raises:
        SpecError: no such example has one.
    """
    examples = bundled_examples()
    composed = {each: FOLDER / f"{each}.json" for each in examples}
    known = [each for each, path in composed.items() if path.is_file()]
    if name not in known:
        raise SpecError(f"scene photo:{name}: {choices(name, known)}")
    photo = examples[name].photo
    return Case(f"photo:{name}", read_scene(composed[name]), errors=_box_iou, photo=photo)


SOURCES: Mapping[str, Source] = {
    "bench": bench_case,
    "crowded": crowded_case,
    "photo": photo_case,
}
"""Functions from a name to a scene, by the kind before the colon."""


def _box_iou(model: SceneModel, layout: Layout) -> dict[str, float]:
    """Compare the visible boxes of a layout, pop axis of length 1, with those of the photograph."""
    ious = visible_box_iou(model.apply(layout, 0))
    return {"box_iou": float(np.mean(list(ious.values())))} if ious else {}
