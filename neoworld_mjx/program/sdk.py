"""The SDK of object programs: parts made of shapes, joints between parts, materials, sites.

A program creates one `Object`, gives it parts, adds shapes to them and joins them. All coordinates
are in the frame of the object at rest, in metres and radians: +x front, +y left, +z up. The program
chooses the origin; the build moves it to the center of the bounding box's bottom face. Invalid
arguments raise ValueError or TypeError at the call; `neoworld_mjx.program.build` reports signals of
the whole object. Programs are type-checked against `sdk.pyi`, which
`python -m neoworld_mjx.program.stubs --write` generates from the signatures.
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
