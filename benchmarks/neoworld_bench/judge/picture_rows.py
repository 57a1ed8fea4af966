"""Reconstructed scenes with their photographs: run folders, the data set, and submissions.

Image measures of reconstructed scenes and their objects, compared with photographs.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from neoworld_mjx.errors import ConfigError, SpecError
from neoworld_mjx.io import read_model
from neoworld_mjx.parse.photo import Photo, load_photo
from neoworld_mjx.render import View, render_scene
from neoworld_mjx.run_folder import refuse_links
from neoworld_mjx.spec import Camera, SceneSpec, SceneTree

from ..measures.joint_measure import mean_of_known
from ..measures.picture_similarity import MEASURES, PictureModels, colored_points
from ..methods.submission import FILES, read_scene_file, scene_file
from ..paper_figures import PAPER_OBJECTS, of_scenes
from ..rows import Row

PHOTOS = ("photo.png", "picture.png")
"""Names of the photograph: in a run folder, and in a scene of the data set."""
MARGIN = 0.12
"""Margin around an object's box, over its longer side."""
ASPECT = 0.01
"""Largest difference of the logarithms of photograph's and camera's aspect."""

Rgb = UInt8[np.ndarray, "h w 3"]


@dataclass(frozen=True)
class MadeScene:
    """A reconstructed scene and the photograph that it was made from."""

    number: int
    """Index of the scene, from 0."""
    name: str
    """Name of the folder."""
    scene: SceneSpec
    camera: Camera
    photo: Photo
    boxes: dict[str, tuple[float, float, float, float]]
    """2D boxes [px] of the tree's objects other than the environment, reconstructed or not."""

    @property
    def numbered(self) -> str:
        """Unique file name: number and name."""
        return f"{self.number:02d}_{self.name}"

    def whole(self, side: int) -> tuple[Rgb, Rgb]:
        """Return photograph and rendered image; a smaller photograph is not enlarged.

        Args:
            side: largest length of the longer side [px].
        """
        width, height = self.photo.size
        factor = min(1.0, side / max(width, height))
        size = (max(1, round(width * factor)), max(1, round(height * factor)))
        resized = Image.fromarray(self.photo.rgb).resize(size, Image.Resampling.LANCZOS)
        view = View.of(self.camera, *size)
        return np.asarray(resized), render_scene(self.scene, view).color

    def part(self, name: str, side: int) -> tuple[Rgb, Rgb]:
        """Return photograph and rendered image around an object: a square, if the image has room.

        Args:
            name: an object of `boxes`.
            side: length of the longer side [px].
        """
        window = x0, y0, x1, y1 = self._window(name)
        view = View.through(self.camera, window, side)
        scale = self.photo.size[0] / self.camera.width
        cropped = Image.fromarray(self.photo.rgb).resize(
            (view.width, view.height),
            Image.Resampling.LANCZOS,
            box=(scale * x0, scale * y0, scale * x1, scale * y1),
        )
        return np.asarray(cropped), render_scene(self.scene, view).color

    def _window(self, name: str) -> tuple[float, float, float, float]:
        x0, y0, x1, y1 = self.boxes[name]
        side = (1 + 2 * MARGIN) * max(x1 - x0, y1 - y0)
        left, right = _window_side((x0 + x1) / 2, side, self.camera.width)
        top, bottom = _window_side((y0 + y1) / 2, side, self.camera.height_px)
        return left, top, right, bottom


def made_scenes(folders: Sequence[Path], data: Path | None = None) -> list[MadeScene]:
    """Open run folders, scenes of the data set, scenes of other methods, and folders of these.

    Args:
        folders: each with a scene and its photograph, or folders of such folders.
        data: the data set, whose scene of the same name gives photograph, camera and tree to a
            folder that has no photograph.

    Raises:
        ConfigError: no folder is given.
        SpecError: a folder has no scene, no camera or no photograph, or they do not fit.
        PhotoError: a photograph cannot be read.
        RunError: a folder holds links, pipes or devices.
    """
    if not folders:
        raise ConfigError(
            "name at least one run folder, or a folder that `neoworld bench make` wrote"
        )
    single: list[Path] = []
    for folder in folders:
        within = folder / "scenes" if (folder / "scenes").is_dir() else folder
        inner = sorted(each for each in _entries(within) if scene_file(each) is not None)
        single += [folder] if scene_file(folder) is not None or not inner else inner
    return [_made(number, folder, data) for number, folder in enumerate(single)]


def _entries(folder: Path) -> list[Path]:
    try:
        return [entry for entry in folder.iterdir() if entry.is_dir()]
    except OSError as error:
        raise SpecError(f"cannot read {folder}: {error.strerror}") from None


def _made(number: int, folder: Path, data: Path | None) -> MadeScene:
    file = scene_file(folder)
    if file is None:
        raise SpecError(f"{folder} has no scene: expected is one of {', '.join(FILES)}")
    refuse_links(folder)
    scene, truth = read_scene_file(file).spec, folder
    if data is not None and _photograph(folder) is None:
        truth = data / "scenes" / folder.resolve().name
    picture = _photograph(truth)
    if picture is None:
        of_data = "" if data is None else f", nor has {truth}"
        hint = "; --data names the data set of scenes without one" if data is None else ""
        raise SpecError(
            f"{folder} has no photograph{of_data}: expected is {' or '.join(PHOTOS)}{hint}"
        )
    photo = load_photo(picture)
    tree = None
    if (truth / "tree.json").is_file():
        tree = read_model(truth / "tree.json", SceneTree, SpecError, "a scene tree")
    camera = scene.camera or (None if tree is None else tree.camera)
    if camera is None:
        raise SpecError(f"{folder}: the scene has no camera, so nothing can be compared")
    width, height = photo.original_size
    if abs(np.log(width / height * camera.height_px / camera.width)) > ASPECT:
        raise SpecError(
            f"{folder}: the photograph has {width} x {height} pixels and the scene's camera "
            f"{camera.width} x {camera.height_px}: expected is the same aspect"
        )
    nodes = () if tree is None else tree.nodes
    boxes = {node.name: node.box2d.as_tuple() for node in nodes if not node.environment}
    return MadeScene(number, folder.resolve().name, scene, camera, photo, boxes)


def _photograph(folder: Path) -> Path | None:
    return next((folder / name for name in PHOTOS if (folder / name).is_file()), None)


def _window_side(middle: float, side: float, room: float) -> tuple[float, float]:
    """Return an interval around a center, moved and cropped into the image."""
    side = min(side, room)
    low = min(max(middle - side / 2, 0.0), room - side)
    return low, low + side


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
