"""Scenes of meshes that stand, and the same as a method without physics would leave them."""

from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from neoworld_mjx.export.importing import scene_of_assemblies
from neoworld_mjx.export.read_mesh_scene import mesh_object

TABLE_Z = 0.4
SINK_M, TILT_DEG, WRONG = 0.02, 5.0, 0.1


def carton(rng):
    """Return a box that stands on its bottom, with its origin there [m]."""
    size = rng.uniform([0.08, 0.06, 0.05], [0.16, 0.12, 0.16])
    return lifted(trimesh.creation.box(extents=size))


def can(rng):
    """Return a cylinder."""
    radius, height = rng.uniform(0.03, 0.045), rng.uniform(0.07, 0.12)
    return lifted(trimesh.creation.cylinder(radius=radius, height=height, sections=48))


def prism(rng):
    """Return a prism of six sides."""
    return lifted(
        trimesh.creation.cylinder(radius=0.05, height=rng.uniform(0.05, 0.12), sections=6)
    )


def bracket(rng):
    """Return an L that stands on its foot, which is no convex shape."""
    foot = trimesh.creation.box(extents=(0.16, 0.1, 0.03))
    wall = trimesh.creation.box(extents=(0.03, 0.1, 0.1))
    wall.apply_translation((-0.065, 0, 0.064))
    return lifted(trimesh.boolean.union([foot, wall], engine="manifold"))


def lifted(mesh):
    """Return a mesh with its lowest point at height 0."""
    mesh.apply_translation((0, 0, -mesh.bounds[0, 2]))
    return mesh


KINDS = {"carton": carton, "can": can, "prism": prism, "bracket": bracket}
PLACES = [(-0.2, -0.25), (-0.2, 0.0), (-0.2, 0.25), (0.12, -0.25), (0.12, 0.0), (0.12, 0.25)]


def standing(seed: int):
    """Return meshes and poses [4, 4] of a table with three to five objects, some with another."""
    rng = np.random.default_rng(seed)
    table = trimesh.creation.box(extents=(0.8, 1.0, 0.04))
    lifted(table)
    pose = np.eye(4)
    pose[:3, 3] = (0.9, 0.0, TABLE_Z - 0.04)
    objects = {"table": (table, pose)}
    count = int(rng.integers(3, 6))
    for k, place in enumerate(rng.permutation(PLACES)[:count]):
        kind = str(rng.choice(list(KINDS)))
        mesh = KINDS[kind](rng)
        position = np.array([0.9 + place[0], place[1], TABLE_Z]) + [*rng.uniform(-0.04, 0.04, 2), 0]
        objects[f"{kind}_{k}"] = mesh, upright(position, rng.uniform(-np.pi, np.pi))
        if kind == "carton" and rng.random() < 0.5:
            small = lifted(trimesh.creation.box(extents=0.5 * mesh.extents))
            top = position + [0, 0, mesh.extents[2]]
            objects[f"upper_{k}"] = small, upright(top, rng.uniform(-np.pi, np.pi))
    return objects


def upright(at, yaw: float) -> np.ndarray:
    """Return a pose at a place [3] with a heading."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_euler("z", yaw).as_matrix(), at
    return pose


def disturbed(objects, seed: int):
    """Return the objects with wrong sizes (10 %), 2 cm too low, and tilted about their middles."""
    rng = np.random.default_rng(seed + 1000)
    result = {}
    for name, (mesh, pose) in objects.items():
        if name == "table":
            result[name] = mesh, pose
            continue
        angle = rng.uniform(-np.pi, np.pi)
        axis = np.array([np.cos(angle), np.sin(angle), 0.0])
        tilted = pose.copy()
        turn = Rotation.from_rotvec(np.radians(TILT_DEG) * axis).as_matrix()
        middle = pose[:3, :3] @ mesh.bounds.mean(axis=0) + pose[:3, 3]
        tilted[:3, :3] = turn @ pose[:3, :3] * (1 + rng.uniform(-WRONG, WRONG))
        tilted[:3, 3] = middle - tilted[:3, :3] @ mesh.bounds.mean(axis=0) - [0, 0, SINK_M]
        result[name] = mesh, tilted
    return result


def scene_of_meshes(objects):
    """Return an imported scene of meshes at poses; none of them says that it is a support."""
    assemblies = [
        mesh_object(key, [(np.asarray(mesh.vertices), np.asarray(mesh.faces))], pose)
        for key, (mesh, pose) in objects.items()
    ]
    return scene_of_assemblies(Path("scene"), assemblies)
