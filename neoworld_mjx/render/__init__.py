"""Render scenes and objects by ray casting.

Rendering needs no OpenGL and gives the same pixels on every machine.
"""

from .flat_rendering import render_plain
from .rendering import render
from .scene_images import (
    render_object,
    render_scene,
    to_png,
    visible_surface,
)
from .view import View

__all__ = [
    "View",
    "render",
    "render_object",
    "render_plain",
    "render_scene",
    "to_png",
    "visible_surface",
]
