"""Agreement of a parsed scene with the ground truth: boxes, supports, sizes, depths and camera.

Nodes are matched only by their boxes, not by name or label. Each mean is given with the number of
its values. A mean without values is None, because the absence of matches is not an error of zero.
"""

import math
from collections.abc import Iterable, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from neoworld_mjx.measure.boxes import iou_2d, iou_3d, upright
from neoworld_mjx.spec import Box3D, SceneTree, Spec, TreeNode

MATCH_IOU = 0.25
"""Minimum intersection over union of the 2D boxes of two nodes that match."""
TIE = 0.02
"""Two objects have no order if their true depths (or sizes) differ by less than this fraction."""
ROUND = 1.1
"""A footprint has no defined yaw if the ratio of its sides is at most this value."""


class Mean(Spec):
    """A mean and the number of its values."""

    value: float | None
    n: int


class ParseMeasure(Spec):
    """Comparison of a parsed scene with the ground truth.

    Objects are the nodes that are not environment supports in the ground truth.
    """

    matched: dict[str, str]
    """Name of the parsed node that matches each true node, by name of the true node."""
    missed: tuple[str, ...]
    """True objects that match no parsed node."""
    extra: tuple[str, ...]
    """Parsed objects that match no true node."""
    iou_2d: Mean
    """Intersection over union of the 2D boxes of matched objects."""
    iou_3d: Mean
    """Intersection over union of the 3D boxes of matched objects, in the world frame. Boxes are
    upright and rotated by their yaw."""
    iou_3d_scaled: Mean
    """`iou_3d` after the parsed scene is scaled by `scale` about its camera and moved to the true
    camera, because an image does not determine the scale."""
    scale: float | None
    """Median ratio of true to parsed depth over matched objects."""
    position_m: Mean
    """Distance between the centers of the 3D boxes of matched objects [m]."""
    size_log: Mean
    """Mean absolute logarithm of the ratios of edges: of the shorter and the longer horizontal edge
    and of the height."""
    yaw_deg: Mean
    """Error of the yaw of matched objects whose true footprint is not nearly square [deg]."""
    edge_precision: float | None
    edge_recall: float | None
    edge_f1: float | None
    """F1 score of support edges (parent to child), without edges from the world."""
    edges_true: int
    edges_parsed: int
    relations: Mean
    """Fraction of the correct edges whose relation is also correct."""
    tree_distance: int
    """Number of missed nodes, extra nodes, and matched nodes with a different parent."""
    nodes_true: int
    nodes_parsed: int
    depth_order: Mean
    """Fraction of the pairs of matched objects that are in the true order of depth."""
    size_order: Mean
    """Fraction of the pairs of matched objects that are in the true order of size."""
    size_ratio_log: Mean
    """Mean absolute error of the logarithm of the ratio of two sizes, over pairs of matched
    objects."""
    occluded: Mean
    """Fraction of the matched objects whose flag `occluded` is correct."""
    environment: Mean
    """Fraction of the matched nodes whose flag `environment` is correct."""
    parts: Mean
    """Fraction of an object's true movable parts for which there is a parsed part with the same
    joint type, over matched objects with movable parts."""
    pitch_deg: float
    """Parsed minus true pitch of the camera [deg]."""
    roll_deg: float
    """Parsed minus true roll of the camera [deg]."""
    fovy_deg: float
    """Parsed minus true vertical field of view [deg]."""
    height_m: float
    """Parsed minus true height of the camera [m]."""


def parse_measure(parsed: SceneTree, truth: SceneTree) -> ParseMeasure:
    """Compare a parsed scene with the ground truth of the same image."""
    pairs = match(parsed, truth)
    back = {guess: true for true, guess in pairs.items()}
    objects = [
        (parsed.node(pairs[true.name]), true)
        for true in truth.nodes
        if true.name in pairs and not true.environment
    ]
    factor = _scale(parsed, truth, objects)
    missed_nodes = [node.name for node in truth.nodes if node.name not in pairs]
    extra_nodes = [node.name for node in parsed.nodes if node.name not in back]
    edges = _edges(parsed, truth, back)
    hit = len(edges)
    edges_true = sum(node.parent is not None for node in truth.nodes)
    edges_parsed = sum(node.parent is not None for node in parsed.nodes)
    precision = hit / edges_parsed if edges_parsed else None
    recall = hit / edges_true if edges_true else None
    total = edges_parsed + edges_true
    camera, true_camera = parsed.camera, truth.camera
    return ParseMeasure(
        matched=pairs,
        missed=tuple(name for name in missed_nodes if not truth.node(name).environment),
        extra=tuple(name for name in extra_nodes if not parsed.node(name).environment),
        iou_2d=_mean(iou_2d(guess.box2d, true.box2d) for guess, true in objects),
        iou_3d=_mean(iou_3d(upright(guess), upright(true)) for guess, true in objects),
        iou_3d_scaled=_mean(
            iou_3d(_scaled(upright(guess), parsed, truth, factor), upright(true))
            for guess, true in objects
        ),
        scale=factor,
        position_m=_mean(
            float(np.linalg.norm(_centre(guess) - _centre(true))) for guess, true in objects
        ),
        size_log=_mean(_size_error(guess, true) for guess, true in objects),
        yaw_deg=_mean(
            _angle_deg(guess.box3d.yaw, true.box3d.yaw)
            for guess, true in objects
            if max(true.box3d.size[:2]) > ROUND * min(true.box3d.size[:2])
        ),
        edge_precision=precision,
        edge_recall=recall,
        edge_f1=2 * hit / total if total else None,
        edges_true=edges_true,
        edges_parsed=edges_parsed,
        relations=_mean(float(guess.relation == true.relation) for guess, true in edges),
        tree_distance=len(missed_nodes) + len(extra_nodes) + _wrong_parents(parsed, truth, pairs),
        nodes_true=len(truth.nodes),
        nodes_parsed=len(parsed.nodes),
        depth_order=_order([(_depth(parsed, a), _depth(truth, b)) for a, b in objects]),
        size_order=_order([(_extent(a), _extent(b)) for a, b in objects]),
        size_ratio_log=_mean(
            abs(math.log(a * d / (b * c)))
            for (a, c), (b, d) in combinations([(_extent(m), _extent(t)) for m, t in objects], 2)
        ),
        occluded=_mean(float(guess.occluded == true.occluded) for guess, true in objects),
        environment=_mean(
            float(parsed.node(guess).environment == truth.node(true).environment)
            for true, guess in pairs.items()
        ),
        parts=_mean(
            _matched_parts_share(guess, true)
            for guess, true in objects
            if len(true.articulation) > 0
        ),
        pitch_deg=math.degrees(camera.pitch - true_camera.pitch),
        roll_deg=math.degrees(camera.roll - true_camera.roll),
        fovy_deg=math.degrees(camera.fovy - true_camera.fovy),
        height_m=camera.height - true_camera.height,
    )


def match(parsed: SceneTree, truth: SceneTree) -> dict[str, str]:
    """Match nodes by their boxes; return the parsed name for each matched true name.

    The Hungarian method maximizes the sum, over pairs with a 2D IoU of at least `MATCH_IOU`, of the
    2D IoU and half the 3D IoU. Equal environment flags add a small bonus, which decides between
    otherwise equal pairs, such as tables that fill the image.
    """
    worth = np.zeros((len(truth.nodes), len(parsed.nodes)))
    for i, true in enumerate(truth.nodes):
        for j, guess in enumerate(parsed.nodes):
            flat = iou_2d(guess.box2d, true.box2d)
            if flat >= MATCH_IOU:
                same = 0.1 * (guess.environment == true.environment)
                worth[i, j] = flat + 0.5 * iou_3d(upright(guess), upright(true)) + same
    rows, columns = linear_sum_assignment(worth, maximize=True)
    return {
        truth.nodes[i].name: parsed.nodes[j].name
        for i, j in zip(rows, columns, strict=True)
        if worth[i, j] > 0
    }


def _edges(
    parsed: SceneTree, truth: SceneTree, back: dict[str, str]
) -> list[tuple[TreeNode, TreeNode]]:
    """Return the (parsed, true) children of the support edges that both trees contain."""
    edges = []
    for guess in parsed.nodes:
        if guess.parent is None or guess.name not in back or guess.parent not in back:
            continue
        true = truth.node(back[guess.name])
        if true.parent == back[guess.parent]:
            edges.append((guess, true))
    return edges


def _wrong_parents(parsed: SceneTree, truth: SceneTree, pairs: dict[str, str]) -> int:
    """Count the matched nodes whose parents do not match."""
    count = 0
    for true_name, parsed_name in pairs.items():
        true, guess = truth.node(true_name).parent, parsed.node(parsed_name).parent
        expected = None if true is None else pairs.get(true, "")
        count += guess != expected
    return count


def _mean(values: Iterable[float]) -> Mean:
    known = list(values)
    return Mean(value=float(np.mean(known)) if known else None, n=len(known))


def _order(values: Sequence[tuple[float, float]]) -> Mean:
    """Return the fraction of pairs in the true order, over pairs without a tie in the truth."""
    return _mean(
        float((guess - guess2) * (true - true2) > 0)
        for (guess, true), (guess2, true2) in combinations(values, 2)
        if abs(true - true2) > TIE * max(abs(true), abs(true2))
    )


def _centre(node: TreeNode) -> NDArray:
    box = upright(node)
    return np.array(box.position) + [0, 0, box.size[2] / 2]


def _depth(tree: SceneTree, node: TreeNode) -> float:
    return float(tree.camera.project(_centre(node))[1])


def _extent(node: TreeNode) -> float:
    """Return the edge length of a cube with the volume of the node's 3D box [m]."""
    return float(np.prod(node.box3d.size) ** (1 / 3))


def _size_error(guess: TreeNode, true: TreeNode) -> float:
    def edges(box: Box3D) -> NDArray:
        return np.log([*sorted(box.size[:2]), box.size[2]])

    return float(np.abs(edges(upright(guess)) - edges(upright(true))).mean())


def _angle_deg(a: float, b: float) -> float:
    return abs(math.degrees(math.remainder(a - b, 2 * math.pi)))


def _matched_parts_share(guess: TreeNode, true: TreeNode) -> float:
    remaining = [state.type for state in guess.articulation]
    matched = 0
    for state in true.articulation:
        if state.type in remaining:
            remaining.remove(state.type)
            matched += 1
    return matched / len(true.articulation)


def _scale(
    parsed: SceneTree, truth: SceneTree, objects: list[tuple[TreeNode, TreeNode]]
) -> float | None:
    ratios = [
        _depth(truth, true) / depth
        for guess, true in objects
        if (depth := _depth(parsed, guess)) > 1e-6
    ]
    return float(np.median(ratios)) if ratios else None


def _scaled(box: Box3D, parsed: SceneTree, truth: SceneTree, factor: float | None) -> Box3D:
    s = 1.0 if factor is None or factor <= 0 else factor
    position = (np.array(box.position) - parsed.camera.position()) * s + truth.camera.position()
    size = tuple((s * np.array(box.size)).tolist())
    return Box3D(position=tuple(position.tolist()), size=size, yaw=box.yaw)
