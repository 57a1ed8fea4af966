"""Made scenes with their photographs: run folders, and the scenes of the data set."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from ...errors import ConfigError, SpecError
from ...parse.photo import Photo, load_photo
from ...reading import read_model
from ...render import View, render_scene
from ...spec import Camera, SceneSpec, SceneTree, read_scene

PHOTOS = ("photo.png", "picture.png")
"""Names of the photograph: in a run folder, and in a scene of the data set."""
MARGIN = 0.12
"""Room around an object's box on each side, over its longer side."""
ASPECT = 0.01
"""Largest difference of the logarithms of photograph's and camera's aspect."""

Rgb = UInt8[np.ndarray, "h w 3"]


@dataclass(frozen=True)
class MadeScene:
    """A made scene and the photograph that it was made from."""

    number: int
    """Of the scene among those that were opened, from 0."""
    name: str
    """The folder's."""
    scene: SceneSpec
    camera: Camera
    photo: Photo
    boxes: dict[str, tuple[float, float, float, float]]
    """What the photograph shows of each object but the environment, where a tree says: a box in
    the camera's pixels.
    """

    @property
    def numbered(self) -> str:
        """Number and name, by which files of several scenes can be told apart."""
        return f"{self.number:02d}_{self.name}"

    def whole(self, side: int) -> tuple[Rgb, Rgb]:
        """Return photograph and rendering; a smaller photograph is not enlarged.

        Args:
            side: largest length of the longer side [px].
        """
        width, height = self.photo.size
        factor = min(1.0, side / max(width, height))
        size = (max(1, round(width * factor)), max(1, round(height * factor)))
        shown = Image.fromarray(self.photo.rgb).resize(size, Image.Resampling.LANCZOS)
        view = View.of(self.camera, *size)
        return np.asarray(shown), render_scene(self.scene, view).color

    def part(self, name: str, side: int) -> tuple[Rgb, Rgb]:
        """Return photograph and rendering around an object: a square, if the picture has room.

        Args:
            name: an object of `boxes`.
            side: length of the longer side [px].
        """
        window = x0, y0, x1, y1 = self._window(name)
        view = View.through(self.camera, window, side)
        scale = self.photo.size[0] / self.camera.width
        cut = Image.fromarray(self.photo.rgb).resize(
            (view.width, view.height),
            Image.Resampling.LANCZOS,
            box=(scale * x0, scale * y0, scale * x1, scale * y1),
        )
        return np.asarray(cut), render_scene(self.scene, view).color

    def _window(self, name: str) -> tuple[float, float, float, float]:
        x0, y0, x1, y1 = self.boxes[name]
        side = (1 + 2 * MARGIN) * max(x1 - x0, y1 - y0)
        left, right = _placed((x0 + x1) / 2, side, self.camera.width)
        top, bottom = _placed((y0 + y1) / 2, side, self.camera.height_px)
        return left, top, right, bottom


def made_scenes(folders: Sequence[Path]) -> list[MadeScene]:
    """Open run folders, scenes of the data set, and whole data sets.

    Raises:
        ConfigError: no folder is given.
        SpecError: a folder has no scene, no camera or no photograph, or they do not fit.
        PhotoError: a photograph cannot be read.
    """
    if not folders:
        raise ConfigError(
            "name at least one run folder, or a folder that `neoworld bench make` wrote"
        )
    single: list[Path] = []
    for folder in folders:
        data_set = (folder / "dataset.json").is_file()
        single += sorted((folder / "scenes").iterdir()) if data_set else [folder]
    return [_made(number, folder) for number, folder in enumerate(single)]


def _made(number: int, folder: Path) -> MadeScene:
    scene = read_scene(folder)
    file = next((folder / name for name in PHOTOS if (folder / name).is_file()), None)
    if file is None:
        raise SpecError(f"{folder} has no photograph: expected is {' or '.join(PHOTOS)}")
    photo = load_photo(file)
    camera = scene.camera
    if camera is None:
        raise SpecError(f"{folder}: the scene has no camera, so nothing can be compared")
    width, height = photo.original_size
    if abs(np.log(width / height * camera.height_px / camera.width)) > ASPECT:
        raise SpecError(
            f"{folder}: the photograph has {width} x {height} pixels and the scene's camera "
            f"{camera.width} x {camera.height_px}: expected is the same aspect"
        )
    boxes = {}
    if (folder / "tree.json").is_file():
        tree = read_model(folder / "tree.json", SceneTree, SpecError, "a scene tree")
        names = {item.name for item in scene.objects if not item.environment}
        boxes = {n.name: n.box2d.as_tuple() for n in tree.nodes if n.name in names}
    return MadeScene(number, folder.resolve().name, scene, camera, photo, boxes)


def _placed(middle: float, side: float, room: float) -> tuple[float, float]:
    """Return the ends of an interval of a length about a middle, moved and cut into the room."""
    side = min(side, room)
    low = min(max(middle - side / 2, 0.0), room - side)
    return low, low + side
