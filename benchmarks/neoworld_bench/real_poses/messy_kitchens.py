"""MessyKitchens: registered scans of cluttered kitchens, without cameras.

    DATA/object_models/NAME.ply
    DATA/scenes/LEVEL/SCENE/poses.json        LEVEL is easy, medium or hard

The layout is that of MessyKitchens/MessyKitchens, docs/DATA.md, which calls poses.json
matrix-valued and world-space. Its keys are documented nowhere: a JSON object from the name of a
model to a 4x4 matrix is assumed here, and anything else is refused.
"""

import re
from collections.abc import Collection, Iterator
from pathlib import Path

import numpy as np

from neoworld_mjx.errors import SpecError
from neoworld_mjx.export.load_mesh import load_mesh
from neoworld_mjx.io import read_object
from neoworld_mjx.io.files import stays_inside
from neoworld_mjx.io.names import identifier

from .true_views import PosedObject, TrueView, diameter_of, rigid

SCENES, MODELS, POSES = "scenes", "object_models", "poses.json"
COPY = re.compile(r"_\d+$")


def is_messy_kitchens(path: Path) -> bool:
    """Return True if a folder has the layout of MessyKitchens."""
    return (path / MODELS).is_dir() and (path / SCENES).is_dir()


def messy_views(path: Path, names: Collection[str]) -> Iterator[TrueView]:
    """Read scenes, named LEVEL_SCENE.

    Args:
        path: the data set.
        names: of the scenes to read, as far as there are any.

    Raises:
        SpecError: a file is missing or broken.
    """
    for file in sorted((path / SCENES).glob(f"*/*/{POSES}")):
        name = f"{file.parent.parent.name}_{file.parent.name}"
        if name in names:
            poses = read_object(file, SpecError)
            objects: list[PosedObject] = []
            for key, matrix in poses.items():
                taken = {item.name for item in objects}
                objects.append(_object(path / MODELS, file, key, matrix, taken))
            yield TrueView(name, tuple(objects))


def _object(models: Path, file: Path, key: str, matrix: object, taken: set[str]) -> PosedObject:
    where = f"{file}, {key[:40]}"
    try:
        pose = np.asarray(matrix, float).reshape(4, 4)
    except (TypeError, ValueError):
        raise SpecError(
            f"{where}: expected is a JSON object from names of models to 4x4 matrices"
        ) from None
    if not np.isfinite(pose).all():
        raise SpecError(f"{where}: the matrix has numbers that are not finite")
    stems = [stem for stem in (key, COPY.sub("", key)) if stays_inside(stem)]
    mesh = next((m for stem in stems if (m := models / f"{stem}.ply").is_file()), None)
    if mesh is None:
        raise SpecError(f"{where}: there is no {models}/{key[:40]}.ply")
    vertices, faces = load_mesh(mesh)
    turned = rigid(pose[:3, :3], pose[:3, 3], where)
    return PosedObject(
        identifier(key, "object", taken), vertices, faces, turned, diameter_of(vertices)
    )
