"""Joints that are seen open: rendered doors and drawers, and which joints are unknowns."""

import math

import numpy as np
import pytest

from neoworld_mjx.compose.resting_pose import with_aligned_joints_held
from neoworld_mjx.config import AlignOptions
from neoworld_mjx.estimate.align import align
from neoworld_mjx.estimate.normal_equations import image_jacobian
from neoworld_mjx.estimate.open_joints import LEAST_OPENING
from neoworld_mjx.estimate.unknowns import STRETCH
from neoworld_mjx.spec import (
    Box,
    GeomSpec,
    JointSpec,
    Material,
    ObjectSpec,
    PartSpec,
    link_poses,
    world_poses,
)
from tests.estimate import desk

DEPTH, WIDTH, HEIGHT, WALL = 0.14, 0.2, 0.24, 0.012
FRONT = -DEPTH / 2 - WALL / 2
"""Outer sizes of the cabinet, and where its front is [m]; the camera is at negative x."""


def geom(name, size, pos, color):
    return GeomSpec(name=name, shape=Box(size=size), pos=pos, material=color)


def cabinet(door, moving, hinge, height=HEIGHT):
    """A white cabinet without a front, and a part that a joint moves."""
    across = (DEPTH, WALL, height)
    body = (
        geom("back", (WALL, WIDTH, height), (DEPTH / 2 - WALL / 2, 0, height / 2), "white"),
        geom("left", across, (0, WIDTH / 2 - WALL / 2, height / 2), "white"),
        geom("right", across, (0, WALL / 2 - WIDTH / 2, height / 2), "white"),
        geom("bottom", (DEPTH, WIDTH, WALL), (0, 0, WALL / 2), "white"),
    )
    colors = dict.fromkeys(("white", door))
    return ObjectSpec(
        name="cabinet",
        materials=tuple(
            Material(name=c, density=600, friction=0.5, rgba=desk.COLORS[c]) for c in colors
        ),
        parts=(PartSpec(name="body", geoms=body), PartSpec(name="front", geoms=moving)),
        joints=(JointSpec(name="open", parent="body", child="front", **hinge),),
    )


def with_door(degrees, door="red", upper=2.0):
    """A desk with a cabinet whose door is open, and two other objects."""
    panel = geom("panel", (WALL, WIDTH, HEIGHT), (FRONT, 0, HEIGHT / 2), door)
    hinge = {"type": "revolute", "pos": (FRONT, WIDTH / 2, 0), "axis": (0, 0, -1), "upper": upper}
    state = {"open": math.radians(degrees)}
    return desk.on_desk(
        (cabinet(door, (panel,), hinge), (0.0, 0.0), 0.3, {"joint_state": state}),
        (desk.block("box", 0.1, 0.08, 0.06, "blue"), (-0.15, -0.25), 0.3, {}),
        (desk.can("can", 0.04, 0.12, "green"), (0.1, 0.32), 0.0, {}),
    )


def with_drawer(open_m):
    """A desk with a cabinet whose drawer is open, and a block in the drawer."""
    height, low = 0.1, 0.02
    length, width = DEPTH - WALL, WIDTH - 3 * WALL
    drawer = (
        geom("front", (WALL, WIDTH, height), (FRONT, 0, height / 2), "red"),
        geom("floor", (length, width, WALL), (-WALL / 2, 0, low), "red"),
        geom("side", (length, WALL, 0.05), (-WALL / 2, width / 2, 0.05), "red"),
    )
    slide = {"type": "prismatic", "axis": (-1, 0, 0), "upper": 0.12}
    spec = cabinet("red", drawer, slide, height)
    inside = {"parent": "cabinet", "parent_link": "front", "relation": "in", "z": low + WALL / 2}
    return desk.on_desk(
        (spec, (0.0, 0.0), 0.2, {"joint_state": {"open": open_m}}),
        (desk.block("block", 0.04, 0.05, 0.04, "yellow"), (-0.03, 0.01), 0.2, inside),
        (desk.block("box", 0.1, 0.08, 0.06, "blue"), (-0.1, -0.3), 0.3, {}),
        (desk.can("can", 0.04, 0.12, "green"), (0.1, 0.32), 0.0, {}),
    )


def opening(scene):
    return scene.object("cabinet").joint_state["open"]


@pytest.fixture(scope="module")
def door_photo():
    return desk.photograph(with_door(60), 640)


@pytest.fixture(scope="module")
def opened(door_photo):
    """The alignment of a door that is composed at 45 degrees and stands at 60."""
    return align(with_door(45), door_photo, AlignOptions(joints=True))


def test_a_door_at_a_wrong_angle_comes_back(door_photo, opened):
    assert math.degrees(opening(opened.scene)) == pytest.approx(60, abs=3)
    truth = with_door(60)
    without = align(with_door(45), door_photo, AlignOptions(joints=False))
    assert opening(without.scene) == opening(with_door(45))
    assert without.objects["cabinet"].joints == {}
    # The wrong angle would have moved the cabinet.
    errors = [desk.distances(r.scene, truth)["cabinet"] for r in (opened, without)]
    assert errors[0] < errors[1] / 2
    assert desk.turns(opened.scene, truth)["cabinet"] < 1.0


@pytest.mark.parametrize("degrees", [90 * LEAST_OPENING])
def test_a_closed_door_stays(degrees):
    scene = with_door(degrees)
    assert desk.unknowns_of(scene).joints == ()
    result = align(scene, desk.photograph(scene, 640), AlignOptions(joints=True))
    assert opening(result.scene) == opening(scene)
    assert result.objects["cabinet"].joints == {}


def test_a_door_does_not_open_beyond_its_limit(door_photo):
    upper = math.radians(52)
    result = align(with_door(45, upper=upper), door_photo, AlignOptions(joints=True))
    assert opening(result.scene) == pytest.approx(upper, abs=1e-9)
    assert opening(result.scene) <= upper + 1e-12


def test_a_drawer_comes_back_with_its_contents():
    truth, wrong = with_drawer(0.09), with_drawer(0.06)
    result = align(wrong, desk.photograph(truth, 640), AlignOptions(joints=True))
    change = result.objects["cabinet"].joints["open"]
    assert opening(result.scene) == pytest.approx(0.09, abs=0.008)
    assert change.slides and change.change > 0.02
    assert "cm more than composed" in change.phrase()
    # The block stays where it is in the drawer, and so it comes to its place in the world.
    assert 1000 * np.hypot(*np.subtract(result.scene.object("block").xy, (-0.03, 0.01))) < 6.0
    before, after = (desk.distances(s, truth)["block"] for s in (wrong, result.scene))
    assert before > 25 and after < before / 3


@pytest.mark.parametrize("make", [lambda: with_door(45), lambda: with_drawer(0.06)])
def test_the_jacobian_of_moving_parts_is_that_of_the_written_scene(make):
    scene = make()
    unknowns = desk.unknowns_of(scene)
    k, part = 1, len(scene.objects)
    x = np.zeros(unknowns.size)
    x[unknowns.columns(k)] = (0.01, -0.01, 0.05, 0.03)
    x[unknowns.first_joint] = 0.02
    rng = np.random.default_rng(0)
    points = rng.uniform((FRONT - 0.1, -0.1, 0.0), (FRONT, 0.1, 0.2), (6, 3))
    angle = rng.uniform(0, 2 * np.pi, 6)
    normal = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    now, neighbors = unknowns.place(x[None])[0], unknowns.neighbors(x)
    mine = image_jacobian(unknowns, now, neighbors, k, points, normal, 640, np.full(6, part))
    assert mine.shape == (6, unknowns.size + 2 * STRETCH)
    composed = link_poses(scene.objects[k].spec, scene.objects[k].joint_state)["front"]

    def written(x):
        after = unknowns.scene_at(x)
        item = after.objects[k]
        link = link_poses(item.spec, item.joint_state)["front"]
        size = math.exp(x[unknowns.columns(k)][3])
        at = link.apply(size * composed.inverse().apply(points))
        return after.camera.project(world_poses(after)[item.name].apply(at))[0]

    step = 1e-5
    for u in range(unknowns.size):
        unit = step * np.eye(unknowns.size)[u]
        expected = np.sum((written(x + unit) - written(x - unit)) * normal, axis=1) / (2 * step)
        assert mine[:, u] == pytest.approx(expected, rel=2e-3, abs=0.02), u
    assert np.abs(mine[:, unknowns.first_joint]).max() > 10
    # The length of a door is as good an explanation as its angle; a drawer's front has no length.
    turns = unknowns.joints[0].anchor is not None
    assert mine[:, unknowns.size + STRETCH :].any() == turns


def changed(scene, **update):
    """The scene with another joint at its cabinet."""
    item = scene.object("cabinet")
    joint = item.spec.joints[0].model_copy(update=update)
    spec = item.spec.model_copy(update={"joints": (joint,)})
    items = [o.model_copy(update={"spec": spec}) if o is item else o for o in scene.objects]
    return scene.model_copy(update={"objects": tuple(items)})


def test_a_joint_is_held_at_its_new_opening():
    """A flap whose opening the alignment changed gets the friction that gravity asks for."""
    scene = changed(with_door(45), axis=(0.0, 1.0, 0.0), pos=(FRONT, 0.0, HEIGHT))
    known = desk.displaced(scene).object("cabinet")
    deviations = {"along": 0.01, "across": 0.01, "yaw": 0.01, "log_scale": 0.01}
    for joints, raised in (({"open": 0.1}, True), ({}, False)):
        uncertainty = {**deviations, "joints": joints}
        fields = known.model_dump() | {"uncertainty": uncertainty}
        item = type(known).model_validate(fields)
        items = tuple(item if o.name == item.name else o for o in scene.objects)
        aligned = scene.model_copy(update={"objects": items})
        held, notes = with_aligned_joints_held(aligned)
        friction = held.object("cabinet").spec.joints[0].friction
        assert (friction > 0) == raised
        assert any("dry friction" in note for note in notes) == raised
