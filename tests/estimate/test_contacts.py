"""Contacts of the alignment: gaps between objects, and what they keep apart."""

import numpy as np
import pytest

from neoworld_mjx.config import AlignOptions
from neoworld_mjx.estimate.align import align
from neoworld_mjx.estimate.rows.contacts import ContactGaps, SceneGeoms, contacts
from neoworld_mjx.physics.colliders import geom_distance, object_depths, object_of_geom, start_state
from neoworld_mjx.spec import Mesh, bounds
from tests.estimate import desk
from tests.support.scenes import single

WALL = ((0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.0, 0.08, 0.0), (0.0, 0.0, 0.09))


def pair(gap, **more):
    """Two blocks that face each other with a gap [m] along the view."""
    return desk.on_desk(
        (desk.block("near", 0.1, 0.1, 0.1, "red"), (-0.1, 0.0), 0.0, {}),
        (desk.block("far", 0.1, 0.1, 0.08, "blue"), (0.0 + gap, 0.0), 0.0, more),
    )


def found(scene, x=None):
    unknowns = desk.unknowns_of(scene)
    x = np.zeros(unknowns.size) if x is None else x
    now = unknowns.place(x[None])[0]
    gaps = list(contacts(SceneGeoms.of(scene), unknowns, now))
    return unknowns, ContactGaps.of(gaps, unknowns, now, unknowns.neighbors(x))


@pytest.mark.parametrize("gap", [-0.004, 0.006])
def test_the_gap_is_the_signed_distance_and_its_derivative_moves_it(gap):
    unknowns, result = found(pair(gap))
    assert result.gap == pytest.approx(gap, abs=1e-6)
    move = np.zeros(unknowns.size)
    move[unknowns.columns(2)] = (0.002, 0.001, 0.0, 0.0)
    move[unknowns.columns(1)] = (-0.001, 0.0, 0.0, 0.0)
    _, moved = found(pair(gap), move)
    expected = result.jacobian[:, : unknowns.size] @ move
    assert moved.gap - result.gap == pytest.approx(expected, abs=1e-6)
    assert expected == pytest.approx(0.003, abs=1e-6)


def test_the_first_object_of_a_scene_has_contacts_too():
    """It is a wall 6 mm in front of the block."""
    scene = pair(0.1)
    table, wall, far = scene.objects
    update = {"parent": None, "environment": True, "xy": (0.894, 0.0), "z": 0.0}
    objects = (wall.model_copy(update=update), table, far)
    _, result = found(scene.model_copy(update={"objects": objects}))
    assert result.gap.tolist() == [pytest.approx(0.006, abs=1e-6)]


def test_sizes_give_way():
    unknowns, result = found(pair(-0.004))
    larger = np.zeros(unknowns.size)
    larger[[unknowns.columns(k).stop - 1 for k in (1, 2)]] = 0.01, 0.02
    _, moved = found(pair(-0.004), larger)
    expected = result.jacobian[:, : unknowns.size] @ larger
    assert moved.gap - result.gap == pytest.approx(expected, abs=2e-5)
    assert expected == pytest.approx(-(0.01 + 0.02) * 0.05, abs=1e-5)


def mesh_scene():
    """A can, which is a cylinder, next to a hull, which is a mesh."""
    hull = single("hull", (Mesh(vertices=WALL, faces=FACES), (0, 0, 0)))
    return desk.on_desk(
        (desk.can("can", 0.04, 0.12, "blue"), (-0.12, 0.03), 0.2, {}),
        (hull, (-0.07, 0.0), 0.4, {}),
    )


FACES = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))


def test_placed_colliders_are_those_of_the_rearranged_scene():
    scene = mesh_scene()
    unknowns = desk.unknowns_of(scene)
    x = np.zeros(unknowns.size)
    x[unknowns.columns(1)] = (0.01, -0.004, 0.1, 0.08)
    x[unknowns.columns(2)] = (-0.003, 0.002, -0.3, -0.1)
    colliders = SceneGeoms.of(scene)
    colliders.place(unknowns.place(x[None])[0])
    moved = unknowns.scene_at(x)
    model, data = start_state(moved)
    owner = object_of_geom(moved, model)
    assert (owner[colliders.geom] == colliders.owner).all()
    for a in colliders.geom[colliders.owner == 1].tolist():
        for b in colliders.geom[colliders.owner == 2].tolist():
            distance = geom_distance(colliders.model, colliders.data, a, b, 0.2)
            assert distance == pytest.approx(geom_distance(model, data, a, b, 0.2), abs=1e-6)
            assert distance < 0.2


def test_aligned_neighbors_do_not_overlap():
    """Contours that overlap in a wrong shape's image would push two blocks into each other."""
    scene = desk.boxed(pair(0.002))
    photo = desk.photograph(scene, 640)
    # The far block's program is 30 % too deep, which the photograph hardly shows.
    deep = desk.block("far", 0.13, 0.1, 0.08, "blue")
    wrong = scene.model_copy(
        update={"objects": (*scene.objects[:2], scene.objects[2].model_copy(update={"spec": deep}))}
    )
    depths = {}
    for with_contacts in (False, True):
        aligned = align(wrong, photo, AlignOptions(contacts=with_contacts)).scene
        model, data = start_state(aligned)
        depths[with_contacts] = object_depths(aligned, model, data).get(("near", "far"), 0.0)
    assert depths[False] > 0.004
    assert depths[True] < 0.003
    assert depths[True] < depths[False] / 2


def test_a_content_that_is_too_large_keeps_its_size():
    fixed = {"fixed_base": True}
    items = (
        (desk.block("left", 0.1, 0.03, 0.1, "red"), (-0.1, 0.065), 0.0, fixed),
        (desk.block("middle", 0.1, 0.11, 0.08, "blue"), (-0.1, 0.0), 0.0, {}),
        (desk.block("right", 0.1, 0.03, 0.1, "green"), (-0.1, -0.065), 0.0, fixed),
    )
    scene = desk.boxed(desk.on_desk(*items))
    aligned = align(scene, desk.photograph(scene, 640)).scene
    low, high = bounds(aligned.object("middle").spec)
    assert high[1] - low[1] == pytest.approx(0.11, rel=0.03)
