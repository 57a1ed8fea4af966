"""What object programs call: parts made of shapes, joints between parts, materials, sites.

A program makes one `Object`, gives it parts, adds shapes to them and joins them. Everything is in
one frame, the object's at rest, in metres and radians: +x its front, +y its left, +z up. Where the
origin lies is up to the program; it is moved to the centre of the bounding box's bottom face.
Wrong arguments raise ValueError or TypeError at the call; what can only be seen of the whole object
comes back as signals from `neoworld_mjx.program.build`. Programs are type-checked against `sdk.pyi`
beside this file, which `python -m neoworld_mjx.program.stubs --write` makes from the signatures.
"""

from . import patterns, shape_functions
from .part import Geom, Joint, Part
from .patterns import *  # noqa: F403
from .placing import Shape
from .sdk_object import Object
from .shape_functions import *  # noqa: F403

__all__ = ["Geom", "Joint", "Object", "Part", "Shape"]
__all__ += shape_functions.__all__
__all__ += patterns.__all__
