"""A desk with colored objects, its photograph, and the distance of a scene from another."""

import math

import numpy as np

from neoworld_mjx.estimate.unknowns import Unknowns
from neoworld_mjx.render import render
from neoworld_mjx.render.rasterize import draw_objects
from neoworld_mjx.spec import (
    Box,
    Box2D,
    Box3D,
    Camera,
    Cues,
    Cylinder,
    Material,
    SceneObject,
    SceneSpec,
    SceneTree,
    Sphere,
    TreeNode,
    bounds,
    world_poses,
)
from tests.support.scenes import single

TOP = 0.04
"""Thickness of the desk [m]."""
COLORS = {
    "red": (0.75, 0.1, 0.1, 1.0),
    "blue": (0.1, 0.2, 0.7, 1.0),
    "green": (0.1, 0.5, 0.15, 1.0),
    "yellow": (0.85, 0.7, 0.1, 1.0),
    "purple": (0.5, 0.1, 0.5, 1.0),
    "white": (0.9, 0.9, 0.9, 1.0),
    "gray": (0.5, 0.5, 0.5, 1.0),
    "clear": (0.8, 0.9, 0.9, 0.3),
}
CAMERA = Camera(width=640, height_px=480, fovy=0.75, height=0.55, pitch=0.55)


def colored(name, shape, color):
    material = Material(name=color, density=600, friction=0.5, rgba=COLORS[color])
    return single(name, (shape, (0, 0, 0)), material=material)


def block(name, x, y, z, color):
    return colored(name, Box(size=(x, y, z)), color)


def can(name, radius, height, color):
    return colored(name, Cylinder(radius=radius, height=height), color)


def on_desk(*items, camera=CAMERA, color="gray"):
    """A fixed desk in front of the camera with objects on it, each (spec, xy, yaw, more fields)."""
    desk = block("desk", 1.0, 1.2, TOP, color)
    objects = [SceneObject(name="desk", spec=desk, environment=True, xy=(0.9, 0.0), z=-TOP)]
    for spec, xy, yaw, more in items:
        fields = {"name": spec.name, "spec": spec, "parent": "desk", "z": TOP, **more}
        objects.append(SceneObject(**fields, xy=xy, yaw=yaw))
    return SceneSpec(name="desk", objects=tuple(objects), camera=camera)


def five():
    """Five objects of five colors, none hidden."""
    return on_desk(
        (block("box", 0.1, 0.08, 0.09, "red"), (-0.05, 0.18), 0.3, {}),
        (can("can", 0.04, 0.12, "blue"), (-0.02, -0.02), 0.0, {}),
        (block("brick", 0.12, 0.07, 0.06, "green"), (-0.1, -0.2), -0.4, {}),
        (colored("ball", Sphere(radius=0.045), "yellow"), (0.15, 0.1), 0.0, {}),
        (block("tower", 0.06, 0.06, 0.16, "purple"), (0.15, -0.15), 0.2, {}),
    )


def photograph(scene, width=480, *, floor=True):
    return render(scene, scene.camera, width=width, floor=floor).color


def boxed(scene):
    """The scene with 2D boxes of the visible pixels, in which nothing is hidden."""
    seen = drawn(scene, scene.camera.width).owner
    objects = []
    for k, item in enumerate(scene.objects):
        rows, columns = np.nonzero(seen == k)
        box = Box2D(
            x0=float(columns.min()),
            y0=float(rows.min()),
            x1=float(columns.max() + 1),
            y1=float(rows.max() + 1),
        )
        objects.append(item.model_copy(update={"box2d": box}))
    return scene.model_copy(update={"objects": tuple(objects)})


def parsed(scene, scales, *, ahead=0.0, cues=None, **tree):
    """The parse of a scene whose movable objects are `ahead` [m] and have sizes times `scales`."""
    nodes = []
    for item in boxed(scene).objects:
        x, y, z = world_poses(scene)[item.name].pos
        low, high = bounds(item.spec)
        at = (x + (0.0 if item.environment else ahead), y, z + low[2])
        size = tuple(((high - low) * scales.get(item.name, 1.0)).tolist())
        node = TreeNode(
            name=item.name,
            label="box",
            parent=item.parent,
            environment=item.environment,
            box2d=item.box2d,
            box3d=Box3D(position=at, size=size, yaw=item.yaw),
            cues=(cues or {}).get(item.name, Cues()),
        )
        nodes.append(node)
    return SceneTree(camera=scene.camera, nodes=tuple(nodes), **tree)


def unknowns_of(scene):
    return Unknowns.of(scene, scene.camera)


def drawn(scene, width):
    """The objects drawn at an image's width, as tests/estimate/test_rasterize.py checks it."""
    unknowns = unknowns_of(scene)
    now = unknowns.place(np.zeros((1, unknowns.size)))[0]
    meshes = [unknowns.mesh(now, k) for k in range(len(scene.objects))]
    return draw_objects(meshes, scene.camera, width)


def displaced(scene, **moves):
    """The scene with its objects displaced, each by (dx [mm], dy [mm], yaw [deg], size [%])."""
    unknowns = unknowns_of(scene)
    x = np.zeros(unknowns.size)
    for name, (dx, dy, yaw, size) in moves.items():
        own = (dx / 1000, dy / 1000, math.radians(yaw), math.log1p(size / 100))
        x[unknowns.columns(scene.index(name))] = own
    return unknowns.scene_at(x)


def misjudged(scene, degrees):
    """The scene of a field of view that is wider by some degrees, and the camera nearer."""
    unknowns, fovy = unknowns_of(scene), scene.camera.fovy
    x = np.zeros(unknowns.size)
    wrong = math.tan((fovy + math.radians(degrees)) / 2)
    x[2] = math.log(math.tan(fovy / 2) / wrong)
    return unknowns.scene_at(x)


def distances(scene, truth, *, common=True):
    """Distance of each object's origin from that of the truth [mm].

    Without `common`, the median offset of all objects does not count.
    """
    a, b = world_poses(scene), world_poses(truth)
    names = [item.name for item in truth.objects if item.parent is not None]
    offsets = 1000 * np.array([a[name].pos - b[name].pos for name in names])
    offsets -= 0.0 if common else np.median(offsets, axis=0)
    return dict(zip(names, np.linalg.norm(offsets, axis=1).tolist(), strict=True))


def turns(scene, truth):
    """Difference of each object's heading from that of the truth [deg]."""
    return {
        item.name: math.degrees(abs(scene.object(item.name).yaw - item.yaw))
        for item in truth.objects
        if item.parent is not None
    }
