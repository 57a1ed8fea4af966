"""URDF, USD and MJCF of objects and scenes, and back."""

from .mechanism import Mechanism, mechanism, read_mjcf, read_urdf
from .mjcf import mjcf_text
from .read_usd import read_usd, world_links_usd
from .urdf import urdf_text
from .usd import usd_text
from .usd_scene import scene_usd_text
from .write import export_object, export_scene, object_files, scene_files

__all__ = [
    "Mechanism",
    "export_object",
    "export_scene",
    "mechanism",
    "mjcf_text",
    "object_files",
    "read_mjcf",
    "read_urdf",
    "read_usd",
    "scene_files",
    "scene_usd_text",
    "urdf_text",
    "usd_text",
    "world_links_usd",
]
