"""Ray-cast pictures of scenes and objects, the same on every machine, without OpenGL."""

from .picture import render_object, render_scene, to_png
from .plain import render_plain
from .raycast import Picture, render
from .view import View

__all__ = ["Picture", "View", "render", "render_object", "render_plain", "render_scene", "to_png"]
