"""The SDK of object programs: parts made of shapes, joints between parts, materials, sites.

A program makes one `Object`, gives it parts, adds shapes to them and joins them. Everything is in
one frame, the object's at rest, in metres and radians: +x its front, +y its left, +z up. Where the
origin lies is up to the program; it is moved to the centre of the bounding box's bottom face.
Wrong arguments raise ValueError or TypeError at the call; what can only be seen of the whole object
comes back as signals from `neoworld_mjx.program.build`. Programs are type-checked against `sdk.pyi`
beside this file, which `python -m neoworld_mjx.program.stubs --write` makes from the signatures.
"""

from .part import Geom, Joint, Part
from .patterns import grid, mirror, ring
from .placing import Shape
from .sdk_object import Object
from .shape_functions import (
    bail,
    box,
    capsule,
    cylinder,
    difference,
    ellipsoid,
    extrusion,
    frustum,
    hollow_box,
    intersection,
    lathe,
    panel,
    prism,
    rounded_box,
    sphere,
    sweep,
    torus,
    tube,
    union,
)

__all__ = [
    "Geom",
    "Joint",
    "Object",
    "Part",
    "Shape",
    "bail",
    "box",
    "capsule",
    "cylinder",
    "difference",
    "ellipsoid",
    "extrusion",
    "frustum",
    "grid",
    "hollow_box",
    "intersection",
    "lathe",
    "mirror",
    "panel",
    "prism",
    "ring",
    "rounded_box",
    "sphere",
    "sweep",
    "torus",
    "tube",
    "union",
]
