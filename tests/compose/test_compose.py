"""Composition: sizes from parsed boxes, heights from the surface under the footprint."""

import math

import numpy as np
import pytest

from neoworld_mjx.compose.compose import as_parsed, compose, moved_tree
from neoworld_mjx.compose.resting_pose import on_level, pose_without_scene, resting_tilt
from neoworld_mjx.measure import measured
from neoworld_mjx.physics.colliders import object_depths, start_state
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.spec import (
    Box,
    Box2D,
    Box3D,
    Camera,
    Capsule,
    Cylinder,
    Ellipsoid,
    Lathe,
    Material,
    ObjectSpec,
    PartState,
    SceneTree,
    TreeNode,
    bounds,
    scale,
    world_poses,
)
from neoworld_mjx.spec.pose import IDENTITY, angle_between, from_axis_angle, from_yaw, rotate
from tests.support import scenes
from tests.support.mechanisms import geom, part
from tests.support.scenes import compile_scene

LIGHT = Material(name="wood", density=500, rgba=(0.6, 0.4, 0.2, 1))
CAMERA = Camera(width=640, height_px=480, fovy=0.8, height=1.0, pitch=0.6)
PIXELS = Box2D(x0=10, y0=10, x1=100, y1=100)


def node(name, spec, position, parent="table", yaw=0.0, size=None, **fields):
    low, high = bounds(spec)
    return TreeNode(
        name=name,
        label=name,
        parent=parent,
        box2d=PIXELS,
        box3d=Box3D(position=position, size=tuple(size or (high - low).tolist()), yaw=yaw),
        **fields,
    )


def ground():
    return TreeNode(
        name="table",
        label="table",
        environment=True,
        box2d=PIXELS,
        box3d=Box3D(position=(1.0, 0, -0.04), size=(0.6, 0.8, 0.04), yaw=0.4),
    )


def composed(nodes, specs):
    tree = SceneTree(camera=CAMERA, nodes=(ground(), *nodes))
    return compose(tree, {"table": scenes.table(), **specs})


def test_an_object_is_rescaled_to_its_box():
    small = scale(scenes.cup(), 0.01)
    low, high = bounds(scenes.cup())
    result = composed([node("cup", scenes.cup(), (1.0, 0, 0))], {"cup": small})
    assert result.scales["cup"] == pytest.approx(100.0)
    item = result.scene.object("cup")
    a, b = bounds(item.spec)
    assert np.allclose(b - a, high - low)
    assert np.allclose(item.scale_residual, 0, atol=1e-9)


def test_the_residual_of_isotropic_scaling_is_recorded_per_axis():
    box = scenes.block("box", (0.1, 0.1, 0.1))
    result = composed([node("box", box, (1.0, 0, 0), size=(0.1, 0.1, 0.2))], {"box": box})
    factor = 2 ** (1 / 3)
    assert result.scales["box"] == pytest.approx(factor)
    expected = (factor - 1, factor - 1, factor / 2 - 1)
    assert result.scene.object("box").scale_residual == pytest.approx(expected)


def test_positions_and_headings_match_the_parse():
    cup = scenes.cup()
    result = composed([node("cup", cup, (1.1, -0.2, 0.0), yaw=1.0)], {"cup": cup})
    pose = world_poses(result.scene)["cup"]
    assert pose.pos[:2] == pytest.approx([1.1, -0.2])
    assert pose.pos[2] == pytest.approx(1e-4, abs=1e-6)
    assert pose.quat == pytest.approx([math.cos(0.5), 0, 0, math.sin(0.5)])
    assert result.scene.object("cup").yaw == pytest.approx(0.6)  # the table's yaw is 0.4


def test_only_contents_keep_their_parsed_height():
    cup, ball = scenes.cup(), scenes.single("ball", (Box(size=(0.01, 0.01, 0.01)), (0, 0, 0)))
    nodes = (
        node("cup", cup, (1.0, 0.0, 0.03)),
        node("ball", ball, (1.0, 0.0, 0.09), parent="cup", relation="in"),
    )
    tree = SceneTree(camera=CAMERA, nodes=(ground(), *nodes))
    poses = world_poses(as_parsed(tree, {"table": scenes.table(), "cup": cup, "ball": ball}))
    assert poses["cup"].pos[2] == pytest.approx(0.0, abs=1e-3)
    assert poses["ball"].pos[2] - poses["cup"].pos[2] == pytest.approx(0.06, abs=1e-3)


def test_a_tree_moves_with_its_objects_but_not_what_the_user_placed():
    cup = scenes.cup()
    free, kept = (node(name, cup, (x, 0.0, 0.0)) for name, x in (("free", 1.0), ("kept", 1.2)))
    kept = kept.model_copy(update={"cues": kept.cues.model_copy(update={"kept": True})})
    tree = SceneTree(camera=CAMERA, nodes=(ground(), free, kept))
    before = as_parsed(tree, {"table": scenes.table(), "free": cup, "kept": cup})
    shifted = [
        item if item.parent is None else item.model_copy(update={"xy": (item.xy[0] + 0.05, 0.0)})
        for item in before.objects
    ]
    after = moved_tree(tree, before, before.model_copy(update={"objects": tuple(shifted)}))
    assert after.node("kept") == kept and after.node("table") == tree.node("table")
    moved = np.subtract(after.node("free").box3d.position, free.box3d.position)
    assert np.linalg.norm(moved[:2]) > 0.04


@pytest.mark.parametrize("off", [-0.01, 0.0, 0.02])
def test_a_spoon_settles_on_the_saucer_from_any_parsed_height(off):
    specs = {"saucer": scenes.saucer(), "spoon": scenes.spoon()}
    result = composed(
        [
            node("saucer", specs["saucer"], (1.0, 0, 0)),
            node("spoon", specs["spoon"], (1.0, 0.04, 0.01 + off), parent="saucer", yaw=0.3),
        ],
        specs,
    )
    height = world_poses(result.scene)["spoon"].pos[2]
    assert 0.004 < height < 0.02
    model, data = start_state(result.scene)
    assert max(object_depths(result.scene, model, data).values(), default=0) < 1e-3
    # A millimetre lower it would penetrate, so it touches.
    down = result.scene.object("spoon").model_copy(
        update={"z": result.scene.object("spoon").z - 2e-3}
    )
    objects = (*result.scene.objects[:-1], down)
    lowered = result.scene.model_copy(update={"objects": objects})
    model, data = start_state(lowered)
    assert ("saucer", "spoon") in object_depths(lowered, model, data)


def test_a_book_that_overlaps_the_side_of_its_shelf_stays_on_its_board():
    """The relation is "on"; the composed position and a layout overlap the side."""
    boards = [(Box(size=(0.3, 0.8, 0.02)), (0, 0, z)) for z in (0.0, 0.4, 0.8)]
    sides = [(Box(size=(0.3, 0.02, 0.82)), (0, y, 0.0)) for y in (-0.41, 0.41)]
    shelf, book = (
        scenes.single("shelf", *boards, *sides),
        scenes.block("book", (0.15, 0.03, 0.22)),
    )
    result = composed(
        [node("shelf", shelf, (1.0, 0, 0)), node("book", book, (1.0, 0.395, 0.42), parent="shelf")],
        {"shelf": shelf, "book": book},
    )
    on_board = world_poses(result.scene)["book"].pos[2]
    assert on_board == pytest.approx(world_poses(result.scene)["shelf"].pos[2] + 0.42, abs=2e-3)
    model = compile_scene(result.scene, samples=64)
    layouts = Layout.zero(1, len(model.names))
    book_moved = np.asarray(layouts.xy) + [[0, 0.01 * (name == "book")] for name in model.names]
    placed = model.place(Layout(book_moved.astype(np.float32), layouts.yaw, layouts.log_scale))
    height = placed.pos[0, model.names.index("book"), 2]
    assert float(height) == pytest.approx(on_board, abs=2e-3)


def test_objects_stand_on_the_surfaces_of_furniture():
    """A shelf of two boards: one object lies tilted on the lower board, one stands on top."""
    boards = [(Box(size=(0.3, 0.8, 0.02)), (0, 0, z)) for z in (0.2, 0.5)]
    sides = [(Box(size=(0.3, 0.02, 0.5)), (0, y, 0.25)) for y in (-0.41, 0.41)]
    shelf = scenes.single("shelf", *boards, *sides)
    cup = scenes.cup()
    nodes = [
        node("shelf", shelf, (1.0, 0, 0), environment=True, furniture=True),
        node("low", cup, (1.0, 0.1, 0.21), parent="shelf", relation="in"),
        node("high", cup, (1.0, -0.1, 0.53), parent="shelf"),
    ]
    result = composed(nodes, {"shelf": shelf, "low": cup, "high": cup})
    heights = {name: at.pos[2] for name, at in world_poses(result.scene).items()}
    assert heights["low"] == pytest.approx(0.21, abs=1e-3)
    assert heights["high"] == pytest.approx(0.51, abs=1e-3)
    assert result.scene.object("shelf").static
    assert measured(result.scene).s_stab
    tree = SceneTree(camera=CAMERA, nodes=(ground(), *nodes))
    assert on_level(tree.node("shelf"), tree) and not on_level(tree.node("high"), tree)


@pytest.mark.parametrize("off", [0.01, 0.06])
def test_an_object_parsed_across_a_rim_stands_on_the_floor_inside(off):
    profile = ((0, 0), (0.04, 0), (0.06, 0.07))
    pot = scenes.single("pot", (Lathe(profile=profile, thickness=0.004), (0, 0, 0)))
    shapes = {"pot": pot, "small": scale(pot, 0.8)}
    small = node("small", shapes["small"], (1.0, off, 0.01), parent="pot", relation="in")
    result = composed([node("pot", pot, (1.0, 0, 0)), small], shapes)
    at = world_poses(result.scene)["small"].pos
    # At the position nearest to the parsed one that the wall permits.
    assert at[1] == pytest.approx(min(off, 0.0038), abs=5e-4) and at[2] < 0.006
    assert len(result.notes) == 1
    if off > 0.05:
        # With the relation "on" it may stand on the rim.
        on = small.model_copy(update={"relation": "on"})
        result = composed([node("pot", pot, (1.0, 0, 0)), on], shapes)
        assert world_poses(result.scene)["small"].pos[1:] == pytest.approx((off, 0.0713), abs=1e-3)


def test_a_tube_goes_into_the_nearest_hole_of_its_rack_that_is_free():
    sides = [(Box(size=(0.08, 0.02, 0.05)), (0, y, 0.025)) for y in (-0.06, -0.02, 0.02, 0.06)]
    walls = [(Box(size=(0.03, 0.14, 0.05)), (x, 0, 0.025)) for x in (-0.025, 0.025)]
    rack = scenes.single("rack", *sides, *walls, (Box(size=(0.08, 0.14, 0.004)), (0, 0, 0.002)))
    tube = scenes.single("tube", (Cylinder(radius=0.008, height=0.1), (0, 0, 0.05)))
    shapes = {"rack": rack, "a": tube, "b": tube, "c": tube}
    at = {"a": (1.0, 0.03, 0.02), "b": (1.02, 0.034, 0.02), "c": (1.0, -0.025, 0.02)}
    tubes = [node(name, tube, place, parent="rack", relation="in") for name, place in at.items()]
    # The last is parsed slightly tilted, in which pose it fits no hole.
    lean = from_axis_angle((1, 0, 0), math.radians(3.0))
    tubes[2] = tubes[2].model_copy(update={"base_tilt": tuple(lean.tolist())})
    result = composed([node("rack", rack, (1.0, 0, 0)), *tubes], shapes)
    poses = world_poses(result.scene)
    middles = {name: poses[name].apply([0, 0, 0]) for name in at}
    assert [middles[name][2] < 0.006 for name in at] == [True] * 3, middles
    assert [round(float(middles[name][1]) / 0.04) for name in at] == [1, 0, -1]


def test_a_block_in_an_open_drawer_is_supported_by_the_drawer():
    cabinet, block = scenes.cabinet(), scenes.single("b", (Box(size=(0.05,) * 3), (0, 0, 0)))
    closed = bounds(cabinet)
    opened = bounds(cabinet, {"slide": 0.15})
    result = composed(
        [
            node(
                "cabinet",
                cabinet,
                (1.0, 0, 0),
                size=tuple((opened[1] - opened[0]).tolist()),
                articulation=(
                    PartState(part="drawer", type="prismatic", opening=0.5),
                    PartState(part="door", type="revolute", opening=0.0),
                ),
            ),
            node("b", block, (1.2, 0, 0.05), parent="cabinet", parent_link="drawer", relation="in"),
        ],
        {"cabinet": cabinet, "b": block},
    )
    item = result.scene.object("cabinet")
    assert item.joint_state["slide"] == pytest.approx(0.15)
    assert item.joint_state["hinge"] == 0.0
    assert result.scales["cabinet"] == pytest.approx(1.0)
    pose = world_poses(result.scene)["b"]
    assert pose.pos[0] == pytest.approx(1.2)
    # The tray's floor is 1 cm thick and starts 4 cm above the ground.
    assert pose.pos[2] == pytest.approx(0.05 + 2e-4, abs=2e-4)
    assert closed[1][0] < opened[1][0]


def mushroom():
    """A round stem with a thicker, square cap, [0.05, 0.05, 0.09] m."""
    stem = geom("stem", Cylinder(radius=0.015, height=0.07), (0, 0, 0.035))
    cap = geom("cap", Box(size=(0.05, 0.05, 0.02)), (0, 0, 0.08))
    return ObjectSpec(name="mushroom", materials=(LIGHT,), parts=(part("body", stem, cap),))


def test_only_what_cannot_stand_without_its_container_depends_on_its_scene():
    shapes = (Capsule(radius=0.005, length=0.1), Box(size=(0.05, 0.05, 0.05)))
    pen, block = (scenes.single("pen", (shape, (0, 0, 0))) for shape in shapes)
    for spec, relation, depends in ((pen, "in", True), (pen, "on", False), (block, "in", False)):
        where = node("pen", spec, (1.0, 0.0, 0.0), relation=relation)
        assert pose_without_scene(where, spec, level=False) == (where.base_tilt, depends)


def test_a_lying_object_is_tilted_to_its_resting_pose():
    forward = tuple(from_axis_angle((0.0, 1.0, 0.0), math.pi / 2).tolist())
    thing = mushroom()
    where = node("mushroom", thing, (1.0, 0.0, 0.0), yaw=0.3, base_tilt=forward)
    result = composed([where], {"mushroom": thing})
    item = result.scene.objects[1]
    # From the stem's far edge to the cap's near edge: 10 mm over 70 mm.
    turned = angle_between(item.base_tilt, forward)
    assert turned == pytest.approx(math.atan(0.010 / 0.07), abs=math.radians(1.0))
    assert any("mushroom: composition tilted it by" in note for note in result.notes)
    assert measured(result.scene).s_stab
    # The center of its box has not moved.
    seen = bounds(thing, {}, forward)
    lies = bounds(thing, {}, item.base_tilt)
    at = world_poses(result.scene)["mushroom"]
    middle = at.pos[:2] + rotate(from_yaw(0.3), np.mean(lies, axis=0) * [1, 1, 0])[:2]
    parsed = np.array([1.0, 0.0]) + rotate(from_yaw(0.3), np.mean(seen, axis=0) * [1, 1, 0])[:2]
    assert np.allclose(middle, parsed, atol=1e-6)


def test_leaning_and_standing_objects_keep_their_tilt():
    back = tuple(from_axis_angle((0.0, -1.0, 0.0), 0.2).tolist())
    thing = mushroom()
    for fields in (
        {"relation": "leaning", "base_tilt": back},
        {"fixed_base": True, "base_tilt": back},
    ):
        result = composed([node("mushroom", thing, (1.0, 0, 0), **fields)], {"mushroom": thing})
        assert result.scene.objects[1].base_tilt == pytest.approx(back)
        assert result.notes == ()
    result = composed([node("mushroom", thing, (1.0, 0, 0))], {"mushroom": thing})
    assert result.scene.objects[1].base_tilt == (1.0, 0.0, 0.0, 0.0)


def test_an_unstable_upright_object_rolls_to_its_resting_pose():
    # A round bar with a load on top rolls onto the edge of a leaf 1.5 mm above the ground.
    laid = tuple(from_axis_angle((0, 1, 0), math.pi / 2))
    bar = geom("bar", Capsule(radius=0.01, length=0.1), quat=laid)
    leaf = geom("leaf", Box(size=(0.06, 0.03, 0.002)), (0, 0, -0.0075))
    load = geom("load", Box(size=(0.06, 0.01, 0.02)), (0, 0, 0.019))
    spoon = ObjectSpec(name="spoon", materials=(LIGHT,), parts=(part("body", bar, leaf, load),))
    # On furniture, whose top need not be level, it is settled by simulation.
    support = ground().model_copy(update={"furniture": True})
    tree = SceneTree(camera=CAMERA, nodes=(support, node("spoon", spoon, (1.0, 0, 0))))
    settled = compose(tree, {"table": scenes.table(), "spoon": spoon}).scene
    assert 5 < math.degrees(float(angle_between(settled.objects[1].base_tilt, IDENTITY))) < 30
    assert measured(settled).s_stab is True
    result = composed([node("spoon", spoon, (1.0, 0, 0))], {"spoon": spoon})
    turned = math.degrees(float(angle_between(result.scene.object("spoon").base_tilt, IDENTITY)))
    assert 5 < turned < 30
    assert result.notes == (
        f"spoon: composition tilted it by {turned:.1f} deg to its resting pose",
    )
    assert measured(result.scene).s_stab is True


@pytest.mark.parametrize("degrees", [70, 90, 100])
def test_a_tilted_bottle_settles_flat(degrees):
    tilt = tuple(from_axis_angle((0.0, 1.0, 0.0), math.radians(degrees)).tolist())
    rod = part("body", geom("rod", Cylinder(radius=0.02, height=0.2), (0, 0, 0.1)))
    bottle = ObjectSpec(name="b", materials=(LIGHT,), parts=(rod,))
    turned = resting_tilt(bottle, {}, tilt)
    assert turned is not None
    assert rotate(turned, np.array([0.0, 0.0, 1.0]))[2] == pytest.approx(0.0, abs=1e-3)
    assert angle_between(turned, tilt) < math.radians(abs(degrees - 90) + 10)


def test_an_almost_round_fruit_rests_where_it_is_seen():
    """It turns onto its flattest side in place. Upright, it would roll there by a quarter turn."""
    fruit = scenes.single("fruit", (Ellipsoid(radii=(0.0395, 0.039, 0.0395)), (0, 0, 0.0395)))
    result = composed([node("fruit", fruit, (1.0, 0, 0))], {"fruit": fruit})
    placed = result.scene.object("fruit")
    short = rotate(np.array(placed.base_tilt), np.array([0.0, 1.0, 0.0]))
    assert abs(short[2]) == pytest.approx(1.0, abs=1e-3)
    middle = world_poses(result.scene)["fruit"].apply(np.array([[0.0, 0.0, 0.0395]]))[0]
    assert middle[:2] == pytest.approx((1.0, 0.0), abs=1e-4)
    assert measured(result.scene).s_stab is True


@pytest.mark.parametrize("axis", [(0, 1, 0), (1, 0, 0), (0, -1, 0), (-1, 0, 0)])
def test_a_tilted_cube_settles_on_its_nearest_face(axis):
    """Its extents are those of a ball, but it shows how it lies."""
    cube = scenes.single("cube", (Box(size=(0.05, 0.05, 0.05)), (0, 0, 0.025)))
    tilt = tuple(from_axis_angle(axis, math.radians(75)).tolist())
    turned = resting_tilt(cube, {}, tilt)
    assert math.degrees(angle_between(turned, tilt)) == pytest.approx(15, abs=0.1)


@pytest.mark.parametrize("side", [0.035, 0.2])
def test_an_object_tilted_on_a_saucer_is_settled_or_noted(side):
    tilt = tuple(from_axis_angle((0.0, 1.0, 0.0), math.radians(12)).tolist())
    bar = scenes.block("bar", (0.12, 0.014, 0.006))
    result = composed(
        [
            node("saucer", scenes.saucer(), (1.0, 0, 0)),
            node("bar", bar, (1.0, side, 0.02), parent="saucer", base_tilt=tilt),
        ],
        {"saucer": scenes.saucer(), "bar": bar},
    )
    item = result.scene.object("bar")
    if side < 0.1:
        (note,) = result.notes
        assert note.startswith("bar: settling it on saucer tilted it by 14 deg and moved it by ")
        assert angle_between(item.base_tilt, tilt) == pytest.approx(math.radians(14), abs=0.01)
        assert measured(result.scene).tilt_deg["bar"] < 1
    else:
        assert item.base_tilt == pytest.approx(tilt)
        (note,) = result.notes
        assert note == "bar: composition kept the parsed tilt, at which it does not rest on saucer"


def test_a_tilt_far_from_every_resting_pose_is_kept_and_noted():
    """A plate at 60 degrees would fall flat, twice as far as composition may turn it."""
    plate = scenes.block("plate", (0.2, 0.2, 0.02))
    tilt = tuple(from_axis_angle((0.0, 1.0, 0.0), math.radians(60)).tolist())
    result = composed([node("plate", plate, (1.0, 0, 0.1), base_tilt=tilt)], {"plate": plate})
    assert result.scene.object("plate").base_tilt == pytest.approx(tilt)
    (note,) = result.notes
    assert note == "plate: composition kept the parsed tilt, near which it has no resting pose"


FRAME = scenes.single("frame", (Box(size=(0.02, 0.3, 0.2)), (0, 0, 0.1)))
WALL = scenes.single("wall", (Box(size=(0.1, 1.0, 1.0)), (0, 0, 0.5)))


def on_a_wall(**frame):
    wall = TreeNode(
        name="wall",
        label="wall",
        environment=True,
        box2d=PIXELS,
        box3d=Box3D(position=(1.5, 0, 0), size=(0.1, 1.0, 1.0), yaw=math.pi),
    )
    picture = node("frame", FRAME, (1.43, 0, 0.5), "wall", math.pi, relation="attached", **frame)
    return composed([wall, picture], {"wall": WALL, "frame": FRAME})


def test_an_attached_object_is_fixed_and_the_scene_is_stable():
    result = on_a_wall()
    assert result.scene.object("frame").fixed_base
    assert result.notes == ("frame: composition fixed it to wall, because it is attached",)
    assert measured(result.scene).movable == 0


@pytest.mark.parametrize("depth", [0.1, -0.01])
def test_a_note_names_what_moves_far_to_touch_its_wall(depth):
    slab = scenes.single("wall", (Box(size=(0.06, 2.0, 1.0)), (0, 0, 0.5)))
    frame = scenes.single("frame", (Box(size=(0.02, 0.3, 0.2)), (0, 0, 0.1)))
    wall = node("wall", slab, (2.0, 0, 0), environment=True, parent=None)
    at = (2.0 - 0.03 - 0.01 + depth, 0.2, 0.5)
    picture = node("frame", frame, at, parent="wall", relation="attached", fixed_base=True)
    result = composed([wall, picture], {"wall": slab, "frame": frame})
    assert world_poses(result.scene)["frame"].pos == pytest.approx((1.96, 0.2, 0.5), abs=1e-6)
    said = ("frame: composition moved it by 100 mm, to touch wall",)
    assert [n for n in result.notes if "touch" in n] == [*said] * (depth > 0.03)
