"""Read a path's scene, object, or program of an object."""

from dataclasses import dataclass
from pathlib import Path

from ..config import ProgramOptions
from ..errors import SpecError
from ..export.importing import FILES, MESHES, POSES, USD, ImportedScene, import_file, only_object
from ..export.object_of_mechanism import Imported
from ..io import read_model, read_untrusted_text
from ..program import BuildResult, build
from ..spec import ObjectSpec, read_scene
from .patch import Patch, apply, read_patch


@dataclass(frozen=True)
class PatchedProgram:
    """The result of building the program in a file and applying the program's patch."""

    file: Path
    text: str
    built: BuildResult
    patched: ObjectSpec | None
    """The object; None if the program builds no object."""
    patch: Patch | None = None
    """The patch; None if the program has no patch."""
    stale: tuple[str, ...] = ()
    """Parts, joints, geoms and materials that the patch edits but the object lacks."""
    notes: tuple[str, ...] = ()

    @property
    def spec(self) -> ObjectSpec:
        """The object.

        Raises:
            SpecError: the program builds no object.
        """
        if self.patched is None:
            raise SpecError(f"{self.file} builds no object: {self.built.errors}")
        return self.patched


Target = ImportedScene | Imported | PatchedProgram
"""Content of a path. Each has a `spec` (a SceneSpec or an ObjectSpec) and `notes`."""


def read_target(path: Path, options: ProgramOptions, *, alone: bool = False) -> Target:
    """Read a run folder, a scene.json, an object's folder, a program, or another program's file.

    Args:
        path: the path.
        options: sandbox, limits and thresholds of programs.
        alone: if True, a file with one object and its fixed surroundings is read as the object.

    Raises:
        SpecError: the path contains none of these, or cannot be read.
    """
    if path.is_dir() and not any((path / name).is_file() for name in ("scene.json", "run.json")):
        files = [path / name for name in ("program.py", "spec.json") if (path / name).is_file()]
        if not files:
            raise SpecError(
                f"{path} is no run folder with a scene, and contains no program.py or spec.json"
            )
        path = files[0]
    suffix = path.suffix.lower()
    if suffix == ".py":
        return build_patched(path, options)
    if path.name == "spec.json":
        return Imported(read_model(path, ObjectSpec, SpecError, "an object"), ())
    if path.is_dir() or not path.exists() or (suffix == ".json" and path.name != POSES):
        return ImportedScene(read_scene(path), ())
    if suffix not in (*FILES, *MESHES, *USD, ".json"):
        raise SpecError(
            f"{path}: expected a run folder or a scene.json, an object's folder, a program (.py), "
            "a URDF, MJCF or glTF file"
        )
    imported = import_file(path)
    lone = only_object(imported) if alone and isinstance(imported, ImportedScene) else None
    return lone or imported


def build_patched(program: Path, options: ProgramOptions) -> PatchedProgram:
    """Build the program in a file, and apply the program's patch to the object.

    Args:
        program: the file.
        options: sandbox, limits and thresholds.

    Raises:
        SpecError: the program or patch cannot be read, or the patched object is invalid.
    """
    text = read_untrusted_text(program, SpecError)
    built = build(text, options)
    patch = read_patch(program)
    if patch is None or built.spec is None:
        return PatchedProgram(program, text, built, built.spec, patch)
    spec, stale = apply(patch, built.spec)
    return PatchedProgram(program, text, built, spec, patch, stale)
