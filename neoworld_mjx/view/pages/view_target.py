"""Target of `neoworld view`: a run folder, a scene, an object or a program."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ...config import Config
from ...errors import PhotoError, RunError, SpecError
from ...io import read_arrays
from ...parse.photo import load_photo
from ...run_folder import refuse_links
from ...spec import ObjectSpec, SceneObject, SceneSpec, read_scene

OBJECT_FILES = (".urdf", ".xml", ".mjcf", ".usd", ".usda", ".usdc", ".usdz")
"""Suffixes of files that `import_object` reads, or refuses with the name of a converter."""
"""Suffixes of object files."""
SHOWN_PX = 1024
"""Longest side of the photograph on the page, in pixels."""
HISTORY = "refine/history.npz"


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
    scene_file: Path | None = None
    """The scene.json, if the scene is not part of a run."""
    program: Path | None = None
    """The program, if the target is a program that is not part of a run."""
    picture: NDArray | None = None
    """The photograph, uint8 [h, w, 3], if it is available."""

    def history(self) -> dict[str, Any] | None:
        """Read the history of the search; return None if there is no history.

        Raises:
            RunError: the file is damaged.
        """
        if self.run is None or not (self.run / HISTORY).is_file():
            return None
        return read_arrays(self.run / HISTORY, RunError)

    def program_of(self, name: str) -> Path | None:
        """Return the file of an object's program; None if the object has no program."""
        if self.program is not None:
            return self.program
        object_folder = self.object_folder(name)
        if object_folder is None:
            return None
        paths = (object_folder / file for file in ("resized.py", "program.py"))
        return next((path for path in paths if path.is_file()), None)

    def object_folder(self, name: str) -> Path | None:
        """Return the folder of an object's files; None if it does not exist."""
        base = self.run or (None if self.scene_file is None else self.scene_file.parent)
        object_folder = None if base is None else base / "objects" / name
        return object_folder if object_folder is not None and object_folder.is_dir() else None


def open_target(path: Path, config: Config) -> ViewTarget:
    """Read a run folder, a scene.json, an object's folder, a URDF or MJCF file, or a program.

    Raises:
        SpecError: the path contains none of these, or cannot be read.
        ProgramError: the program does not build an object.
        RunError: the run folder contains links or damaged files.
    """
    if path.is_dir():
        refuse_links(path)
        if (path / "run.json").is_file():
            return _run_target(path)
        for name in ("scene.json", "resized.py", "program.py", "verified.json", "spec.json"):
            if (path / name).is_file():
                return open_target(path / name, config)
        raise SpecError(
            f"{path} is not a run folder and contains no scene.json, program.py or spec.json: name "
            "a run folder, a scene.json, a program (.py), or a URDF or MJCF file"
        )
    is_spec = path.name in ("spec.json", "verified.json")
    if is_spec or path.suffix == ".py" or path.suffix.lower() in OBJECT_FILES:
        from ...verify.checking import object_of_file

        spec = object_of_file(path, config.program)
        program = path if path.suffix == ".py" else None
        return ViewTarget(
            spec.name if is_spec else path.name, single_object_scene(spec), program=program
        )
    if path.exists() and path.suffix != ".json":
        raise SpecError(
            f"{path}: expected a run folder, a scene.json, an object's folder, a program (.py), a "
            "URDF or an MJCF file"
        )
    scene = read_scene(path)
    folders = (path.parent, path.parent.parent) if path.parent.name == "compose" else (path.parent,)
    picture = next((p for folder in folders if (p := _picture(folder)) is not None), None)
    return ViewTarget(path.name, scene, scene_file=path, picture=picture)


def single_object_scene(spec: ObjectSpec) -> SceneSpec:
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
