"""Target of `neoworld view` and `render`: a run folder, a scene, an object or a program."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..config import Config
from ..errors import PhotoError, SpecError
from ..parse.photo import load_photo
from ..run_folder import refuse_links
from ..spec import ObjectSpec, SceneObject, SceneSpec, read_scene
from ..verify.read_target import read_target

SHOWN_PX = 1024
"""Longest side of the photograph on the page, in pixels."""


@dataclass(frozen=True)
class ViewTarget:
    """A scene and the files that belong to it."""

    title: str
    after: SceneSpec
    """The scene; if the run has a refined scene, the refined scene."""
    before: SceneSpec | None = None
    """The composed scene before the search, if the run also has a refined scene."""
    run: Path | None = None
    """Run folder of the scene, if the scene is part of a run."""
    picture: NDArray | None = None
    """The photograph, uint8 [h, w, 3], if it is available."""


def open_target(path: Path, config: Config) -> ViewTarget:
    """Read a run folder, a scene.json, an object's folder, a program, or another program's file.

    Raises:
        SpecError: the path contains none of these, or cannot be read.
        ProgramError: the program does not build an object.
        RunError: the run folder contains links or damaged files.
    """
    if path.is_dir():
        refuse_links(path)
        if (path / "run.json").is_file():
            return _run_target(path)
    spec = read_target(path, config.program).spec
    if isinstance(spec, ObjectSpec):
        return ViewTarget(spec.name, fixed_object_scene(spec))
    folder = path if path.is_dir() else path.parent
    folders = (folder, folder.parent) if folder.name == "compose" else (folder,)
    picture = next((p for folder in folders if (p := _picture(folder)) is not None), None)
    return ViewTarget(path.name, spec, picture=picture)


def fixed_object_scene(spec: ObjectSpec) -> SceneSpec:
    """Return a scene of one object that is fixed to the floor."""
    return SceneSpec(objects=(SceneObject(name=spec.name, spec=spec, fixed_base=True),))


def _run_target(folder: Path) -> ViewTarget:
    composed, refined = folder / "compose" / "scene.json", folder / "scene.json"
    scenes = [read_scene(path) for path in (composed, refined) if path.is_file()]
    if not scenes:
        raise SpecError(
            f"{folder} has no scene yet: continue with reconstruct --resume, or view one of its "
            "objects, such as objects/NAME"
        )
    return ViewTarget(
        folder.resolve().name,
        scenes[-1],
        before=scenes[0] if len(scenes) > 1 else None,
        run=folder,
        picture=_picture(folder),
    )


def _picture(folder: Path) -> NDArray | None:
    """Return the photograph of a run, reduced for the page; None if it is missing or damaged."""
    path = folder / "photo.png"
    if not path.is_file():
        return None
    try:
        rgb = load_photo(path).rgb
    except PhotoError:
        return None
    return shown_picture(rgb)


def shown_picture(rgb: NDArray) -> NDArray:
    """Return a picture reduced to at most `SHOWN_PX` per side, uint8 [h, w, 3]."""
    image = Image.fromarray(rgb)
    image.thumbnail((SHOWN_PX, SHOWN_PX))
    return np.asarray(image)
