"""Write objects and scenes in every format, as a run folder has them."""

from pathlib import Path

from ..errors import ExportError
from ..spec import ObjectSpec, SceneSpec
from .meshes import mesh_files
from .write_mjcf import mjcf_text
from .write_scene_usd import scene_usd_text
from .write_urdf import urdf_text
from .write_usd import usd_text


def object_files(spec: ObjectSpec) -> dict[str, str]:
    """Return the files of one object: path relative to its folder, and text."""
    return {
        "object.urdf": urdf_text(spec),
        "object.usda": usd_text(spec),
        "object.xml": mjcf_text(spec),
        **mesh_files(spec),
    }


def scene_files(scene: SceneSpec) -> dict[str, str]:
    """Return the files of a scene and its objects: path relative to its folder, and text."""
    files = {
        "scene.json": scene.to_json(),
        "scene.xml": mjcf_text(scene),
        "scene.usda": scene_usd_text(scene),
    }
    for item in scene.objects:
        for path, text in object_files(item.spec).items():
            files[f"objects/{item.name}/{path}"] = text
    return files


def export_object(spec: ObjectSpec, out: Path) -> None:
    """Write object.urdf, object.usda, object.xml and meshes/ into a folder.

    Files that are there are replaced; the same object gives the same bytes.

    Raises:
        ExportError: a file cannot be written.
    """
    _write(object_files(spec), out)


def export_scene(scene: SceneSpec, out: Path) -> None:
    """Write scene.usda, scene.xml, scene.json and objects/<name>/ into a folder.

    scene.xml needs no other file; scene.usda refers to the objects' USD files beside it. Objects
    are written as they are in the scene, in their final size.

    Raises:
        ExportError: a file cannot be written.
    """
    _write(scene_files(scene), out)


def _write(files: dict[str, str], out: Path) -> None:
    for path, text in files.items():
        target = out / path
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(text.encode())
        except OSError as error:
            raise ExportError(f"cannot write {target}: {error.strerror}") from None


__all__ = ["export_object", "export_scene", "object_files", "scene_files"]
