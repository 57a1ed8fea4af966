"""Small objects and scenes that tests share, and stored larger scenes."""

import functools
import math
from pathlib import Path

import numpy as np
from neoworld_bench.engines import table_scenes

from neoworld_mjx.physics import model
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.spec import (
    CSG,
    Box,
    Camera,
    Capsule,
    Cylinder,
    Ellipsoid,
    HollowBox,
    Lathe,
    Material,
    Mimic,
    ObjectSpec,
    Operand,
    Prism,
    SceneObject,
    SceneSpec,
    Site,
    Sphere,
    read_scene,
    recentred,
)
from tests.support.mechanisms import geom, joint, part

WOOD = Material(name="wood", density=600, friction=0.5, rgba=(0.5, 0.3, 0.1, 1))
CERAMIC = Material(name="ceramic", density=2300, friction=0.4, rgba=(0.9, 0.9, 0.85, 1))
STEEL = Material(name="steel", density=7800, friction=0.3, rgba=(0.6, 0.6, 0.65, 1))


STORED = Path(__file__).parent / "stored_scenes"
"""Tables with 2, 3 and 6 objects (crowded_*), scenes with visible boxes and depths (photo_*), and
three blocks of which two overlap, none overlaps, or the third is turned (three_*)."""


def stored_scene(name):
    """Read a scene of STORED."""
    return read_scene(STORED / f"{name}.json")


def compile_scene(scene, **options):
    """Return the compiled scene, one for all equal scenes and options of a process.

    JAX compiles functions of a SceneModel again for another one, even if it is equal.
    """
    return _compiled(scene.to_json(), tuple(sorted(options.items())))


@functools.lru_cache(maxsize=64)
def _compiled(scene, options):
    return model.compile_scene(SceneSpec.model_validate_json(scene), **dict(options))


def single(name, *shapes, material=WOOD):
    """One rigid object of shapes, each (shape, pos) or (shape, pos, quat)."""
    return table_scenes.single(name, *shapes, material=material)


def block(name, size=(0.06, 0.06, 0.06)):
    """A wooden box with edges of `size` [m]."""
    return single(name, (Box(size=size), (0, 0, 0)))


def table(size=(0.6, 0.8, 0.04)):
    return single("table", (Box(size=size), (0, 0, 0)))


def saucer():
    return single(
        "saucer",
        (Cylinder(radius=0.03, height=0.004), (0, 0, 0.002)),
        (Lathe(profile=((0, 0.003), (0.03, 0.003), (0.075, 0.015)), thickness=0.004), (0, 0, 0)),
        material=CERAMIC,
    )


def cup():
    bowl = Lathe(
        profile=((0, 0.003), (0.022, 0.003), (0.035, 0.03), (0.04, 0.06)),
        thickness=0.004,
        sectors=12,
    )
    return single(
        "cup",
        (Cylinder(radius=0.02, height=0.004), (0, 0, 0.002)),
        (bowl, (0, 0, 0)),
        (Box(size=(0.03, 0.008, 0.03)), (0.05, 0, 0.035)),
        material=CERAMIC,
    )


def spoon():
    flat = (math.sqrt(0.5), 0, math.sqrt(0.5), 0)
    return single(
        "spoon",
        (Capsule(radius=0.003, length=0.1), (0, 0, 0), flat),
        (Ellipsoid(radii=(0.02, 0.014, 0.005)), (0.06, 0, 0)),
        material=STEEL,
    )


def cabinet():
    """A carcass with a drawer, a door, a mimic knob, sites and an authored mass."""
    body = HollowBox(size=(0.4, 0.5, 0.5), wall=0.02, open=("+x",))
    tray, leaf = HollowBox(size=(0.36, 0.44, 0.12), wall=0.01), Box(size=(0.02, 0.44, 0.26))
    handle = Prism(outline=((0.01, 0), (0, 0.01), (-0.01, 0), (0, -0.01)), height=0.02)
    parts = (
        part("carcass", geom("carcass", body, (0, 0, 0.25))),
        part("drawer", geom("tray", tray, (0, 0, 0.1))),
        part("door", geom("leaf", leaf, (0.19, 0, 0.33)), mass=1.5),
        part("knob", geom("knob", handle, (0.21, 0.18, 0.33), "steel")),
    )
    slide = {"upper": 0.3, "damping": 2.0, "friction": 1.0, "effort": 30.0, "armature": 0.05}
    hinge = {"lower": -1.5, "upper": 0.1, "damping": 0.1, "friction": 0.05, "stiffness": 0.01}
    turn = {"damping": 0.001, "mimic": Mimic(joint="slide", multiplier=2.0, offset=0.1)}
    joints = (
        joint("slide", "prismatic", "carcass", "drawer", axis=(1, 0, 0), **slide),
        joint("hinge", "revolute", "carcass", "door", (0.19, -0.22, 0.33), **hinge),
        joint("turn", "continuous", "door", "knob", (0.21, 0.18, 0.33), (1, 0, 0), **turn),
    )
    sites = (Site(name="handle", part="drawer", pos=(0.18, 0, 0.1)),)
    materials = (WOOD, STEEL)
    return recentred(
        ObjectSpec(name="cabinet", materials=materials, parts=parts, joints=joints, sites=sites)
    )


def on_table(*items, name="scene"):
    """A static table with things on it, each (spec, xy, yaw, extra fields)."""
    objects = [SceneObject(name="table", spec=table(), environment=True, xy=(0.5, 0), z=-0.04)]
    for spec, xy, yaw, extra in items:
        objects.append(
            SceneObject(
                **{"name": spec.name, "spec": spec, "parent": "table", "z": 0.04, **extra},
                xy=xy,
                yaw=yaw,
            )
        )
    camera = Camera(width=600, height_px=400, fovy=0.6, height=0.4, pitch=0.7)
    return SceneSpec(name=name, objects=tuple(objects), camera=camera)


def coffee():
    return on_table(
        (saucer(), (0, 0), 0.0, {}),
        (cup(), (0.012, 0), 0.3, {"parent": "saucer", "z": 0.007}),
        (spoon(), (0.01, -0.05), 0.2, {"parent": "saucer", "z": 0.01}),
        name="coffee",
    )


def blocks():
    """Two boxes and a ball: primitives that every engine carries."""
    low = single("low", (Box(size=(0.1, 0.1, 0.06)), (0, 0, 0)))
    high = single("high", (Box(size=(0.06, 0.06, 0.05)), (0, 0, 0)))
    ball = single("ball", (Sphere(radius=0.03), (0, 0, 0)), material=STEEL)
    return on_table(
        (low, (0, 0), 0.2, {}),
        (high, (0.01, 0.0), 0.4, {"parent": "low", "z": 0.06}),
        (ball, (0.0, 0.15), 0.0, {}),
        name="blocks",
    )


def furnished():
    """A free cabinet with its drawer open and a block in the drawer, and a leaning board."""
    block = single("block", (Box(size=(0.05, 0.05, 0.04)), (0, 0, 0)))
    board = single("board", (Box(size=(0.02, 0.1, 0.2)), (0, 0, 0)))
    lean = (math.cos(0.1), 0, math.sin(0.1), 0)
    return on_table(
        (cabinet(), (0, 0), 0.1, {"joint_state": {"slide": 0.2, "turn": 0.5}}),
        (
            block,
            (0.05, 0.02),
            0.3,
            {"parent": "cabinet", "parent_link": "drawer", "relation": "in", "z": 0.05},
        ),
        (board, (-0.24, 0.1), 0.0, {"relation": "leaning", "base_tilt": lean}),
        name="furnished",
    )


def lamp():
    """A drilled foot with a head on a ball, its base free and the head turned."""
    drilled = CSG(
        operation="difference",
        operands=(
            Operand(shape=Box(size=(0.1, 0.12, 0.04))),
            Operand(shape=Cylinder(radius=0.02, height=0.2), pos=(0.01, 0, 0)),
        ),
        sectors=8,
    )
    pole = geom("pole", Box(size=(0.02, 0.02, 0.2)), (-0.035, 0, 0.14))
    foot = part("foot", geom("foot", drilled, (0, 0, 0.02)), pole)
    head = part("head", geom("head", Box(size=(0.06, 0.04, 0.03)), (0, 0, 0.27)))
    turns = {"upper": 0.9, "damping": 0.002, "friction": 0.001, "stiffness": 0.02}
    neck = joint("neck", "ball", "foot", "head", (-0.035, 0, 0.25), armature=1e-5, **turns)
    spec = ObjectSpec(name="lamp", materials=(WOOD,), parts=(foot, head), joints=(neck,))
    state = {"neck.x": 0.2, "neck.y": 0.3, "neck.z": -0.1}
    return on_table((recentred(spec), (0, 0), 0.3, {"joint_state": state}), name="lit")


def changed(scene: SceneSpec, name: str, /, **update: object) -> SceneSpec:
    """Return a scene in which fields of one object are others."""
    objects = (o.model_copy(update=update) if o.name == name else o for o in scene.objects)
    return scene.model_copy(update={"objects": tuple(objects)})


def without(scene: SceneSpec, name: str) -> SceneSpec:
    """Return a scene that lacks one object."""
    objects = tuple(o for o in scene.objects if o.name != name)
    return scene.model_copy(update={"objects": objects})


def random_layout(scene, pop, seed=0, spread=0.3):
    """Layouts with 1 cm and 17 degrees of noise, and scales up to exp(+-spread)."""
    rng = np.random.default_rng(seed)
    free = np.asarray(scene.optimised, float)
    n = len(free)
    return Layout(
        np.asarray(rng.normal(0, 0.01, (pop, n, 2)) * free[:, None], np.float32),
        np.asarray(rng.normal(0, 0.3, (pop, n)) * free, np.float32),
        np.asarray(rng.uniform(-spread, spread, (pop, n)) * free, np.float32),
    )
