"""Image measures of reconstructed scenes and their objects, compared with photographs."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from neoworld_mjx.errors import ConfigError, RunError
from neoworld_mjx.io.files import write_atomic
from neoworld_mjx.render import to_png

from ..measures.picture_similarity import (
    PICTURE_MEASURES,
    PictureModels,
    picture_measure,
)
from ..measures.point_clouds import Cloud, coloured_points
from ..paper_figures import PAPER_OBJECTS, of_scenes
from ..rows import Row
from .made_scenes import MadeScene, Rgb

NOTE = (
    "NeoWorld-Pro as the paper reports it, of its own 30 scenes: clip 0.9128, dino 0.7855; of its "
    "objects: ssim 0.8894, lpips 0.1989, clip 0.9042, uni3d 0.2812; which models of CLIP, DINOv2 "
    "and LPIPS and which pictures it does not say"
)
OBJECT_PX = 256
"""Longer side of an object's picture [px]."""


class PictureRow(Row):
    """Image measures of a scene or of one of its objects."""

    folder: str
    kind: Literal["scene", "object"]
    name: str
    """Name of the object; empty for the scene."""
    width: int
    """Size of both images [px]."""
    height: int
    ssim: float | None
    lpips: float | None
    clip: float | None
    dino: float | None
    uni3d: float | None
    why: dict[str, str]
    """Reason of each measure that is None."""


def picture_rows(
    scenes: Sequence[MadeScene],
    models: PictureModels,
    *,
    side: int = 512,
    objects: bool = True,
    out: Path | None = None,
) -> Iterator[PictureRow]:
    """Yield the row of each scene and those of its objects.

    All objects of the tree have rows, reconstructed or not; the environment and scenes without a
    tree have none.

    Args:
        scenes: the scenes, as `made_scenes` reads them.
        models: those that there are.
        side: longer side of a scene's pictures [px].
        objects: whether to measure objects.
        out: folder to write what is compared into, the photograph left.

    Raises:
        ConfigError: a number is out of range, or a model cannot be used.
        RunError: a picture cannot be written.
    """
    if not 64 <= side <= 4096:
        raise ConfigError(f"--size takes 64 to 4096 pixels, got {side}")
    for reconstruction in scenes:
        yield _row(reconstruction, "", reconstruction.whole(side), models, None, out)
        items = {item.name: item for item in reconstruction.scene.objects}
        for name in reconstruction.boxes if objects else ():
            item = items.get(name)
            cloud = None if item is None else coloured_points(item.spec, item.joint_state)
            yield _row(
                reconstruction, name, reconstruction.part(name, OBJECT_PX), models, cloud, out
            )


def picture_figures(rows: Sequence[PictureRow]) -> dict[str, Any]:
    """Return means over scenes and over objects with their n, alongside the paper's."""
    return {
        "scenes": _means([row for row in rows if row.kind == "scene"]),
        "objects": _means([row for row in rows if row.kind == "object"]),
        "paper": {
            "scenes": of_scenes("clip", "dino"),
            "objects": PAPER_OBJECTS,
            "note": NOTE,
        },
    }


def _means(rows: Sequence[PictureRow]) -> dict[str, float | int | None]:
    means: dict[str, float | int | None] = {"n": len(rows)}
    for name in PICTURE_MEASURES:
        values = [getattr(row, name) for row in rows]
        measured = [value for value in values if value is not None]
        means[name] = float(np.mean(measured)) if measured else None
    return means


def _row(
    reconstruction: MadeScene,
    name: str,
    pair: tuple[Rgb, Rgb],
    models: PictureModels,
    cloud: Cloud | None,
    out: Path | None,
) -> PictureRow:
    photo, rendered = pair
    if out is not None:
        file = out / f"{reconstruction.numbered}-{name or 'scene'}.png"
        try:
            out.mkdir(parents=True, exist_ok=True)
            write_atomic(file, to_png(np.concatenate([photo, rendered], axis=1)))
        except OSError as error:
            raise RunError(f"cannot write {file}: {error.strerror}") from None
    measure = picture_measure(photo, rendered, models, cloud)
    why = measure.why
    if name and cloud is None:
        why = why | {"uni3d": "the object was not made"}
    return PictureRow(
        folder=reconstruction.name,
        kind="object" if name else "scene",
        name=name,
        width=photo.shape[1],
        height=photo.shape[0],
        **{measured: getattr(measure, measured) for measured in PICTURE_MEASURES},
        why=why,
    )
