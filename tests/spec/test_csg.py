"""CSG: an exact decomposition that never overlaps, against manifold3d's own boolean."""

import manifold3d
import mujoco
import numpy as np
import pytest
from pydantic import ValidationError

from neoworld_mjx.spec import CSG, Box, Cylinder, HollowBox, Lathe, Operand, Sphere
from neoworld_mjx.spec.convex import mass_properties, planes
from neoworld_mjx.spec.shapes import convex_operands

LYING = (1.0, 1.0, 0.0, 0.0)
BLOCK = Box(size=(0.2, 0.2, 0.1))


def made(operation, *operands, **more) -> CSG:
    placed = tuple(
        Operand(shape=o[0], pos=o[1], quat=(*o, LYING)[2] if len(o) > 2 else (1, 0, 0, 0))
        for o in operands
    )
    return CSG(operation=operation, operands=placed, **more)


CASES = {
    "pocket": made("difference", (BLOCK, (0, 0, 0)), (Box(size=(0.1, 0.1, 0.1)), (0, 0, 0.05))),
    "bored": made("difference", (BLOCK, (0, 0, 0)), (Cylinder(radius=0.05, height=0.3), (0, 0, 0))),
    "bored_twice": made(
        "difference",
        (BLOCK, (0, 0, 0)),
        (Cylinder(radius=0.05, height=0.3), (0, 0, 0)),
        (Cylinder(radius=0.03, height=0.3), (0, 0, 0), LYING),
    ),
    "dish": made("difference", (BLOCK, (0, 0, 0)), (Sphere(radius=0.06), (0, 0, 0.05)), sectors=12),
    "cross": made(
        "union",
        (Cylinder(radius=0.05, height=0.3), (0, 0, 0)),
        (Cylinder(radius=0.03, height=0.3), (0, 0, 0), LYING),
    ),
    "row": made("union", *((Box(size=(0.1, 0.1, 0.1)), (0.1 * k, 0, 0)) for k in range(5))),
    "dice": made(
        "intersection", (Box(size=(0.1,) * 3), (0, 0, 0)), (Sphere(radius=0.07), (0, 0, 0))
    ),
    "notched_cup": made(
        "difference",
        (Lathe(profile=((0, 0), (0.04, 0), (0.05, 0.1)), thickness=0.004), (0, 0, 0)),
        (Box(size=(0.03, 0.2, 0.05)), (0, 0, 0.1)),
    ),
    "crate_with_grips": made(
        "difference",
        (HollowBox(size=(0.3, 0.2, 0.2), wall=0.01), (0, 0, 0)),
        (Cylinder(radius=0.02, height=0.4), (-0.04, 0, 0.05), LYING),
        (Box(size=(0.08, 0.4, 0.04)), (0, 0, 0.05)),
        (Cylinder(radius=0.02, height=0.4), (0.04, 0, 0.05), LYING),
    ),
}


def solid(shape) -> float:
    return sum(mass_properties(piece)[0] for piece in shape.pieces())


@pytest.mark.parametrize("name", CASES)
def test_pieces_have_the_volume_of_manifolds_boolean(name: str):
    shape = CASES[name]
    meshes = []
    for operand in shape.operands:
        hulls = [
            manifold3d.Manifold.hull_points(np.ascontiguousarray(body.corners))
            for body, _ in convex_operands(operand, shape.sectors)
        ]
        meshes.append(manifold3d.Manifold.batch_boolean(hulls, manifold3d.OpType.Add))
    kinds = {"union": "Add", "difference": "Subtract", "intersection": "Intersect"}
    kind = getattr(manifold3d.OpType, kinds[shape.operation])
    truth = manifold3d.Manifold.batch_boolean(meshes, kind).volume()
    assert solid(shape) == pytest.approx(truth, rel=1e-9)


@pytest.mark.parametrize("name", CASES)
def test_pieces_do_not_overlap_and_compile_in_mujoco(name: str):
    shape = CASES[name]
    random = np.random.default_rng(0)
    corners = np.vstack([np.array(piece.vertices) for piece in shape.pieces()])
    points = random.uniform(corners.min(axis=0), corners.max(axis=0), (4000, 3))
    half = [planes(piece) for piece in shape.pieces()]
    depth = np.array([(p[:, 3] - points @ p[:, :3].T).min(axis=1) for p in half])
    assert np.sum(depth > 1e-9, axis=0).max() <= 1 and np.sum(depth > 1e-9) > 100
    model = mujoco.MjSpec()
    for k, piece in enumerate(shape.pieces()):
        mesh = model.add_mesh(name=f"m{k}")
        mesh.uservert = np.array(piece.vertices).ravel()
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
        model.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"m{k}")
    assert model.compile().ngeom == len(shape.pieces())


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (
            lambda: made("difference", (Box(size=(0.1,) * 3), (0, 0, 0)), (BLOCK, (0, 0, 0))),
            "nothing",
        ),
        (lambda: made("intersection", (BLOCK, (0, 0, 0)), (BLOCK, (1, 0, 0))), "nothing"),
        (lambda: made("union", (BLOCK, (0, 0, 0)), (BLOCK, (1, 0, 0))), "2 separate solids"),
        (
            lambda: made("difference", (BLOCK, (0, 0, 0)), (Box(size=(0.02, 1, 1)), (0, 0, 0))),
            "2 separate solids",
        ),
        (
            lambda: made(
                "difference",
                (Box(size=(2, 2, 0.1)), (0, 0, 0)),
                *(
                    (Sphere(radius=0.06), (0.15 * i - 1, 0.15 * k - 1, 0))
                    for i in range(8)
                    for k in range(7)
                ),
                sectors=48,
            ),
            "convex pieces",
        ),
        (lambda: made("union", (BLOCK, (0, 0, 0))), "at least 2"),
    ],
)
def test_impossible_csg_is_refused_with_the_reason(make, words: str):
    with pytest.raises(ValidationError, match=words):
        make()
