"""Errors of a response that are not errors of its objects' numbers.

They concern supports, the list of objects (missed, extra, split in two), parents, relations,
openings and the field of view. Rates come from the responses of a model to five rendered images
with 30 objects, and to four photographs. For the rendered images, no object was missed or extra,
all support edges were right, and the field of view was wrong in two images. The rate of an error
that did not occur in n cases is 1/(n + 2), the mean of Laplace's rule of succession. In a run, a
response that the checks refuse is sent back to the model; here, the error is sampled again.

Errors of supports, sizes of tables and positions of walls and furniture, were not measured
separately. They have the errors that were measured on objects whose response gives a position in
space. The top of a table or floor is the reference for heights and keeps its position.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from jaxtyping import Float

from neoworld_mjx.parse.checks import SceneIssue, check_tree
from neoworld_mjx.parse.outlines import expected_box
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
from neoworld_mjx.spec.kinematics import part_bounds, recentred
from neoworld_mjx.spec.pose import IDENTITY, from_yaw, matrix, rotate

from ..fidelity.rendered_responses import ASIDE, DEPTH, LOG_ASPECT, LOG_SIZE, YAW


def with_other_supports(response: SceneTree, truth: SceneTree, number: int) -> SceneTree:
    """Return a response with errors in its environment supports.

    Args:
        response: response with noise in the numbers of its objects.
        truth: exact response.
        number: seed of the noise.
    """
    rng = np.random.default_rng((number, 49))
    eye = truth.camera.position()
    nodes = [_disturbed(node, eye, rng) if node.environment else node for node in response.nodes]
    return response.model_copy(update={"nodes": tuple(nodes)})


def _disturbed(node: TreeNode, eye: Float[np.ndarray, " 3"], rng: np.random.Generator) -> TreeNode:
    box = node.box3d
    factor = np.exp(LOG_SIZE * rng.normal() + LOG_ASPECT * rng.normal(size=3))
    turn, out, aside = rng.normal(size=3)
    place, yaw = np.array(box.position), box.yaw
    if min(box.size) == box.size[2]:
        factor[2] = 1.0
    else:
        reach, view = float(np.linalg.norm(place - eye)), place[:2] / np.linalg.norm(place[:2])
        across = np.array([-view[1], view[0]])
        place[:2] += reach * (DEPTH * out * view + ASIDE * aside * across)
        yaw += YAW * turn
    update = {
        "position": tuple(place.tolist()),
        "size": tuple((np.array(box.size) * factor).tolist()),
        "yaw": yaw,
    }
    return node.model_copy(update={"box3d": box.model_copy(update=update)})


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


TREE_ERROR_RATE = 1 / (30 + 2)
"""Rate per object of each of four errors: missed, duplicated, wrong parent, wrong relation. None of
30 objects in five rendered images had one. Of the scenes of seven photographs, six were complete;
with 8 objects per scene, this rate leaves 78 % complete."""
CLOSED = 1 / (15 + 2)
"""Rate of open joints that are parsed as closed. Measured: none of 15 joints in the responses to
four photographs."""
OPENING = 0.06
"""Standard deviation of an opening. An opening is the ratio of two lengths in the image, so it has
the deviation of edges, `program_noise.EDGE`. Openings were not measured separately."""
MISJUDGED, LEAST_DEG, MOST_DEG = 2 / 5, 12.0, 16.0
"""Rate of responses with a wrong field of view, and minimum and maximum error [deg]. Measured: 12
and 16 degrees in two of five rendered images. The sign was not recorded and is random here."""
NARROWEST_DEG = 12.0
"""Minimum field of view of a response [deg]."""
COPY = "_again"
"""Suffix of the name of a duplicate, after the name of the original object."""
APART = 1.15
"""Distance of a duplicate from the original, as a multiple of the original's size."""


@dataclass
class NoiseLog:
    """Errors of an initial scene that are not errors of its numbers."""

    injected: list[str] = field(default_factory=list)
    """Kinds of the errors in the scene."""
    refused: list[str] = field(default_factory=list)
    """Kinds of errors that were sampled but not injected, because no variant passes the checks."""


@dataclass(frozen=True)
class WrongParse:
    """A response with errors."""

    tree: SceneTree
    shapes: dict[str, ObjectSpec]
    """Specs of the objects that are not in the ground truth, by name."""


Edit = Callable[[SceneTree, str, np.random.Generator], Iterator[SceneTree]]


def with_misjudged_view(tree: SceneTree, rng: np.random.Generator, log: NoiseLog) -> SceneTree:
    """Return a tree whose field of view is wrong with the probability MISJUDGED.

    Because sizes of objects are known, a response with a wrong field of view also has a wrong
    distance of the camera. The camera moves in proportion to the focal length (a dolly zoom), so
    that the layout and the pixels at the objects' mean depth stay the same.
    """
    off = math.radians(rng.uniform(LEAST_DEG, MOST_DEG)) * rng.choice((-1.0, 1.0))
    if rng.uniform() >= MISJUDGED:
        return tree
    log.injected.append("view")
    camera = tree.camera
    fovy = max(camera.fovy + off, math.radians(NARROWEST_DEG))
    middles = [node.box3d.corners(node.base_tilt).mean(axis=0) for node in _objects(tree)]
    depth = float(camera.project(np.array(middles))[1].mean())
    back = depth * (math.tan(camera.fovy / 2) / math.tan(fovy / 2) - 1)
    update = {"fovy": fovy, "height": camera.height + back * math.sin(camera.pitch)}
    nodes = []
    for node in tree.nodes:
        x, y, z = node.box3d.position
        position = (x + back * math.cos(camera.pitch), y, z)
        box = node.box3d.model_copy(update={"position": position})
        nodes.append(node.model_copy(update={"box3d": box}))
    return tree.model_copy(
        update={"camera": camera.model_copy(update=update), "nodes": tuple(nodes)}
    )


def wrong_parse(
    response: SceneTree, number: int, log: NoiseLog, shapes: Mapping[str, ObjectSpec]
) -> WrongParse:
    """Add errors to a response.

    Args:
        response: response with noise in its numbers.
        number: seed of the noise.
        log: log to which the kinds of errors are added: "view", "closed", "missed", "extra",
            "carrier" (wrong parent), "relation", "split".
        shapes: specs of the response's objects, by name.
    """
    tree = with_misjudged_view(response, np.random.default_rng((number, 47)), log)
    tree = _openings(tree, np.random.default_rng((number, 44)), log)
    halves: dict[str, ObjectSpec] = {}
    kinds: tuple[tuple[str, Edit, float], ...] = (
        ("missed", without, TREE_ERROR_RATE),
        ("extra", with_copy, TREE_ERROR_RATE),
        ("carrier", with_other_parent, TREE_ERROR_RATE),
        ("relation", with_other_relation, TREE_ERROR_RATE),
        ("split", partial(with_halves, shapes=shapes, specs=halves), SPLIT),
    )
    for k, (kind, edit, rate) in enumerate(kinds):
        rng = np.random.default_rng((number, 44, k))
        for _ in range(int(rng.binomial(len(_objects(tree)), rate))):
            changed = _first_accepted(tree, edit, rng)
            (log.refused if changed is None else log.injected).append(kind)
            tree = changed or tree
    known = {node.name for node in response.nodes}
    new = [node.name for node in tree.nodes if node.name not in known]
    new_shapes = {name: halves.get(name) or shapes[name.removesuffix(COPY)] for name in new}
    return WrongParse(tree, new_shapes)


def _first_accepted(tree: SceneTree, edit: Edit, rng: np.random.Generator) -> SceneTree | None:
    """Return the first variant of an error that the checks do not refuse; None if there is none."""
    known = refusals(check_tree(tree))
    for name in rng.permutation([node.name for node in _objects(tree)]).tolist():
        for changed in edit(tree, name, rng):
            if not refusals(check_tree(changed)) - known:
                return changed
    return None


def refusals(issues: Sequence[SceneIssue]) -> set[tuple[str, str]]:
    """Return the object and the code of each issue for which a run sends a response back."""
    return {(issue.node, issue.code) for issue in issues if issue.severity == "error"}


def _objects(tree: SceneTree) -> list[TreeNode]:
    return [node for node in tree.nodes if not node.environment]


def _openings(tree: SceneTree, rng: np.random.Generator, log: NoiseLog) -> SceneTree:
    nodes = []
    for node in tree.nodes:
        states = []
        for state in node.articulation:
            closed, off = rng.uniform() < CLOSED, OPENING * rng.normal()
            if closed:
                log.injected.append("closed")
                continue
            opening = min(max(state.opening + off, 0.0), 1.0)
            states.append(state.model_copy(update={"opening": opening}))
        nodes.append(node.model_copy(update={"articulation": tuple(states)}))
    return tree.model_copy(update={"nodes": tuple(nodes)})


def without(tree: SceneTree, name: str, rng: np.random.Generator) -> Iterator[SceneTree]:
    """Yield a tree without an object, whose children are moved to the object's parent."""
    removed = tree.node(name)
    if len(_objects(tree)) < 2:
        return
    nodes = []
    for node in tree.nodes:
        if node.name == name:
            continue
        update: dict[str, object] = {
            "occluded_by": tuple(other for other in node.occluded_by if other != name)
        }
        if node.parent == name:
            # What is in a bowl in a crate is in the crate; what is in a bowl on a table is on the
            # table.
            inside = "in" in (removed.relation, node.relation)
            relation = removed.relation if inside else node.relation
            update |= {
                "parent": removed.parent,
                "parent_link": removed.parent_link,
                "relation": relation,
            }
        nodes.append(node.model_copy(update=update))
    yield _tree(tree, nodes)


def with_copy(tree: SceneTree, name: str, rng: np.random.Generator) -> Iterator[SceneTree]:
    """Yield trees with a duplicate of an object next to the object, on each of its four sides.

    Only objects that are on or in their parent are duplicated, and no objects with children and no
    duplicates.
    """
    node, copy = tree.node(name), f"{name}{COPY}"
    if node.relation not in ("on", "in") or name.endswith(COPY):
        return
    if any(other.name == copy or other.parent == name for other in tree.nodes):
        return
    for side in rng.permutation(4).tolist():
        axis, sign = side // 2, 1 - 2 * (side % 2)
        step = np.zeros(3)
        step[axis] = sign * APART * node.box3d.size[axis]
        position = np.array(node.box3d.position) + rotate(from_yaw(node.box3d.yaw), step)
        box = node.box3d.model_copy(update={"position": tuple(position.tolist())})
        update = {"name": copy, "box3d": box, "occluded": False, "occluded_by": ()}
        other = node.model_copy(update=update)
        box_2d = expected_box(tree.camera, other)
        if box_2d is None or min(box_2d[2:] - box_2d[:2]) < 1:
            continue
        edges = dict(zip(("x0", "y0", "x1", "y1"), map(float, box_2d), strict=True))
        yield _tree(tree, [*tree.nodes, other.model_copy(update={"box2d": Box2D(**edges)})])


def with_other_parent(tree: SceneTree, name: str, rng: np.random.Generator) -> Iterator[SceneTree]:
    """Yield trees in which an object has another parent and the same position."""
    node = tree.node(name)
    if node.relation == "attached":
        return
    above = {name}
    for other in tree.top_down():
        above |= {other.name} if other.parent in above else set()
    others = [n.name for n in tree.nodes if n.name not in above and n.name != node.parent]
    for other in rng.permutation(others).tolist():
        relation = "leaning" if node.relation == "leaning" else "on"
        update = {"parent": other, "parent_link": None, "relation": relation}
        yield _tree(tree, [n.model_copy(update=update) if n is node else n for n in tree.nodes])


def with_other_relation(
    tree: SceneTree, name: str, rng: np.random.Generator
) -> Iterator[SceneTree]:
    """Yield a tree in which an object has another relation to its parent."""
    node = tree.node(name)
    if node.relation == "attached" or node.parent is None:
        return
    on_slab = tree.node(node.parent).slab
    other = "on" if node.relation != "on" else "leaning" if on_slab else "in"
    update = {"relation": other}
    yield _tree(tree, [n.model_copy(update=update) if n is node else n for n in tree.nodes])


def _tree(tree: SceneTree, nodes: list[TreeNode]) -> SceneTree:
    return SceneTree.model_validate({**dict(tree), "nodes": tuple(nodes)})
