"""The SDK of object programs: parts made of shapes, joints between parts, materials, sites.

A program creates one `Object`, adds parts to it, adds shapes to the parts, and connects the parts
by joints. All coordinates are in the frame of the object with all joints at zero: +x is the front,
+y is left and +z is up. Units are meters and radians. The program chooses the origin, and the build
moves it to the center of the bounding box's bottom face.

A call with invalid arguments raises ValueError or TypeError. `neoworld_mjx.program.build` checks
the whole object and returns signals. Programs are type-checked against the
signatures in `sdk.pyi`, which a test compares with those of the SDK.
"""

from .loft import loft
from .part import Geom, Joint, Part, Shape
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
    grid,
    hollow_box,
    intersection,
    lathe,
    mirror,
    panel,
    prism,
    ring,
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
    "loft",
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
