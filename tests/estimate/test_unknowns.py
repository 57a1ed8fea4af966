"""The scene at some values of the unknowns, placed and written."""

import math

import numpy as np
import pytest

from neoworld_mjx.estimate.rows.linear import image_jacobian
from neoworld_mjx.estimate.unknowns import CAMERA, EACH, FOCAL, Unknowns
from neoworld_mjx.spec import bounds, world_poses
from neoworld_mjx.spec.pose import matrix
from tests.estimate import desk
from tests.support import scenes

SCENES = [scenes.coffee, scenes.furnished, scenes.lamp, desk.five]


def on_a_wall(turn, thin):
    """A wall that is thin along x or y, with a picture on it and a hook on the picture's top."""
    size = (0.05, 1.0, 1.0) if thin == 0 else (1.0, 0.05, 1.0)
    scene = desk.on_desk()
    wall = scene.objects[0].model_copy(
        update={"name": "wall", "spec": desk.block("wall", *size, "white"), "yaw": turn, "z": 0.0}
    )
    flat = (0.02, 0.3, 0.2) if thin == 0 else (0.3, 0.02, 0.2)
    off = (-0.035, 0.1) if thin == 0 else (0.1, -0.035)
    picture = wall.model_copy(
        update={
            "name": "picture",
            "spec": desk.block("picture", *flat, "red"),
            "environment": False,
            "parent": "wall",
            "relation": "attached",
            "xy": off,
            "z": 0.3,
            "yaw": 0.0,
        }
    )
    hook = picture.model_copy(
        update={"name": "hook", "parent": "picture", "relation": "on", "xy": (0, 0), "z": 0.2}
    )
    return scene.model_copy(update={"objects": (wall, picture, hook)})


def values(unknowns, seed=0, size=1.0):
    rng = np.random.default_rng(seed)
    return size * np.concatenate(
        [
            rng.normal(0, 0.05, CAMERA),
            rng.normal(0, (0.02, 0.02, 0.1, 0.05), (len(unknowns.free), EACH)).ravel(),
        ]
    )


def written(unknowns, x, k, points):
    """Pixels at 640 px of points of an object at scale 1, in the scene that `scene_at` writes."""
    scene = unknowns.scene_at(x)
    item, was = scene.objects[k], unknowns.scene.objects[k]
    edges = [np.ptp(bounds(o.spec), axis=0) for o in (item, was)]
    size = edges[0][0] / edges[1][0]
    pixels, _ = scene.camera.project(world_poses(scene)[item.name].apply(size * points))
    return pixels * 640 / scene.camera.width


@pytest.mark.parametrize("make", SCENES)
def test_placement_at_zero_is_the_scene(make):
    scene = make()
    unknowns = desk.unknowns_of(scene)
    assert unknowns.size == CAMERA + EACH * len(unknowns.free)
    assert [scene.objects[k].name for k in unknowns.free] == [
        item.name for item in scene.objects if item.parent is not None
    ]
    now = unknowns.place(np.zeros((1, unknowns.size)))[0]
    assert now.camera == scene.camera
    assert np.array_equal(now.scale, np.ones(len(scene.objects)))
    for k, pose in enumerate(world_poses(scene).values()):
        assert now.pos[k] == pytest.approx(pose.pos, abs=1e-12)
        assert now.turn[k] == pytest.approx(matrix(pose.quat), abs=1e-12)
    assert unknowns.scene_at(np.zeros(unknowns.size)) == scene


@pytest.mark.parametrize("make", [*SCENES, lambda: on_a_wall(0.4, 0)])
def test_the_written_scene_is_the_placed_one(make):
    unknowns = desk.unknowns_of(make())
    for seed in range(3):
        x = values(unknowns, seed)
        now, scene = unknowns.place(x[None])[0], unknowns.scene_at(x)
        assert scene.camera == now.camera
        for k, pose in enumerate(world_poses(scene).values()):
            assert now.pos[k] == pytest.approx(pose.pos, abs=1e-9)
            assert now.turn[k] == pytest.approx(matrix(pose.quat), abs=1e-9)
        for k, item in enumerate(unknowns.scene.objects):
            low, high = bounds(item.spec)
            grown = scene.objects[k]
            after = bounds(grown.spec)
            assert after[1] - after[0] == pytest.approx(now.scale[k] * (high - low), rel=1e-6)
            points = np.array([low, high])
            assert now.local(k, now.world(k, points)) == pytest.approx(points, abs=1e-12)


@pytest.mark.parametrize("turn", [0.0, math.pi / 2])
def test_a_standing_object_keeps_its_clearance_while_it_and_its_support_grow(turn):
    """One that lies on its side has its origin there, not at its lowest point."""
    scene = scenes.blocks()
    k, lying = scene.index("high"), (math.cos(turn / 2), math.sin(turn / 2), 0.0, 0.0)
    low = bounds(scene.objects[k].spec, {}, lying)[0][2]
    high = scene.objects[k].model_copy(update={"base_tilt": lying, "z": 0.06 - low})
    scene = scene.model_copy(update={"objects": (*scene.objects[:k], high, scene.objects[-1])})
    unknowns = desk.unknowns_of(scene)
    x = np.zeros(unknowns.size)
    x[unknowns.columns(scene.index("low"))] = (0.01, 0, 0, 0.1)
    x[unknowns.columns(scene.index("high"))] = (0, 0.01, 0, -0.2)
    after = unknowns.scene_at(x)
    low, high = (world_poses(after)[name].pos for name in ("low", "high"))
    bottom = lambda o: bounds(after.object(o).spec, {}, after.object(o).base_tilt)[0][2]
    assert low[2] + bottom("low") == pytest.approx(0.0, abs=1e-9)
    assert high[2] + bottom("high") == pytest.approx(0.06 * math.exp(0.1), abs=1e-9)


def test_a_near_scene_keeps_its_place_in_the_picture_while_the_field_of_view_changes():
    """It is nearer than 1 m."""
    near = desk.CAMERA.model_copy(update={"xy": (0.5, 0.0), "height": 0.3})
    scene = desk.on_desk((desk.can("can", 0.04, 0.1, "red"), (0.05, 0.1), 0.0, {}), camera=near)
    unknowns = desk.unknowns_of(scene)
    x = np.zeros(unknowns.size)
    x[FOCAL] = 0.3
    before, after = unknowns.place(np.stack([0 * x, x]))
    pixel, there = (now.camera.project(now.pos[1])[0] for now in (before, after))
    assert there == pytest.approx(pixel, abs=0.5)


def test_a_support_does_not_grow_to_raise_an_object():
    scene = scenes.blocks()
    unknowns = Unknowns.of(scene, scene.camera, rises=True)
    low, high = (scene.index(name) for name in ("low", "high"))
    used, (*place, size) = unknowns.columns_of(high), range(unknowns.size)[unknowns.columns(low)]
    assert size not in used
    assert {*place, *unknowns.rise_columns(low), *unknowns.rise_columns(high)} < {*used}


def check_jacobian(unknowns, x, k):
    scene = unknowns.scene
    rng = np.random.default_rng(k)
    low, high = bounds(scene.objects[k].spec, scene.objects[k].joint_state)
    points = rng.uniform(low, high, (7, 3))
    angle = rng.uniform(0, 2 * np.pi, 7)
    normal = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    now, neighbors = unknowns.place(x[None])[0], unknowns.neighbors(x)
    mine = image_jacobian(unknowns, now, neighbors, k, points, normal, 640)
    assert mine.shape == (7, unknowns.size + len(unknowns.stretch_columns(k)))
    step = 1e-4
    for u in range(unknowns.size):
        unit = step * np.eye(unknowns.size)[u]
        there, back = (written(unknowns, x + sign * unit, k, points) for sign in (1, -1))
        expected = np.sum((there - back) * normal, axis=1) / (2 * step)
        assert mine[:, u] == pytest.approx(expected, rel=2e-3, abs=0.02), (k, u)
    return mine


@pytest.mark.parametrize("make", [scenes.coffee, scenes.furnished, lambda: on_a_wall(0.4, 0)])
def test_the_jacobian_is_that_of_the_written_scene(make):
    """By pitch, roll, focal length and height, and by place, heading and size of the object and of
    everything below it; zero for all others.
    """
    unknowns = desk.unknowns_of(make())
    for k in unknowns.free.tolist():
        mine = check_jacobian(unknowns, values(unknowns, 5, 0.5), k)
        above = np.flatnonzero(unknowns.arrangement.ancestors[k])
        for other in unknowns.free.tolist():
            moves = np.abs(mine[:, unknowns.columns(other)]).max(axis=0)
            assert (moves[[0, 1]] > 1).all() if other in above else not moves.any()
        assert (np.abs(mine[:, :CAMERA]).max(axis=0) > 1).all()


@pytest.mark.parametrize("turn", [0.0, 0.4])
@pytest.mark.parametrize("thin", [0, 1])
def test_an_object_on_a_wall_moves_in_its_plane(turn, thin):
    scene = on_a_wall(turn, thin)
    unknowns = desk.unknowns_of(scene)
    x = np.zeros(unknowns.size)
    x[unknowns.columns(1)] = (0.03, 0.05, 0, 0)
    off = world_poses(unknowns.scene_at(x))["picture"].pos - world_poses(scene)["picture"].pos
    c, s = math.cos(turn), math.sin(turn)
    axes = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]])
    expected = np.zeros(3)
    expected[1 - thin], expected[2] = 0.03, 0.05
    assert axes @ off == pytest.approx(expected, abs=1e-9)
    assert not unknowns.in_wall[[0, 2]].any()


def test_a_turned_scene_is_where_it_was_written():
    unknowns = desk.unknowns_of(scenes.coffee())
    there = unknowns.scene_at(values(unknowns, 1))
    turned = desk.unknowns_of(there)
    back = turned.scene_at(turned.values_of(unknowns.scene))
    for name, pose in world_poses(unknowns.scene).items():
        assert world_poses(back)[name].pos == pytest.approx(pose.pos, abs=0.01)
        assert matrix(world_poses(back)[name].quat) == pytest.approx(matrix(pose.quat), abs=1e-6)


def test_what_is_attached_keeps_its_share_of_the_height_of_a_parent_that_grows():
    made = scenes.blocks()
    objects = [
        o.model_copy(update={"relation": "attached"}) if o.name == "high" else o
        for o in made.objects
    ]
    scene = made.model_copy(update={"objects": tuple(objects)})
    unknowns = desk.unknowns_of(scene)
    x = np.zeros(unknowns.size)
    x[unknowns.columns(scene.index("low"))] = (0, 0, 0, 0.2)
    grown = unknowns.scene_at(x).object("high")
    assert grown.z == pytest.approx(scene.object("high").z * math.exp(0.2))
