"""Measure of parsed scene trees against ground truth."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from neoworld_bench.measures import parse_measure
from neoworld_bench.measures.parse_measure import match

from neoworld_mjx.measure import iou_2d, iou_3d
from neoworld_mjx.measure.boxes import polygon_intersection, upright
from neoworld_mjx.spec import Box2D, Box3D, Camera, PartState, SceneTree, TreeNode

CAMERA = Camera(width=640, height_px=480, fovy=0.8, height=0.6, pitch=0.7)


def node(name, at, size=(0.1, 0.1, 0.1), yaw=0.0, parent="table", camera=CAMERA, **extra):
    box = Box3D(position=at, size=size, yaw=yaw)
    pixels, _ = camera.project(box.corners())
    (x0, y0), (x1, y1) = pixels.min(axis=0), pixels.max(axis=0)
    fields = {
        "label": "box",
        "parent": parent,
        "box2d": Box2D(x0=x0, y0=y0, x1=x1, y1=y1),
        "box3d": box,
    }
    return TreeNode(name=name, **{**fields, **extra})


def table(name="table", camera=CAMERA):
    return node(name, (0.8, 0, -0.03), (1.0, 1.2, 0.03), 0, None, camera, environment=True)


def three(camera=CAMERA):
    return SceneTree(
        camera=camera,
        nodes=(
            table(camera=camera),
            node("low", (0.7, 0.1, 0), (0.2, 0.2, 0.05), camera=camera),
            node("high", (0.7, 0.1, 0.05), (0.1, 0.05, 0.08), 0.3, "low", camera),
            node("far", (1.0, -0.2, 0), (0.1, 0.1, 0.2), camera=camera),
        ),
    )


def changed(tree, name, **update):
    nodes = tuple(n.model_copy(update=update) if n.name == name else n for n in tree.nodes)
    return SceneTree(camera=tree.camera, nodes=nodes)


def test_iou_2d():
    assert iou_2d((0, 0, 2, 2), (0, 0, 2, 2)) == 1
    assert iou_2d((0, 0, 2, 2), (1, 0, 3, 2)) == pytest.approx(1 / 3)
    assert iou_2d((0, 0, 2, 2), (2, 0, 3, 2)) == 0
    assert iou_2d((0, 0, 4, 4), (1, 1, 3, 3)) == pytest.approx(1 / 4)


def test_iou_3d():
    a = Box3D(position=(0, 0, 0), size=(1, 1, 1))
    assert iou_3d(a, a) == pytest.approx(1)
    assert iou_3d(a, a.model_copy(update={"position": (0.5, 0, 0)})) == pytest.approx(1 / 3)
    assert iou_3d(a, a.model_copy(update={"position": (0, 0, 0.5)})) == pytest.approx(1 / 3)
    assert iou_3d(a, a.model_copy(update={"position": (0, 0, 1.0)})) == 0
    assert iou_3d(a, a.model_copy(update={"yaw": math.pi / 2})) == pytest.approx(1)
    # Two unit squares at 45 degrees share a regular octagon of area 2 (sqrt 2 - 1).
    octagon = 2 * (math.sqrt(2) - 1)
    turned = a.model_copy(update={"yaw": math.pi / 4})
    assert iou_3d(a, turned) == pytest.approx(octagon / (2 - octagon))
    long = Box3D(position=(0, 0, 0), size=(4, 1, 1))
    across = long.model_copy(update={"yaw": math.pi / 2})
    assert iou_3d(long, across) == pytest.approx(1 / 7)


@settings(max_examples=60, deadline=None)
@given(
    st.tuples(*[st.floats(-1, 1)] * 3),
    st.tuples(*[st.floats(0.2, 2)] * 2),
    st.floats(-4, 4),
)
def test_shared_footprint_agrees_with_monte_carlo(at, size, turn):
    from neoworld_mjx.measure.boxes import footprint

    a = Box3D(position=(0, 0, 0), size=(1, 1.5, 1), yaw=at[2])
    b = Box3D(position=(*at[:2], 0), size=(*size, 1), yaw=turn)
    grid = (np.stack(np.meshgrid(np.arange(240), np.arange(240)), -1).reshape(-1, 2) + 0.5) / 40 - 3

    def inside(box):
        c, s = math.cos(box.yaw), math.sin(box.yaw)
        local = (grid - np.array(box.position[:2])) @ np.array([[c, -s], [s, c]])
        return (np.abs(local) <= np.array(box.size[:2]) / 2).all(axis=1)

    counted = (inside(a) & inside(b)).sum() / 1600
    assert polygon_intersection(footprint(a), footprint(b)) == pytest.approx(counted, abs=0.06)


def test_upright_box_of_a_lying_object():
    lying = node("bottle", (0.8, 0, 0), (0.06, 0.08, 0.2), math.pi / 2)
    lying = lying.model_copy(update={"base_tilt": (math.sqrt(0.5), 0, math.sqrt(0.5), 0)})
    box = upright(lying)
    assert box.size == pytest.approx((0.2, 0.08, 0.06))
    corners = lying.box3d.corners(lying.base_tilt)
    assert box.corners().min(axis=0) == pytest.approx(corners.min(axis=0))
    assert box.corners().max(axis=0) == pytest.approx(corners.max(axis=0))


def test_names_and_order_of_nodes_do_not_affect_the_measure():
    truth = three()
    renamed = {"table": "low", "low": "far", "high": "table", "far": "high"}
    nodes = tuple(
        n.model_copy(update={"name": renamed[n.name], "parent": renamed.get(n.parent)})
        for n in reversed(truth.nodes)
    )
    result = parse_measure(SceneTree(camera=truth.camera, nodes=nodes), truth)
    assert result.matched == renamed
    for mean in (result.iou_2d, result.iou_3d, result.iou_3d_scaled):
        assert (mean.value, mean.n) == (pytest.approx(1), 3)
    assert (result.edge_f1, result.relations.value, result.tree_distance) == (1, 1, 0)
    assert (result.depth_order.value, result.size_order.value) == (1, 1)
    assert result.position_m.value == result.size_log.value == 0
    assert result.yaw_deg.n == 1
    assert result.missed == result.extra == ()
    assert result.pitch_deg == result.fovy_deg == result.height_m == 0


def test_missed_and_extra_objects_and_wrong_parents():
    truth = three()
    table_, low, high, far = truth.nodes
    extra = node("ghost", (0.5, -0.3, 0), (0.05, 0.05, 0.05))
    moved = high.model_copy(update={"parent": "table"})
    result = parse_measure(SceneTree(camera=CAMERA, nodes=(table_, low, moved, extra)), truth)
    assert far.name in result.missed
    assert result.missed == ("far",)
    assert result.extra == ("ghost",)
    # True edges: low, high, far. Parsed: low, high (wrong), ghost. One is common.
    assert (result.edges_true, result.edges_parsed) == (3, 3)
    assert result.edge_precision == result.edge_recall == result.edge_f1 == pytest.approx(1 / 3)
    assert result.tree_distance == 1 + 1 + 1
    assert result.iou_2d.n == 2


def test_means_without_matches_are_none():
    truth = three()
    elsewhere = node("a", (0.6, -0.4, 0), (0.02, 0.02, 0.02))
    result = parse_measure(SceneTree(camera=CAMERA, nodes=(table(), elsewhere)), truth)
    assert result.iou_3d.value is None
    assert result.depth_order.value is None
    assert result.iou_2d.n == 0
    assert result.missed == ("low", "high", "far")
    assert result.edge_f1 == 0


def test_scale_about_the_camera_is_separated_from_other_errors():
    truth, s = three(), 0.5
    camera = CAMERA.model_copy(update={"height": CAMERA.height * s})
    nodes = tuple(
        n.model_copy(
            update={
                "box3d": Box3D(
                    position=tuple(s * v for v in n.box3d.position),
                    size=tuple(s * v for v in n.box3d.size),
                    yaw=n.box3d.yaw,
                )
            }
        )
        for n in truth.nodes
    )
    result = parse_measure(SceneTree(camera=camera, nodes=nodes), truth)
    assert result.scale == pytest.approx(1 / s)
    assert result.iou_3d.value < 0.2
    assert result.iou_3d_scaled.value == pytest.approx(1)
    assert result.size_ratio_log.value == pytest.approx(0, abs=1e-12)
    assert result.size_log.value == pytest.approx(math.log(2))
    assert result.height_m == pytest.approx(-0.3)


def test_orders_count_pairs_without_ties():
    truth = three()
    far = truth.node("far").box3d
    near = far.model_copy(update={"position": (0.3, -0.2, 0)})
    result = parse_measure(changed(truth, "far", box3d=near), truth)
    # "far" is now nearer than both others; low and high are apart by more than a tie in depth.
    assert result.depth_order.n == 3
    assert result.depth_order.value == pytest.approx(1 / 3)
    small = far.model_copy(update={"size": (0.01, 0.01, 0.01)})
    result = parse_measure(changed(truth, "far", box3d=small), truth)
    sizes = {n.name: np.prod(n.box3d.size) ** (1 / 3) for n in truth.nodes}
    wrong = sum(sizes["far"] > sizes[other] for other in ("low", "high"))
    ties = sum(abs(sizes["far"] / sizes[o] - 1) < 0.02 for o in ("low", "high"))
    assert result.size_order.n == 3 - ties
    assert result.size_order.value == pytest.approx((3 - ties - wrong) / (3 - ties))
    expected = abs(math.log(sizes["far"] / 0.01)) * 2 / 3
    assert result.size_ratio_log.value == pytest.approx(expected)


def test_flags_parts_and_camera_errors():
    door = PartState(part="door", type="revolute", opening=0.2)
    drawer = PartState(part="drawer", type="prismatic")
    truth = changed(three(), "far", articulation=(door, drawer), occluded=True)
    seen = changed(three(), "far", articulation=(door,))
    camera = CAMERA.model_copy(update={"pitch": CAMERA.pitch + math.radians(3), "fovy": 0.7})
    result = parse_measure(SceneTree(camera=camera, nodes=seen.nodes), truth)
    assert (result.parts.value, result.parts.n) == (0.5, 1)
    assert result.occluded.value == pytest.approx(2 / 3)
    assert result.pitch_deg == pytest.approx(3)
    assert result.fovy_deg == pytest.approx(math.degrees(-0.1))


def test_matching_maximises_the_total_overlap():
    a = node("a", (0.7, 0.0, 0))
    b = node("b", (0.7, 0.05, 0))
    truth = SceneTree(camera=CAMERA, nodes=(table(), a, b))
    # p overlaps both, slightly better with a; q overlaps with a alone.
    p = node("p", (0.7, 0.02, 0))
    q = node("q", (0.7, -0.02, 0))
    assert match(SceneTree(camera=CAMERA, nodes=(table(), p, q)), truth) == {
        "table": "table",
        "a": "q",
        "b": "p",
    }
