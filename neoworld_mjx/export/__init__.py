"""Export of objects and scenes to MJCF, USD, URDF, SDF and glTF, and import of MJCF and URDF."""

from .formats import export_object, export_scene, object_files, scene_files
from .importing import import_file
from .read_mjcf import read_mjcf
from .read_urdf import read_urdf
from .write_mjcf import mjcf_text
from .write_urdf import urdf_text

__all__ = [
    "export_object",
    "export_scene",
    "import_file",
    "mjcf_text",
    "object_files",
    "read_mjcf",
    "read_urdf",
    "scene_files",
    "urdf_text",
]
