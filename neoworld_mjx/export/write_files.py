"""Writes objects and scenes in all formats that a run folder contains."""

from pathlib import Path

from ..errors import ExportError
from ..io.files import write_inside
from ..spec import ObjectSpec, SceneSpec
from .meshes import mesh_files
from .textures import texture_files
from .write_drives import drives_text
from .write_mjcf import mjcf_text
from .write_scene_usd import scene_usd_text
from .write_sdf import sdf_text
from .write_urdf import srdf_text, urdf_text
from .write_usd import usd_text


def object_files(spec: ObjectSpec) -> dict[str, bytes]:
    """Return the contents of an object's files, by path relative to the object's folder."""
    return {
        **encoded(
            {
                "object.urdf": urdf_text(spec),
                "object.srdf": srdf_text(spec),
                "object.sdf": sdf_text(spec),
                "object.usda": usd_text(spec),
                "object.xml": mjcf_text(spec),
                **mesh_files(spec),
                "drives.xml": drives_text(spec, "object.xml"),
            }
        ),
        **texture_files(spec),
    }


def scene_files(scene: SceneSpec) -> dict[str, bytes]:
    """Return the contents of the files of a scene and its objects, by relative path."""
    result = encoded(
        {
            "scene.json": scene.to_json(),
            "scene.xml": mjcf_text(scene),
            "scene.usda": scene_usd_text(scene),
            "scene.sdf": sdf_text(scene),
            "drives.xml": drives_text(scene, "scene.xml"),
        }
    )
    for item in scene.objects:
        for path, content in object_files(item.spec).items():
            result[f"objects/{item.name}/{path}"] = content
    return result


def export_object(spec: ObjectSpec, out: Path) -> None:
    """Write object.urdf, .srdf, .sdf, .usda and .xml, drives.xml, meshes/, textures/ into a folder.

    Existing files are replaced. The same object always gives the same bytes.

    Raises:
        ExportError: a file cannot be written.
    """
    write_all(object_files(spec), out)


def export_scene(scene: SceneSpec, out: Path) -> None:
    """Write scene.json, .xml, .usda, .sdf and objects/<name>/ into a folder.

    scene.xml refers to the meshes and textures of the objects, and scene.usda refers to the USD
    files of the objects. If there are joints to drive, drives.xml is also written; it adds
    actuators to scene.xml. Objects are written at their final size.

    Raises:
        ExportError: a file cannot be written.
    """
    write_all(scene_files(scene), out)


def encoded(files: dict[str, str | None]) -> dict[str, bytes]:
    """Encode contents as UTF-8, and omit files whose content is None."""
    return {path: text.encode() for path, text in files.items() if text is not None}


def write_all(files: dict[str, bytes], out: Path) -> None:
    """Write files, given by paths relative to a folder, without following symbolic links.

    Raises:
        ExportError: a file cannot be written.
    """
    for path, content in files.items():
        try:
            out.mkdir(parents=True, exist_ok=True)
            write_inside(out, path, content, sync=False)
        except OSError as error:
            raise ExportError(f"cannot write {out / path}: {error.strerror}") from None
