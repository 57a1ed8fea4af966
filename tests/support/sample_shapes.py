"""One of every shape, and of every way to make it, shared by the tests."""

import numpy as np

from neoworld_mjx.spec import (
    CSG,
    Box,
    Capsule,
    Cylinder,
    Ellipsoid,
    Extrusion,
    HollowBox,
    Lathe,
    Mesh,
    Operand,
    Prism,
    RoundedBox,
    Sphere,
    Sweep,
)

PATH = ((0, 0, 0), (0, 0, 0.05), (0.02, 0, 0.08), (0.05, 0, 0.08))
SHAPES = {
    "box": Box(size=(0.1, 0.2, 0.15)),
    "rounded_box": RoundedBox(size=(0.1, 0.2, 0.15), radius=0.02),
    "sphere": Sphere(radius=0.1),
    "capsule": Capsule(radius=0.05, length=0.1),
    "cylinder": Cylinder(radius=0.05, height=0.1),
    "ellipsoid": Ellipsoid(radii=(0.1, 0.06, 0.08)),
    "disc": Ellipsoid(radii=(0.1, 0.1, 0.03)),
    "prism": Prism(outline=((0, 0), (0.1, 0), (0.05, 0.1)), height=0.06),
    "extrusion": Extrusion(
        outline=((0, 0), (0.2, 0), (0.2, 0.05), (0.05, 0.05), (0.05, 0.2), (0, 0.2)), height=0.05
    ),
    "panel": Extrusion(
        outline=((0, 0), (0.2, 0), (0.2, 0.2), (0, 0.2)),
        holes=(((0.05, 0.05), (0.1, 0.05), (0.1, 0.15), (0.05, 0.15)),),
        height=0.02,
    ),
    "hollow_box": HollowBox(size=(0.1, 0.2, 0.15), wall=0.02, open=("+z", "+x")),
    "frustum": Lathe(profile=((0.05, 0), (0.02, 0.08))),
    "vase": Lathe(profile=((0.03, 0), (0.05, 0.04), (0.02, 0.1))),
    "cup": Lathe(profile=((0, 0), (0.03, 0), (0.04, 0.08)), thickness=0.004),
    "tube": Lathe(profile=((0.05, -0.05), (0.05, 0.05)), thickness=0.01),
    "oval": Lathe(profile=((0, 0), (0.03, 0), (0.04, 0.08)), thickness=0.006, oval=0.7),
    "sweep": Sweep(path=PATH, width=(0.02,), thickness=(0.015,)),
    "torus": Sweep(
        path=tuple((0.05 * np.cos(a), 0.05 * np.sin(a), 0.0) for a in np.arange(24) * np.pi / 12),
        width=(0.02,),
        thickness=(0.02,),
        closed=True,
    ),
    "csg": CSG(
        operation="difference",
        operands=(
            Operand(shape=Box(size=(0.2, 0.15, 0.1))),
            Operand(shape=Box(size=(0.16, 0.11, 0.1)), pos=(0, 0, 0.02)),
            Operand(shape=Cylinder(radius=0.02, height=0.3), quat=(1, 1, 0, 0)),
        ),
    ),
    "mesh": Mesh(
        vertices=((0, 0, 0), (0.1, 0, 0), (0, 0.1, 0), (0, 0, 0.1)),
        faces=((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)),
    ),
}  # fmt: skip
