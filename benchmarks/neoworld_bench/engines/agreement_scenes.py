"""Six scenes on which engines must agree, each with a different difficulty."""

import math
from collections.abc import Callable

from neoworld_mjx.spec import (
    Capsule,
    Cylinder,
    Ellipsoid,
    GeomSpec,
    HollowBox,
    JointSpec,
    ObjectSpec,
    PartSpec,
    Prism,
    SceneObject,
    SceneSpec,
    recentred,
)

from .table_scenes import (
    CERAMIC,
    FLAT,
    TOP,
    WOOD,
    Noise,
    block,
    crowded,
    polygon,
    single,
    standing,
    table,
)


def stack() -> SceneSpec:
    """Four blocks on each other."""
    sizes = (0.09, 0.075, 0.065, 0.06)
    objects, parent, z = [table()], "table", TOP
    for k, s in enumerate(sizes):
        spec = block(f"block_{k}", s, s, 0.05)
        objects.append(standing(spec, parent, (0.0, 0.0), z, 0.2 * k))
        parent, z = spec.name, 0.05
    return SceneSpec(name="stack", objects=tuple(objects))


def cluttered() -> SceneSpec:
    """Six objects close to each other on a table."""
    return crowded(6, seed=3).model_copy(update={"name": "cluttered"})


def cabinet() -> SceneSpec:
    """A free cabinet with its drawer open, a block in the drawer and two objects on its top."""
    carcass = GeomSpec(
        name="carcass",
        shape=HollowBox(size=(0.3, 0.3, 0.24), wall=0.02, open=("+x",)),
        pos=(0, 0, 0.12),
        material="wood",
    )
    tray = GeomSpec(
        name="tray",
        shape=HollowBox(size=(0.26, 0.25, 0.1), wall=0.01),
        pos=(0, 0, 0.1),
        material="wood",
    )
    slide = JointSpec(
        name="slide",
        type="prismatic",
        parent="body",
        child="drawer",
        axis=(1, 0, 0),
        upper=0.2,
        damping=4.0,
        friction=6.0,
        armature=0.05,
    )
    spec = recentred(
        ObjectSpec(
            name="cabinet",
            materials=(WOOD,),
            parts=(PartSpec(name="body", geoms=(carcass,)), PartSpec(name="drawer", geoms=(tray,))),
            joints=(slide,),
        )
    )
    inside = block("block", 0.05, 0.05, 0.04)
    vase = single("vase", (Cylinder(radius=0.025, height=0.12), (0, 0, 0)), material=CERAMIC)
    box = block("box", 0.08, 0.06, 0.05)
    return SceneSpec(
        name="cabinet",
        objects=(
            table(1.0, 1.0),
            standing(spec, "table", (0, 0), TOP, joint_state={"slide": 0.12}),
            standing(
                inside,
                "cabinet",
                (0.05, 0.0),
                0.07,
                0.3,
                parent_link="drawer",
                relation="in",
            ),
            standing(vase, "cabinet", (-0.12, 0.12), 0.24),
            standing(box, "cabinet", (-0.1, -0.1), 0.24, 0.2),
        ),
    )


def container() -> SceneSpec:
    """An open box with a ball, a block and a prism inside."""
    outline = polygon(5, 0.03)
    bin_ = single("bin", (HollowBox(size=(0.24, 0.2, 0.07), wall=0.008), (0, 0, 0)))
    ball = single("ball", (Ellipsoid(radii=(0.03, 0.03, 0.015)), (0, 0, 0)))
    return SceneSpec(
        name="container",
        objects=(
            table(),
            standing(bin_, "table", (0, 0), TOP),
            standing(block("block", 0.05, 0.05, 0.04), "bin", (-0.06, 0.03), 0.008, relation="in"),
            standing(ball, "bin", (0.0, -0.04), 0.008, relation="in"),
            standing(
                single("prism", (Prism(outline=outline, height=0.04), (0, 0, 0))),
                "bin",
                (0.06, 0.03),
                0.008,
                relation="in",
            ),
        ),
    )


def leaning() -> SceneSpec:
    """A board that leans against a wall, and two blocks beside it."""
    lean = 0.2
    tilt = (math.cos(lean / 2), 0.0, math.sin(lean / 2), 0.0)
    wall = SceneObject(
        name="wall",
        spec=block("wall", 0.04, 0.5, 0.3),
        environment=True,
        xy=(0.2, 0.0),
        z=0.0,
    )
    thick, tall = 0.012, 0.16
    board = block("board", thick, 0.1, tall)
    # The upper edge of the board's far face touches the wall.
    reach = tall * math.sin(lean) + thick / 2 * math.cos(lean)
    return SceneSpec(
        name="leaning",
        objects=(
            table(),
            wall,
            standing(board, "table", (0.18 - reach, 0.1), TOP, relation="leaning", base_tilt=tilt),
            standing(block("book", 0.1, 0.1, 0.03), "table", (-0.15, -0.1), TOP),
            standing(block("foot", 0.06, 0.09, 0.03), "table", (0.02, -0.1), TOP),
        ),
    )


def mixed() -> SceneSpec:
    """Convex pieces of every kind, in stacks of two and three."""
    hexagon = polygon(6, 0.045)
    wedge = ((-0.04, -0.03), (0.04, -0.03), (0.025, 0.03), (-0.025, 0.03))
    mallet = single(
        "mallet",
        (Capsule(radius=0.012, length=0.1), (0, 0, 0.012), FLAT),
        (
            Cylinder(radius=0.02, height=0.05),
            (0.07, 0, 0.02),
            (math.sqrt(0.5), math.sqrt(0.5), 0, 0),
        ),
    )
    return SceneSpec(
        name="mixed",
        objects=(
            table(),
            standing(
                single("hex", (Prism(outline=hexagon, height=0.05), (0, 0, 0))),
                "table",
                (-0.12, 0),
                TOP,
            ),
            standing(
                single("drum", (Cylinder(radius=0.035, height=0.05), (0, 0, 0))),
                "hex",
                (0, 0),
                0.05,
            ),
            standing(block("brick", 0.05, 0.04, 0.03), "drum", (0, 0), 0.05),
            standing(
                single("wedge", (Prism(outline=wedge, height=0.04), (0, 0, 0))),
                "table",
                (0.05, 0.1),
                TOP,
            ),
            standing(block("tile", 0.06, 0.04, 0.015), "wedge", (0, 0), 0.04),
            standing(mallet, "table", (0.03, -0.12), TOP),
        ),
    )


_SCALES = (0.7, 1.4)

AGREEMENT: dict[str, tuple[Callable[[], SceneSpec], Noise]] = {
    "stack": (stack, Noise(xy=0.22, scales=_SCALES)),
    "cluttered": (cluttered, Noise(xy=0.12, scales=_SCALES)),
    "cabinet": (cabinet, Noise(xy=0.4, scales=_SCALES)),
    "container": (container, Noise(xy=0.22, scales=_SCALES)),
    "leaning": (leaning, Noise(xy=0.04, yaw=0.05, scales=_SCALES)),
    "mixed": (mixed, Noise(xy=0.22, scales=_SCALES)),
}
"""Scenes on which engines are compared, each with noise that fails 30 to 70 % of layouts.
"""
