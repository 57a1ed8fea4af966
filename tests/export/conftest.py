import numpy as np
import pytest

from neoworld_mjx.spec import (
    Box,
    Camera,
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
    SceneObject,
    SceneSpec,
    Site,
    Sphere,
)

WOOD = Material(name="wood", density=600, friction=0.4, rgba=(0.6, 0.4, 0.2, 1))
STEEL = Material(name="steel", density=7800, friction=0.2, rgba=(0.7, 0.7, 0.7, 1))
TURNED = (0.9, 0.1, 0.3, -0.2)


def _geom(name, shape, pos, material="wood", **more):
    return GeomSpec(name=name, shape=shape, pos=pos, material=material, **more)


@pytest.fixture(scope="session")
def cabinet() -> ObjectSpec:
    """Every shape, every joint type, axes of every kind, a mimic of each sort, names that clash."""
    hexagon = tuple((0.01 * np.cos(a), 0.01 * np.sin(a)) for a in np.arange(6) * np.pi / 3)
    cup = Lathe(profile=((0, 0), (0.02, 0), (0.03, 0.05)), thickness=0.004, sectors=8)
    parts = (
        PartSpec(
            name="links", geoms=(_geom("panel", Box(size=(0.02, 0.2, 0.3)), (0.16, -0.1, 0.15)),)
        ),
        PartSpec(
            name="carcass",
            geoms=(
                _geom(
                    "case", HollowBox(size=(0.3, 0.4, 0.3), wall=0.015, open=("+x",)), (0, 0, 0.15)
                ),
            ),
        ),
        PartSpec(
            name="knob",
            geoms=(
                _geom(
                    "stem", Prism(outline=hexagon, height=0.04), (0.19, -0.18, 0.15), quat=TURNED
                ),
                _geom("halo", Sphere(radius=0.02), (0.2, -0.18, 0.15), role="visual"),
                _geom("egg", Ellipsoid(radii=(0.01, 0.02, 0.03)), (0.2, -0.18, 0.15), "steel"),
            ),
        ),
        PartSpec(
            name="drawer",
            mass=0.7,
            geoms=(
                _geom("tray", HollowBox(size=(0.2, 0.15, 0.1), wall=0.01), (0, 0.1, 0.1)),
                _geom("cup", cup, (0, 0.1, 0.06), quat=TURNED),
                _geom("cup_1", Sphere(radius=0.01), (0, 0.1, 0.1), role="collision"),
                _geom(
                    "rail", Capsule(radius=0.01, length=0.1), (0, 0.05, 0.1), "steel", quat=TURNED
                ),
            ),
        ),
        PartSpec(
            name="wheel",
            geoms=(
                _geom(
                    "disc", Cylinder(radius=0.03, height=0.01), (0, 0.25, 0.2), quat=(1, 1, 0, 0)
                ),
            ),
        ),
        PartSpec(name="flap", geoms=(_geom("flap", Box(size=(0.1, 0.1, 0.01)), (0, 0, 0.33)),)),
        PartSpec(
            name="cog", geoms=(_geom("cog", Cylinder(radius=0.02, height=0.01), (0, 0.1, 0.33)),)
        ),
    )
    joints = (
        JointSpec(name="grip", type="fixed", parent="links", child="knob", pos=(0.17, -0.18, 0.15)),
        JointSpec(
            name="hinge",
            type="revolute",
            parent="carcass",
            child="links",
            pos=(0.15, 0, 0.1),
            axis=(0.1, 0, 1),
            lower=-0.2,
            upper=1.6,
            damping=0.02,
            friction=0.01,
            stiffness=0.1,
            armature=0.003,
            effort=3.0,
            velocity=2.0,
        ),
        JointSpec(
            name="slide",
            type="prismatic",
            parent="carcass",
            child="drawer",
            pos=(0.1, 0.1, 0.1),
            axis=(1, 0, 0.05),
            upper=0.15,
            damping=0.5,
            stiffness=2.0,
            friction=0.3,
            velocity=0.5,
        ),
        JointSpec(
            name="spin",
            type="continuous",
            parent="drawer",
            child="wheel",
            pos=(0, 0.25, 0.2),
            axis=(0, 1, 0),
        ),
        JointSpec(
            name="follow",
            type="revolute",
            parent="carcass",
            child="flap",
            pos=(-0.05, 0, 0.32),
            axis=(0, -1, 0),
            lower=-0.1,
            upper=1.5,
            mimic=Mimic(joint="slide", multiplier=5.0, offset=0.1),
        ),
        JointSpec(
            name="gear",
            type="continuous",
            parent="carcass",
            child="cog",
            pos=(0, 0.1, 0.32),
            axis=(-1, 0, 0),
            mimic=Mimic(joint="follow", multiplier=-2.0, offset=0.3),
        ),
    )
    return ObjectSpec(
        name="cabinet",
        label='a "cabinet"',
        materials=(WOOD, STEEL),
        parts=parts,
        joints=joints,
        sites=(Site(name="pull", part="knob", pos=(0.21, -0.18, 0.15)),),
    )


def simple(name: str, shape, z: float = 0.0) -> ObjectSpec:
    return ObjectSpec(
        name=name,
        materials=(WOOD,),
        parts=(PartSpec(name="body", geoms=(_geom("body", shape, (0, 0, z)),)),),
    )


@pytest.fixture(scope="session")
def scene(cabinet) -> SceneSpec:
    """A table, an open cabinet on it, a bowl in the cabinet's drawer, another cabinet fastened."""
    bowl = Lathe(profile=((0, 0), (0.02, 0), (0.03, 0.02)), thickness=0.003)
    state = {"hinge": 0.8, "slide": 0.1, "spin": 2.0}
    return SceneSpec(
        objects=(
            SceneObject(
                name="physics",
                spec=simple("table", Box(size=(1, 1, 0.04)), 0.02),
                environment=True,
                yaw=0.2,
            ),
            SceneObject(
                name="box",
                spec=cabinet,
                parent="physics",
                xy=(0.1, -0.2),
                z=0.05,
                yaw=0.7,
                base_tilt=(0.99, 0.1, 0.0, 0.0),
                joint_state=state,
            ),
            SceneObject(
                name="bowl", spec=simple("bowl", bowl), parent="box", parent_link="drawer", z=0.1
            ),
            SceneObject(
                name="fastened",
                spec=cabinet,
                parent="physics",
                fixed_base=True,
                xy=(0.1, 0.4),
                z=0.05,
                yaw=-0.7,
                joint_state={"slide": 0.05},
            ),
        ),
        camera=Camera(width=300, height_px=200, fovy=0.7, height=0.5, pitch=0.6),
    )
