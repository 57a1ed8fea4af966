"""Random trees of parts with every kind of joint, for round trips."""

import numpy as np

from neoworld_mjx.spec import (
    Box,
    Capsule,
    Cylinder,
    Ellipsoid,
    GeomSpec,
    JointSpec,
    Lathe,
    Material,
    Mimic,
    ObjectSpec,
    PartSpec,
    Site,
    Sphere,
)

KINDS = ("fixed", "revolute", "continuous", "prismatic", "ball")


def random_object(seed: int) -> ObjectSpec:
    """Return an object of 1 to 9 parts; the same seed gives the same object."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 10))
    materials = tuple(
        Material(
            name=f"stuff_{k}",
            density=float(rng.uniform(100, 8000)),
            friction=round(float(rng.uniform(0.1, 1.2)), 3),
            rgba=tuple(np.round(rng.uniform(0, 1, 3), 3).tolist()) + (1.0,),
        )
        for k in range(3)
    )
    parts = tuple(_part(rng, k) for k in range(count))
    joints: list[JointSpec] = []
    for k in range(1, count):
        joints.append(_joint(rng, k, joints))
    sites = tuple(
        Site(name=f"site_{k}", part=f"part_{rng.integers(count)}", pos=_vector(rng, 0.3))
        for k in range(2)
    )
    return ObjectSpec(
        name=f"tree_{seed}", materials=materials, parts=parts, joints=tuple(joints), sites=sites
    )


def _vector(rng: np.random.Generator, size: float) -> tuple[float, float, float]:
    x, y, z = rng.uniform(-size, size, 3).tolist()
    return x, y, z


def _part(rng: np.random.Generator, k: int) -> PartSpec:
    geoms = []
    for i in range(int(rng.integers(1, 4))):
        a, b, c = rng.uniform(0.02, 0.15, 3).tolist()
        shape = (
            Box(size=(a, b, c)),
            Cylinder(radius=a, height=b),
            Capsule(radius=a / 2, length=b),
            Sphere(radius=a),
            Ellipsoid(radii=(a, b, c)),
            Lathe(profile=((0, 0), (a / 2, 0), (a, b)), thickness=0.003, sectors=8),
        )[int(rng.integers(6))]
        quat = rng.normal(size=4)
        geoms.append(
            GeomSpec(
                name=f"geom_{k}_{i}",
                shape=shape,
                pos=_vector(rng, 0.2),
                quat=tuple((quat / np.linalg.norm(quat)).tolist()),
                material=f"stuff_{rng.integers(3)}",
            )
        )
    mass = float(rng.uniform(0.1, 5)) if rng.random() < 0.3 else None
    return PartSpec(name=f"part_{k}", geoms=tuple(geoms), mass=mass)


def _joint(rng: np.random.Generator, k: int, earlier: list[JointSpec]) -> JointSpec:
    kind = KINDS[int(rng.integers(5))]
    fields: dict[str, object] = {}
    if kind in ("revolute", "prismatic"):
        fields = {"lower": -float(rng.uniform(0, 1)), "upper": float(rng.uniform(0.1, 1))}
    if kind == "ball" and rng.random() < 0.5:
        fields = {"upper": float(rng.uniform(0.2, 1.5))}
    if kind != "fixed":
        low = {"ball": ("damping", "friction", "stiffness", "armature")}
        for name in low.get(
            kind, ("damping", "friction", "stiffness", "armature", "effort", "velocity")
        ):
            if rng.random() < 0.6:
                fields[name] = float(rng.uniform(0.01, 5))
    leaders = [j for j in earlier if j.type in ("revolute", "continuous", "prismatic")]
    if kind in ("revolute", "continuous", "prismatic") and leaders and rng.random() < 0.4:
        leader = leaders[int(rng.integers(len(leaders)))]
        fields["mimic"] = Mimic(
            joint=leader.name, multiplier=float(rng.uniform(-2, 2)), offset=float(rng.normal() / 5)
        )
    return JointSpec.model_validate(
        {
            "name": f"joint_{k}",
            "type": kind,
            "parent": f"part_{rng.integers(k)}",
            "child": f"part_{k}",
            "pos": _vector(rng, 0.2),
            "axis": tuple(rng.normal(size=3).tolist()),
            **fields,
        }
    )
