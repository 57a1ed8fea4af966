"""Target of `neoworld view` and `render`: a run folder, a scene, an object or a program."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..config import Config
from ..errors import PhotoError, SpecError
from ..export.importing import FILES, USD, ImportedScene, import_file
from ..parse.photo import load_photo
from ..run_folder import refuse_links
from ..spec import ObjectSpec, SceneObject, SceneSpec, read_scene

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
        for name in ("scene.json", "program.py", "spec.json"):
            if (path / name).is_file():
                return open_target(path / name, config)
        raise SpecError(
            f"{path} is not a run folder and contains no scene.json, program.py or spec.json: name "
            "a run folder, a scene.json, a program (.py), or a URDF, MJCF or glTF file"
        )
    if path.suffix.lower() in (*FILES, *USD):
        imported = import_file(path)
        if isinstance(imported, ImportedScene):
            return ViewTarget(path.name, imported.spec)
        return ViewTarget(path.name, fixed_object_scene(imported.spec))
    is_spec = path.name == "spec.json"
    if is_spec or path.suffix == ".py":
        from ..verify.checking import object_of_file

        spec = object_of_file(path, config.program)
        return ViewTarget(spec.name if is_spec else path.name, fixed_object_scene(spec))
    if path.exists() and path.suffix != ".json":
        raise SpecError(
            f"{path}: expected a run folder, a scene.json, an object's folder, a program (.py), a "
            "URDF, MJCF or glTF file"
        )
    scene = read_scene(path)
    folders = (path.parent, path.parent.parent) if path.parent.name == "compose" else (path.parent,)
    picture = next((p for folder in folders if (p := _picture(folder)) is not None), None)
    return ViewTarget(path.name, scene, picture=picture)


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
