"""Errors of a response that splits one object into two: one on the other, or side by side."""

from collections.abc import Iterator, Mapping

import numpy as np
from jaxtyping import Float

from neoworld_mjx.fit.projection import expected_box
from neoworld_mjx.spec import (
    Box,
    Box2D,
    Cylinder,
    GeomSpec,
    ObjectSpec,
    SceneTree,
    TreeNode,
    bounds,
)
from neoworld_mjx.spec.extent import part_bounds, recentred
from neoworld_mjx.spec.pose import IDENTITY, from_yaw, matrix, rotate

SPLIT = 1 / (61 + 2)
"""Rate of objects that are split into two. Measured: none of 61 movable objects in the responses to
four photographs is half of an object. One support is part of an object: the tablet arm of a chair
that is mostly outside the image. The rate 1/(n + 2) is the mean of Laplace's rule of succession."""
HALVES = ("_half_1", "_half_2")
"""Suffixes of the names of the halves."""
LEAST = 0.25
"""Minimum length of a half along the cut axis, as a fraction of the object's length."""
ON_GROUND = 0.05
"""A half stands on the parent if the half's bottom is above the object's bottom by less than this
fraction of the object's height."""
ALIGNED = 1e-6
"""Maximum deviation of a rotation matrix from one that permutes axes."""

Range = tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]


def with_halves(
    tree: SceneTree,
    name: str,
    rng: np.random.Generator,
    shapes: Mapping[str, ObjectSpec],
    specs: dict[str, ObjectSpec],
) -> Iterator[SceneTree]:
    """Yield trees with two halves in place of an object, for a cut across each axis.

    Only objects that stand upright and have no children are cut. The object counts as missed, and
    both halves count as extra.

    Args:
        tree: a response.
        name: name of the object.
        rng: random generator for the order of the axes.
        shapes: specs of the objects, by name.
        specs: dict to which the specs of the halves are added.
    """
    node, names = tree.node(name), [name + end for end in HALVES]
    upright = node.relation in ("on", "in") and np.allclose(node.base_tilt, IDENTITY)
    carries = any(other.parent == name for other in tree.nodes)
    if not upright or carries or name not in shapes or name.endswith(HALVES):
        return
    for axis in rng.permutation(3).tolist():
        halves = halves_of(shapes[name], axis)
        if halves is None:
            continue
        nodes = [_half(tree, node, shapes[name], half) for half in halves]
        if any(half is None for half in nodes):
            continue
        first, second = (
            half.model_copy(update={"name": half_name})
            for half, half_name in zip(nodes, names, strict=True)
            if half is not None
        )
        if axis == 2:
            second = second.model_copy(
                update={"parent": names[0], "parent_link": None, "relation": "on"}
            )
        specs |= {half_name: recentred(half) for half_name, half in zip(names, halves, strict=True)}
        others = [_hidden_by(other, name, names) for other in tree.nodes if other.name != name]
        yield SceneTree.model_validate({**dict(tree), "nodes": (*others, first, second)})


def halves_of(spec: ObjectSpec, axis: int) -> tuple[ObjectSpec, ObjectSpec] | None:
    """Cut an object with a single part across an axis into two halves.

    Cuts along a face of a shape, nearest to the object's center, are tried before a cut through the
    center. Only boxes and cylinders can be cut.

    Returns:
        The halves on the negative and on the positive side of the cut, in the object's frame. None
        if the object cannot be cut, or if a half would hang in the air.
    """
    part = spec.part(spec.root)
    if spec.parts != (part,) or part.mass is not None:
        return None
    low, high = bounds(spec)
    middle = (low[axis] + high[axis]) / 2
    solid = [geom for geom in part.geoms if geom.role == "both"]
    ends = [part_bounds(spec, part.model_copy(update={"geoms": (geom,)})) for geom in solid]
    planes = sorted(
        {float(end[axis]) for both in ends for end in both}, key=lambda c: abs(c - middle)
    )
    for plane in (*planes, middle):
        share = (plane - low[axis]) / (high[axis] - low[axis])
        if not LEAST < share < 1 - LEAST:
            continue
        cut = [_cut(geom, axis, plane, end) for geom, end in zip(solid, ends, strict=True)]
        if any(pair is None for pair in cut):
            continue
        halves = []
        for side in (0, 1):
            half_geoms = tuple(
                geom for pair in cut if pair is not None for geom in (pair[side],) if geom
            )
            if half_geoms:
                parts = (part.model_copy(update={"geoms": half_geoms}),)
                halves.append(spec.model_copy(update={"parts": parts, "sites": ()}))
        limit = low[2] + ON_GROUND * (high[2] - low[2])
        if len(halves) == 2 and (axis == 2 or all(bounds(h)[0][2] < limit for h in halves)):
            return halves[0], halves[1]
    return None


def _cut(
    geom: GeomSpec, axis: int, plane: float, ends: Range
) -> tuple[GeomSpec | None, GeomSpec | None] | None:
    """Return the parts of a shape below and above a plane; None if the shape cannot be cut."""
    low, high = (float(end[axis]) for end in ends)
    edge = 1e-6 * (high - low)
    if high <= plane + edge:
        return geom, None
    if low >= plane - edge:
        return None, geom
    turn = matrix(geom.quat)
    local_axis = int(np.argmax(np.abs(turn[axis])))
    shape = geom.shape
    aligned = abs(abs(turn[axis, local_axis]) - 1) < ALIGNED
    if not aligned or not (
        isinstance(shape, Box) or (isinstance(shape, Cylinder) and local_axis == 2)
    ):
        return None
    halves = []
    for a, b in ((low, plane), (plane, high)):
        pos = np.array(geom.pos)
        pos[axis] = (a + b) / 2
        if isinstance(shape, Box):
            size = list(shape.size)
            size[local_axis] = b - a
            new = Box(size=(size[0], size[1], size[2]))
        else:
            new = Cylinder(radius=shape.radius, height=b - a)
        halves.append(geom.model_copy(update={"shape": new, "pos": tuple(pos.tolist())}))
    return halves[0], halves[1]


def _half(tree: SceneTree, node: TreeNode, spec: ObjectSpec, half: ObjectSpec) -> TreeNode | None:
    """Return the node of a half, with its part of the object's boxes; None if invisible."""
    (low, high), (a, b) = bounds(spec), bounds(half)
    size, share = np.array(node.box3d.size), 1 / (high - low)
    step = ((a + b) / 2 - (low + high) / 2) * share * size
    step[2] = (a[2] - low[2]) * share[2] * size[2]
    position = np.array(node.box3d.position) + rotate(from_yaw(node.box3d.yaw), step)
    half_size = (b - a) * share * size
    box = node.box3d.model_copy(
        update={"position": tuple(position.tolist()), "size": tuple(half_size.tolist())}
    )
    part = node.model_copy(update={"box3d": box})
    whole_box, half_box = expected_box(tree.camera, node), expected_box(tree.camera, part)
    if whole_box is None or half_box is None:
        return None
    # Transfer the difference between the object's 2D box and its expected box to the half.
    read = np.array(node.box2d.as_tuple())
    ratio = (read[2:] - read[:2]) / (whole_box[2:] - whole_box[:2])
    pixels = np.concatenate(
        [read[:2] + (end - whole_box[:2]) * ratio for end in (half_box[:2], half_box[2:])]
    )
    if min(pixels[2:] - pixels[:2]) < 1:
        return None
    edges = dict(zip(("x0", "y0", "x1", "y1"), pixels.tolist(), strict=True))
    return part.model_copy(update={"box2d": Box2D(**edges)})


def _hidden_by(node: TreeNode, name: str, halves: list[str]) -> TreeNode:
    """Return a node with both halves in place of the object among its occluders."""
    if name not in node.occluded_by:
        return node
    others = [other for other in node.occluded_by if other != name]
    return node.model_copy(update={"occluded_by": (*others, *halves)})
