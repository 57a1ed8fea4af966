"""Scene tree and programs that an annotation defines.

The camera, the 2D box of an object and the height of its support do not determine the object's
depth (its extent along the view). The depth follows from the kind of the object: a template fixes
the ratio of depth to width, and a shape is as deep as it is wide. A known size is used unchanged.
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from ..errors import SpecError
from ..spec import Box2D, Box3D, Camera, Cues, SceneTree, TreeNode
from ..spec.pose import from_yaw, rotate
from ..spec.tree import parents_first
from ..templates import template
from ..templates.template import BOX
from .annotation import (
    EXISTING_PROGRAM,
    GROUND,
    SHAPES,
    WRITTEN_BY_MODEL,
    AnnotatedObject,
    Annotation,
)

THICKNESS_M = 0.03
"""Thickness of the ground [m]."""
_MIN_EDGE_M, _MAX_DISTANCE_M = 0.004, 100.0
RGB = tuple[float, float, float]
_LATHE = "body.add(lathe([(0, 0), ({inner!r}, 0), ({r!r}, {z!r})], thickness={wall!r}))"
_CALLS = {
    "box": ("box", "body.add(box(({x!r}, {y!r}, {z!r})), by='bottom')"),
    "cylinder": ("cylinder", "body.add(cylinder({r!r}, {z!r}), by='bottom')"),
    "ball": ("sphere", "body.add(sphere({r!r}), by='bottom')"),
    "bowl": ("lathe", _LATHE),
    "cup": ("lathe", _LATHE),
}
"""SDK function that creates a shape, and the program line that calls the function, by kind."""


def annotated_tree(annotation: Annotation) -> SceneTree:
    """Return the scene tree that an annotation describes.

    Raises:
        SpecError: there are no objects, a box lies above the horizon, or the tree is invalid.
    """
    if not annotation.objects:
        raise SpecError("the annotation has no objects: draw a box first")
    camera = annotation.camera
    by_name = {obj.name: obj for obj in annotation.objects}
    boxes: dict[str, Box3D] = {}
    for name in parents_first(annotation.parents()):
        obj = by_name[name]
        level = 0.0
        if obj.parent != GROUND:
            parent = boxes[obj.parent]
            inside = obj.relation == "in" or by_name[obj.parent].kind == "bowl"
            level = parent.position[2] + (0.0 if inside else parent.size[2])
        boxes[name] = placed_box(obj, camera, level)
    nodes = [_ground(annotation, list(boxes.values()))]
    nodes += [
        TreeNode(
            name=obj.name,
            label=obj.label or obj.name,
            parent=obj.parent,
            relation=obj.relation,
            environment=obj.support,
            fixed_base=obj.fixed_base,
            box2d=obj.box,
            box3d=boxes[obj.name],
            articulation=obj.parts,
            cues=Cues(known_size=("x", "y", "z") if obj.size else ()),
        )
        for obj in annotation.objects
    ]
    try:
        return SceneTree(camera=camera, nodes=tuple(nodes))
    except ValueError as error:
        raise SpecError(f"the annotation: {error}") from None


def placed_box(obj: AnnotatedObject, camera: Camera, level: float) -> Box3D:
    """Return a 3D box for an object such that the object's projection fills its 2D box.

    Args:
        obj: the object.
        camera: camera of the photograph.
        level: height of the object's support surface [m].

    Raises:
        SpecError: the lower edge of the 2D box is above the horizon of the support surface.
    """
    left, top, right, bottom = obj.box.as_tuple()
    ray = camera.rays([(left + right) / 2, bottom])
    drop = camera.height - level
    if ray[2] >= -1e-3 or drop <= 0 or drop / -ray[2] > _MAX_DISTANCE_M:
        raise SpecError(
            f"object {obj.name}: the lower edge of its box is above the horizon of its parent: "
            "draw the box again, or increase the pitch of the camera"
        )
    foot = camera.position() + ray * (drop / -ray[2])
    _, depth = camera.project(foot)
    scale = float(depth) / camera.focal
    yaw = math.radians(obj.yaw_deg)
    ratio = _depth_ratio(obj)
    width, height = (
        max((right - left) * scale, _MIN_EDGE_M),
        max((bottom - top) * scale, _MIN_EDGE_M),
    )
    direction = foot[:2] / max(float(np.linalg.norm(foot[:2])), 1e-6)
    target = np.array([left, top, right, bottom])
    known = None if obj.size is None else np.array(obj.size)

    def box(u: NDArray) -> tuple[NDArray, NDArray]:
        size = known
        if size is None:
            size = np.exp(u[2]) * np.array([ratio, 1.0, np.exp(u[3])])
        return np.array([u[0], u[1], level]), size

    def residuals(u: NDArray) -> NDArray:
        position, size = box(u)
        pixels, depths = camera.project(_outline(obj.kind, size, yaw) + position)
        if (depths <= 1e-3).any():
            return np.full(len(u), 1e4)
        projected = np.concatenate([pixels.min(axis=0), pixels.max(axis=0)])
        error = (projected - target) / max(right - left, bottom - top)
        # The unknowns are the position and, unless the size is known, the width and the height.
        return error if known is None else np.array([error[[0, 2]].sum(), error[3]])

    center = foot[:2] + direction * width / 2
    shape = [] if known is not None else [np.log(width), np.log(0.5 * height / width)]
    initial = np.array([*center, *shape])
    solution = least_squares(residuals, initial, x_scale="jac", max_nfev=200)
    position, size = box(solution.x)
    x, y, z = (float(round(max(v, _MIN_EDGE_M), 5)) for v in size)
    return Box3D(
        position=(round(float(position[0]), 5), round(float(position[1]), 5), level),
        size=(x, y, z),
        yaw=yaw,
    )


def annotation_from_tree(tree: SceneTree) -> Annotation:
    """Return the annotation of an existing scene tree.

    Objects keep their sizes and programs. The first support of the environment becomes the ground;
    other supports stand on it.
    """
    ground = next((n for n in tree.top_down() if n.environment), None)
    others = {n.name for n in tree.nodes if n is not ground} - {GROUND}
    objects = tuple(
        AnnotatedObject(
            name=n.name,
            label=n.label[:100],
            kind=EXISTING_PROGRAM,
            box=n.box2d,
            parent=n.parent if n.parent in others else GROUND,
            relation=n.relation,
            support=n.environment,
            fixed_base=n.fixed_base,
            size=n.box3d.size,
            yaw_deg=math.degrees(math.remainder(n.box3d.yaw, 2 * math.pi)),
            parts=n.articulation,
        )
        for n in tree.top_down()
        if n is not ground
    )
    return Annotation(camera=tree.camera, objects=objects)


def program_of(obj: AnnotatedObject, size: tuple[float, float, float], rgb: RGB) -> str | None:
    """Return the program of an annotated object.

    The result is None if the object is a support of the environment, if it keeps its existing
    program, or if a model writes its program.

    Args:
        obj: the object.
        size: edge lengths of the object's box [m].
        rgb: color of the object, 0 to 1.
    """
    if obj.kind in (WRITTEN_BY_MODEL, EXISTING_PROGRAM) or obj.support:
        return None
    if obj.kind not in SHAPES:
        object_template = template(obj.kind)
        return object_template.program(dict(object_template.of_box(size)))
    x, y, z = (round(v, 4) for v in size)
    r = round(min(x, y) / 2, 4)
    wall = round(min(max(0.06 * r, 0.002), 0.6 * r, 0.4 * z), 4)
    inner = round((0.5 if obj.kind == "bowl" else 0.75) * r, 4)
    red, green, blue = (round(v, 3) for v in rgb)
    function, line = _CALLS[obj.kind]
    return (
        f"from neoworld_mjx.program.sdk import Object, {function}\n\n"
        f'thing = Object("{obj.name}")\n'
        f'look = thing.material("{obj.material}_seen", like="{obj.material}", '
        f"rgb=({red}, {green}, {blue}))\n"
        'body = thing.part("body", material=look)\n'
        f"{line.format(x=x, y=y, z=z, r=r, wall=wall, inner=inner)}\n"
    )


def _depth_ratio(obj: AnnotatedObject) -> float:
    """Return the ratio of the object's depth to its width."""
    if obj.kind in (*SHAPES, WRITTEN_BY_MODEL, EXISTING_PROGRAM):
        return 1.0
    depth, width, _ = (float(template(obj.kind).parameters[name].default) for name in BOX)
    return depth / width


def _outline(kind: str, size: NDArray, yaw: float) -> NDArray:
    """Return points that bound the silhouette of an object at the origin [m], shape [n, 3]."""
    if kind in ("cylinder", "ball", "bowl", "cup"):
        angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
        ring = np.column_stack([np.cos(angle), np.sin(angle)]) * size[:2] / 2
        low = {"bowl": 0.5, "cup": 0.75, "ball": 0.7}.get(kind, 1.0)
        rings = [(low, 0.0), (1.0, 0.5 if kind == "ball" else 1.0)]
        rings += [(low, 1.0)] if kind == "ball" else []
        local = np.concatenate(
            [np.column_stack([ring * r, np.full(24, h * size[2])]) for r, h in rings]
        )
    else:
        corners = [(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0.0, 1.0)]
        local = np.array(corners) * size
    return rotate(from_yaw(yaw), local)


def _ground(annotation: Annotation, boxes: list[Box3D]) -> TreeNode:
    """Return the ground, whose top is at z = 0 and extends beyond all objects."""
    camera = annotation.camera
    corners = np.concatenate([box.corners()[:, :2] for box in boxes])
    low, high = corners.min(axis=0), corners.max(axis=0)
    margin = 0.6 * float(np.max(high - low)) + 0.02
    x, y = (high - low + 2 * margin).round(4).tolist()
    cx, cy = ((low + high) / 2).round(4).tolist()
    image_box = Box2D(x0=0, y0=0, x1=camera.width, y1=camera.height_px)
    return TreeNode(
        name=GROUND,
        label=annotation.ground,
        environment=True,
        box2d=image_box,
        box3d=Box3D(position=(cx, cy, -THICKNESS_M), size=(x, y, THICKNESS_M)),
    )
