"""Image measures of reconstructed scenes and their objects, compared with photographs."""

from collections.abc import Iterator, Sequence
from typing import Any

from neoworld_mjx.errors import ConfigError

from ..measures.mean import mean_of_known
from ..measures.picture_similarity import MEASURES, PictureModels, colored_points
from ..paper_figures import PAPER_OBJECTS, of_scenes
from ..rows import Row
from .made_scenes import MadeScene

OBJECT_PX = 256
"""Longer side of an object's picture [px]."""


class PictureRow(Row):
    """Image measures of a scene or of one of its objects; None without the model of a measure."""

    folder: str
    object: str
    """Name of the object; empty for the scene."""
    width: int
    """Size of both images [px]."""
    height: int
    ssim: float | None
    lpips: float | None
    clip: float | None
    dino: float | None
    uni3d: float | None
    """None for scenes, and for objects that were not made."""


def picture_rows(made: MadeScene, models: PictureModels, side: int = 512) -> Iterator[PictureRow]:
    """Yield the row of a scene and those of its objects.

    All objects of the tree have rows, reconstructed or not; the environment and scenes without a
    tree have none.

    Args:
        made: the scene, as `made_scenes` reads it.
        models: those that there are.
        side: longer side of the scene's pictures [px].

    Raises:
        ConfigError: `side` is out of range, or a model cannot be used.
    """
    if not 64 <= side <= 4096:
        raise ConfigError(f"--size takes 64 to 4096 pixels, got {side}")
    items = {item.name: item for item in made.scene.objects}
    for name in ("", *made.boxes):
        photo, rendered = made.part(name, OBJECT_PX) if name else made.whole(side)
        item = items.get(name)
        cloud = None if item is None else colored_points(item.spec, item.joint_state)
        yield PictureRow(
            folder=made.name,
            object=name,
            width=photo.shape[1],
            height=photo.shape[0],
            **models.compare(photo, rendered, cloud),
        )


def picture_figures(rows: Sequence[PictureRow]) -> dict[str, Any]:
    """Return means over scenes and over objects with their n, alongside the paper's.

    The paper's are of its own scenes and objects, by models and pictures that it does not state.
    """
    parts = {
        "scenes": [row for row in rows if not row.object],
        "objects": [row for row in rows if row.object],
    }
    means = {
        part: {
            name: mean_of_known([getattr(row, name) for row in part_rows]).model_dump()
            for name in MEASURES
        }
        for part, part_rows in parts.items()
    }
    return means | {"paper": {"scenes": of_scenes("clip", "dino"), "objects": PAPER_OBJECTS}}
