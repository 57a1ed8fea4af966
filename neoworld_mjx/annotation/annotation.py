"""Annotation of a photograph by a person: boxes and labels become a scene tree and programs.

The box of an object, the camera and what carries it leave its depth along the view open. The kind
of the object closes that: a template knows how deep such things are, plain shapes are as deep as
wide, and a size that the person knows counts as it is.
"""

import math
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator
from scipy.optimize import least_squares

from ..errors import SpecError, choices
from ..program.materials import MATERIALS
from ..spec import Box2D, Box3D, Camera, Cues, Name, PartState, SceneTree, Spec, TreeNode
from ..spec.base import Length
from ..spec.forest import name_on_cycle, parents_first
from ..spec.pose import from_yaw, rotate
from ..spec.tree import Relation
from ..templates import template, templates
from ..templates.template import BOX

RGB = tuple[float, float, float]
GROUND = "ground"
"""Name of the support that every annotation has, with its top at z = 0."""
THICK_M = 0.03
MODEL = "left to a model"
"""Kind of an object whose program is left to a model."""
KEPT = "as it is"
"""Kind of an object whose program is there already and stays."""
PLAIN: dict[str, str] = {
    "box": "body.add(box(({x!r}, {y!r}, {z!r})), by='bottom')",
    "cylinder": "body.add(cylinder({r!r}, {z!r}), by='bottom')",
    "ball": "body.add(sphere({r!r}), by='bottom')",
    "bowl": "body.add(lathe([(0, 0), ({foot!r}, 0), ({r!r}, {z!r})], thickness={wall!r}))",
    "cup": "body.add(lathe([(0, 0), ({waist!r}, 0), ({r!r}, {z!r})], thickness={wall!r}))",
}
"""Kinds without a template: the line of the program that makes each of them."""
_CALLS = {"box": "box", "cylinder": "cylinder", "ball": "sphere", "bowl": "lathe", "cup": "lathe"}
_ROUND = ("cylinder", "ball", "bowl", "cup")
_LEAST_M, _FAR_M = 0.004, 100.0


class AnnotatedObject(Spec):
    """One object as a person drew and named it."""

    name: Name
    label: str = Field(default="", max_length=100)
    kind: str = "box"
    """A template, one of `PLAIN`, or `MODEL` or `KEPT`."""
    box: Box2D
    """In pixels of the upright original."""
    parent: Name = GROUND
    relation: Relation = "on"
    support: bool = False
    """Whether it is a support of the environment, such as a shelf: it never moves."""
    fixed_base: bool = False
    size: tuple[Length, Length, Length] | None = None
    """Edge lengths [m] along its own x (back to front), y and z, where they are known."""
    yaw_deg: Annotated[float, Field(ge=-360, le=360)] = 180.0
    """Where its front points, from above [degrees]; 180 is to the camera."""
    material: str = "plastic"
    """Of plain shapes."""
    parts: tuple[PartState, ...] = ()
    """Parts that move, and how far they stand open."""

    @model_validator(mode="after")
    def _known(self) -> "AnnotatedObject":
        kinds = [*PLAIN, MODEL, KEPT, *templates()]
        if self.kind not in kinds:
            raise ValueError(f"object {self.name}: kind: {choices(self.kind, kinds)}")
        if self.material not in MATERIALS:
            raise ValueError(f"object {self.name}: material: {choices(self.material, MATERIALS)}")
        return self


class Annotation(Spec):
    """Everything that a person says about a photograph."""

    camera: Camera
    ground: Literal["floor", "table top", "counter", "ground"] = "table top"
    """Label of the support at z = 0."""
    objects: tuple[AnnotatedObject, ...] = ()

    @model_validator(mode="after")
    def _carried(self) -> "Annotation":
        names = [GROUND, *(obj.name for obj in self.objects)]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"names must be unique, repeated: {', '.join(twice)}")
        for obj in self.objects:
            if obj.parent not in names:
                raise ValueError(f"object {obj.name}: parent: {choices(obj.parent, names)}")
        looped = name_on_cycle({obj.name: _parent(obj) for obj in self.objects})
        if looped is not None:
            raise ValueError(f"objects carry each other in a circle through {looped}")
        return self


def annotated_tree(annotation: Annotation) -> SceneTree:
    """Return the scene tree that an annotation describes.

    Raises:
        SpecError: there is no object, a box lies above the horizon, or the tree is invalid.
    """
    if not annotation.objects:
        raise SpecError("the annotation has no object: draw a box first")
    camera = annotation.camera
    by_name = {obj.name: obj for obj in annotation.objects}
    boxes: dict[str, Box3D] = {}
    for name in parents_first({n: _parent(obj) for n, obj in by_name.items()}):
        obj = by_name[name]
        level = 0.0
        if obj.parent != GROUND:
            under = boxes[obj.parent]
            inside = obj.relation == "in" or by_name[obj.parent].kind in ("bowl",)
            level = under.position[2] + (0.0 if inside else under.size[2])
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
    """Return the 3D box of an object that stands at a height and fills its 2D box.

    Args:
        obj: the object.
        camera: of the photograph.
        level: height that it stands at [m].

    Raises:
        SpecError: its box does not touch what carries it in the picture.
    """
    left, top, right, bottom = obj.box.as_tuple()
    ray = camera.rays([(left + right) / 2, bottom])
    drop = camera.height - level
    if ray[2] >= -1e-3 or drop <= 0 or drop / -ray[2] > _FAR_M:
        raise SpecError(
            f"object {obj.name}: the lower edge of its box is above the horizon of its parent: "
            "draw the box again, or let the camera look further down"
        )
    foot = camera.position() + ray * (drop / -ray[2])
    _, depth = camera.project(foot)
    scale = float(depth) / camera.focal
    yaw = math.radians(obj.yaw_deg)
    ratios = _ratios(obj)
    wide, high = max((right - left) * scale, _LEAST_M), max((bottom - top) * scale, _LEAST_M)
    ahead = foot[:2] / max(float(np.linalg.norm(foot[:2])), 1e-6)
    goal = np.array([left, top, right, bottom])
    known = None if obj.size is None else np.array(obj.size)

    def box(u: NDArray) -> tuple[NDArray, NDArray]:
        size = known
        if size is None:
            size = np.exp(u[2]) * np.array([ratios[0], ratios[1], np.exp(u[3])])
        return np.array([u[0], u[1], level]), size

    def misses(u: NDArray) -> NDArray:
        position, size = box(u)
        pixels, ahead_of = camera.project(_outline(obj.kind, size, yaw) + position)
        if (ahead_of <= 1e-3).any():
            return np.full(len(u), 1e4)
        seen = np.concatenate([pixels.min(axis=0), pixels.max(axis=0)])
        error = (seen - goal) / max(right - left, bottom - top)
        # A known size leaves two numbers, for the foot; otherwise four, for the four sides.
        return error if known is None else np.array([error[[0, 2]].sum(), error[3]])

    at = foot[:2] + ahead * wide / 2
    start = at if known is not None else np.array([*at, np.log(wide), np.log(0.5 * high / wide)])
    solution = least_squares(misses, start, x_scale="jac", max_nfev=200)
    position, size = box(solution.x)
    x, y, z = (float(round(max(v, _LEAST_M), 5)) for v in size)
    return Box3D(
        position=(round(float(position[0]), 5), round(float(position[1]), 5), level),
        size=(x, y, z),
        yaw=yaw,
    )


def program_of(obj: AnnotatedObject, size: tuple[float, float, float], rgb: RGB) -> str | None:
    """Return the program of an annotated object; None where a model is to write it.

    Args:
        obj: the object.
        size: edges of its box [m].
        rgb: its colour, 0 to 1.
    """
    if obj.kind in (MODEL, KEPT) or obj.support:
        return None
    if obj.kind not in PLAIN:
        chosen = template(obj.kind)
        return chosen.program(dict(chosen.of_box(size)))
    x, y, z = (round(v, 4) for v in size)
    r = round(min(x, y) / 2, 4)
    wall = round(min(max(0.06 * r, 0.002), 0.6 * r, 0.4 * z), 4)
    numbers = {"x": x, "y": y, "z": z, "r": r, "wall": wall}
    numbers |= {"foot": round(0.5 * r, 4), "waist": round(0.75 * r, 4)}
    red, green, blue = (round(v, 3) for v in rgb)
    return (
        f"from neoworld_mjx.program.sdk import Object, {_CALLS[obj.kind]}\n\n"
        f'thing = Object("{obj.name}")\n'
        f'look = thing.material("{obj.material}_seen", like="{obj.material}", '
        f"rgb=({red}, {green}, {blue}))\n"
        f'body = thing.part("body", material=look)\n' + PLAIN[obj.kind].format(**numbers) + "\n"
    )


def opened_annotation(tree: SceneTree) -> Annotation:
    """Return the annotation of a scene tree that a model or a person made, to correct it.

    Its objects keep their sizes and programs; supports of the environment other than the lowest
    become supports that stand on it.
    """
    ground = next((n for n in tree.top_down() if n.environment), None)
    names = {n.name for n in tree.nodes} - {GROUND}
    objects = tuple(
        AnnotatedObject(
            name=n.name,
            label=n.label[:100],
            kind=KEPT,
            box=n.box2d,
            parent=n.parent if n.parent in names and n.parent != _name(ground) else GROUND,
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


def _name(node: TreeNode | None) -> str | None:
    return None if node is None else node.name


def _parent(obj: AnnotatedObject) -> str | None:
    return None if obj.parent == GROUND else obj.parent


def _ratios(obj: AnnotatedObject) -> tuple[float, float]:
    """Return depth and width over width."""
    if obj.kind in PLAIN or obj.kind in (MODEL, KEPT):
        return 1.0, 1.0
    depth, width, _ = (float(template(obj.kind).parameters[name].default) for name in BOX)
    return depth / width, 1.0


def _outline(kind: str, size: NDArray, yaw: float) -> NDArray:
    """Return points [n, 3] whose outline in the picture is that of the object, at the origin."""
    if kind in _ROUND:
        turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)
        ring = np.column_stack([np.cos(turn), np.sin(turn)]) * size[:2] / 2
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
    """Return the support at z = 0, as large as the objects on it need."""
    camera = annotation.camera
    corners = np.concatenate([box.corners()[:, :2] for box in boxes])
    low, high = corners.min(axis=0), corners.max(axis=0)
    margin = 0.6 * float(np.max(high - low)) + 0.02
    x, y = (high - low + 2 * margin).round(4).tolist()
    cx, cy = ((low + high) / 2).round(4).tolist()
    whole = Box2D(x0=0, y0=0, x1=camera.width, y1=camera.height_px)
    return TreeNode(
        name=GROUND,
        label=annotation.ground,
        environment=True,
        box2d=whole,
        box3d=Box3D(position=(cx, cy, -THICK_M), size=(x, y, THICK_M)),
    )
