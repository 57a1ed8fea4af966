"""An object with every shape and every type of joint, and short ways to describe others."""

import numpy as np

from neoworld_mjx.spec import (
    Box,
    Capsule,
    Cylinder,
    Ellipsoid,
    GeomSpec,
    HollowBox,
    JointSpec,
    Lathe,
    Material,
    Mimic,
    ObjectSpec,
    PartSpec,
    Prism,
    Site,
    Sphere,
)

WOOD = Material(name="wood", density=600, friction=0.4, rgba=(0.6, 0.4, 0.2, 1))
STEEL = Material(name="steel", density=7800, friction=0.2, rgba=(0.7, 0.7, 0.7, 1))
TURNED = (0.9, 0.1, 0.3, -0.2)


def geom(name, shape, pos=(0, 0, 0), material="wood", **more):
    return GeomSpec(name=name, shape=shape, pos=pos, material=material, **more)


def part(name, *geoms, **more):
    return PartSpec(name=name, geoms=geoms, **more)


def joint(name, kind, parent, child, pos=(0, 0, 0), axis=(0, 0, 1), **more):
    return JointSpec(name=name, type=kind, parent=parent, child=child, pos=pos, axis=axis, **more)


def single(name, shape, z=0.0):
    """An object of one wooden shape."""
    body = part("body", geom("body", shape, (0, 0, z)))
    return ObjectSpec(name=name, materials=(WOOD,), parts=(body,))


def cabinet():
    """Every shape, every joint type, axes of every kind, a mimic of each sort, names that clash."""
    hexagon = tuple((0.01 * np.cos(a), 0.01 * np.sin(a)) for a in np.arange(6) * np.pi / 3)
    case = HollowBox(size=(0.3, 0.4, 0.3), wall=0.015, open=("+x",))
    cup = Lathe(profile=((0, 0), (0.02, 0), (0.03, 0.05)), thickness=0.004, sectors=8)
    disc, cog = Cylinder(radius=0.03, height=0.01), Cylinder(radius=0.02, height=0.01)
    rail = Capsule(radius=0.01, length=0.1)
    parts = (
        part("links", geom("panel", Box(size=(0.02, 0.2, 0.3)), (0.16, -0.1, 0.15))),
        part("carcass", geom("case", case, (0, 0, 0.15))),
        part(
            "knob",
            geom("stem", Prism(outline=hexagon, height=0.04), (0.19, -0.18, 0.15), quat=TURNED),
            geom("halo", Sphere(radius=0.02), (0.2, -0.18, 0.15), role="visual"),
            geom("egg", Ellipsoid(radii=(0.01, 0.02, 0.03)), (0.2, -0.18, 0.15), "steel"),
        ),
        part(
            "drawer",
            geom("tray", HollowBox(size=(0.2, 0.15, 0.1), wall=0.01), (0, 0.1, 0.1)),
            geom("cup", cup, (0, 0.1, 0.06), quat=TURNED),
            geom("cup_1", Sphere(radius=0.01), (0, 0.1, 0.1), role="collision"),
            geom("rail", rail, (0, 0.05, 0.1), "steel", quat=TURNED),
            mass=0.7,
        ),
        part("wheel", geom("disc", disc, (0, 0.25, 0.2), quat=(1, 1, 0, 0))),
        part("flap", geom("flap", Box(size=(0.1, 0.1, 0.01)), (0, 0, 0.33))),
        part("cog", geom("cog", cog, (0, 0.1, 0.33))),
    )
    hinge = {
        "lower": -0.2, "upper": 1.6, "damping": 0.02, "friction": 0.01, "stiffness": 0.1,
        "armature": 0.003, "effort": 3.0, "velocity": 2.0,
    }  # fmt: skip
    slide = {"upper": 0.15, "damping": 0.5, "stiffness": 2.0, "friction": 0.3, "velocity": 0.5}
    scaled = Mimic(joint="slide", multiplier=5.0, offset=0.1)
    follow = {"lower": -0.1, "upper": 1.5, "mimic": scaled}
    gear = Mimic(joint="follow", multiplier=-2.0, offset=0.3)
    joints = (
        joint("grip", "fixed", "links", "knob", (0.17, -0.18, 0.15)),
        joint("hinge", "revolute", "carcass", "links", (0.15, 0, 0.1), (0.1, 0, 1), **hinge),
        joint("slide", "prismatic", "carcass", "drawer", (0.1, 0.1, 0.1), (1, 0, 0.05), **slide),
        joint("spin", "continuous", "drawer", "wheel", (0, 0.25, 0.2), (0, 1, 0)),
        joint("follow", "revolute", "carcass", "flap", (-0.05, 0, 0.32), (0, -1, 0), **follow),
        joint("gear", "continuous", "carcass", "cog", (0, 0.1, 0.32), (-1, 0, 0), mimic=gear),
    )
    return ObjectSpec(
        name="cabinet",
        label='a "cabinet"',
        materials=(WOOD, STEEL),
        parts=parts,
        joints=joints,
        sites=(Site(name="pull", part="knob", pos=(0.21, -0.18, 0.15)),),
    )
