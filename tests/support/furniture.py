"""Small furniture that passes the object tests; tests change one joint field of it."""

from neoworld_mjx.spec import Box, GeomSpec, JointSpec, Material, ObjectSpec, PartSpec, recentred

WOOD = Material(name="wood", density=600, friction=0.5)


def geom(name, size, pos, material="wood"):
    return GeomSpec(name=name, shape=Box(size=size), pos=pos, material=material)


def cupboard(**joint):
    """A carcass of boards with a door before its front, hinged at its left edge."""
    walls = (
        geom("back", (0.02, 0.4, 0.5), (-0.14, 0, 0.25)),
        geom("left", (0.3, 0.02, 0.5), (0, 0.19, 0.25)),
        geom("right", (0.3, 0.02, 0.5), (0, -0.19, 0.25)),
        geom("floor", (0.3, 0.36, 0.02), (0, 0, 0.01)),
        geom("top", (0.3, 0.36, 0.02), (0, 0, 0.49)),
    )
    hinge = {
        "name": "hinge", "type": "revolute", "parent": "carcass", "child": "door",
        "pos": (0.1505, 0.2, 0.25), "axis": (0, 0, 1), "upper": 1.57, "damping": 0.2,
        "friction": 0.02,
    }  # fmt: skip
    return recentred(
        ObjectSpec(
            name="cupboard",
            materials=(WOOD,),
            parts=(
                PartSpec(name="carcass", geoms=walls),
                PartSpec(name="door", geoms=(geom("leaf", (0.018, 0.4, 0.5), (0.1595, 0, 0.25)),)),
            ),
            joints=(JointSpec.model_validate({**hinge, **joint}),),
        )
    )


def chest(**joint):
    """An open box with a drawer in it that slides out to the front."""
    walls = (
        geom("back", (0.02, 0.4, 0.2), (-0.19, 0, 0.1)),
        geom("left", (0.4, 0.02, 0.2), (0, 0.19, 0.1)),
        geom("right", (0.4, 0.02, 0.2), (0, -0.19, 0.1)),
        geom("floor", (0.4, 0.36, 0.02), (0, 0, 0.01)),
    )
    slide = {
        "name": "slide", "type": "prismatic", "parent": "carcass", "child": "drawer",
        "axis": (1, 0, 0), "upper": 0.5, "damping": 5.0, "friction": 1.0,
    }  # fmt: skip
    tray = geom("tray", (0.36, 0.35, 0.1), (0.01, 0, 0.071))
    return recentred(
        ObjectSpec(
            name="chest",
            materials=(WOOD,),
            parts=(PartSpec(name="carcass", geoms=walls), PartSpec(name="drawer", geoms=(tray,))),
            joints=(JointSpec.model_validate({**slide, **joint}),),
        )
    )
