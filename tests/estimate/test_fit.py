import math

import numpy as np
import pytest

from neoworld_mjx.estimate.tree.fit_tree import fit_tree
from neoworld_mjx.estimate.tree.projection import (
    ROUND_POINTS,
    extents_in_picture,
    hull_wireframe,
    to_world,
    visible_box,
)
from neoworld_mjx.estimate.tree.tree_checks import agreement
from neoworld_mjx.spec import Box2D, Box3D, Cues, SceneTree
from tests.support import answers


def disturbed(tree, seed, *, place=0.04, size=0.06, yaw=8.0, pitch=3.0, height=0.05):
    """The tree with errors as models make them; 2D boxes stay exact."""
    rng = np.random.default_rng(seed)
    camera = tree.camera
    camera = camera.model_copy(
        update={
            "pitch": camera.pitch + math.radians(pitch * rng.choice([-1, 1])),
            "height": camera.height * math.exp(height * rng.normal()),
        }
    )
    wrong = SceneTree(camera=camera, nodes=tree.nodes)
    for node in tree.nodes:
        if not node.environment:
            wrong = answers.moved(
                wrong,
                node.name,
                (*rng.normal(0, place, 2), 0.0),
                np.exp(size * rng.normal(size=3)),
                yaw * rng.normal(),
            )
    return wrong


def mean_agreement(tree):
    things = [node for node in tree.nodes if not node.environment]
    return float(np.mean([agreement(tree, node) for node in things]))


def position_error(tree, truth):
    """Mean distance of the objects from their places in the truth, their common shift aside."""
    offsets = np.array(
        [
            np.subtract(tree.node(node.name).box3d.position, node.box3d.position)
            for node in truth.nodes
            if not node.environment
        ]
    )
    return np.linalg.norm(offsets - np.median(offsets, axis=0), axis=1).mean()


def test_a_consistent_parse_does_not_change():
    tree = answers.exact()
    fitted, report = fit_tree(tree)
    assert fitted is tree
    assert not report.applied
    assert "0 of 3 objects moved" in report.reason
    assert report.agreement_before == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_typical_errors_of_models_shrink(seed):
    truth = answers.exact()
    wrong = disturbed(truth, seed)
    fitted, report = fit_tree(wrong)
    assert report.applied
    assert report.agreement_after == pytest.approx(mean_agreement(fitted))
    # What is left is within the noise of a 2D box.
    assert mean_agreement(fitted) > max(0.85, mean_agreement(wrong) + 0.1)
    assert position_error(fitted, truth) < position_error(wrong, truth)
    # Boxes in the picture, names and the hierarchy are what was seen: they do not move.
    assert [n.box2d for n in fitted.nodes] == [n.box2d for n in wrong.nodes]
    assert fitted.node("table") == wrong.node("table")
    # Boxes cannot tell these.
    assert (fitted.camera.fovy, fitted.camera.roll) == (wrong.camera.fovy, wrong.camera.roll)


def test_the_report_gives_every_change():
    truth = answers.exact()
    wrong = answers.moved(truth, "right", position=(0.05, 0.03, 0))
    fitted, report = fit_tree(wrong)
    moved = report.objects["right"]
    a, b = (np.array(t.node("right").box3d.position) for t in (wrong, fitted))
    assert moved.distance_m == pytest.approx(np.linalg.norm(a - b))
    assert moved.distance_m == pytest.approx(np.hypot(0.05, 0.03), abs=0.02)
    assert moved.agreement_before < 0.7 < moved.agreement_after
    assert (moved.before, moved.after) == (wrong.node("right").box3d, fitted.node("right").box3d)
    assert report.pitch_deg == pytest.approx(math.degrees(fitted.camera.pitch - wrong.camera.pitch))
    data = report.to_json()
    assert data["applied"] is True
    assert set(data["objects"]) == {"left", "right", "can"}
    # The picture does not contradict the others: they stay to the bit.
    for name in ("left", "can"):
        assert fitted.node(name) == wrong.node(name)
    assert fitted.camera == wrong.camera
    assert list(report.notes()) == []


def test_contacts_hold_and_floating_objects_come_down():
    wrong = answers.moved(answers.exact(), "right", position=(0, 0, 0.06))
    fitted, report = fit_tree(wrong)
    assert report.applied
    assert abs(fitted.node("right").box3d.position[2]) < 0.01
    left, can = fitted.node("left").box3d, fitted.node("can").box3d
    assert can.position[2] == pytest.approx(left.position[2] + left.size[2], abs=0.006)


def behind(truth):
    """The tree with the right box hidden below by the left one."""
    x0, y0, x1, y1 = truth.node("right").box2d.as_tuple()
    split = y0 + 0.6 * (y1 - y0)
    seen = answers.with_node(
        truth,
        "right",
        box2d=Box2D(x0=x0, y0=y0, x1=x1, y1=split),
        occluded=True,
        occluded_by=("left",),
    )
    return answers.with_node(
        seen, "left", box2d=Box2D(x0=x0 - 5, y0=split - 2, x1=x1 + 5, y1=y1 + 40)
    )


def test_hidden_sides_that_agree_move_nothing():
    seen = behind(answers.exact())
    fitted, report = fit_tree(seen)
    assert report.objects["right"].hidden == (False, False, False, True)
    assert fitted.node("right") == seen.node("right")


def test_a_displaced_hidden_object_moves_by_its_visible_sides():
    wrong = answers.moved(behind(answers.exact()), "right", position=(0.04, 0.02, 0))
    fitted, _ = fit_tree(wrong)
    was, now = wrong.node("right").box3d.size, fitted.node("right").box3d.size
    assert np.allclose(was, now, rtol=0.06)
    assert agreement(fitted, fitted.node("right")) > 0.9


@pytest.mark.parametrize("side", range(4))
def test_an_object_cut_by_the_border_keeps_its_parsed_position(side):
    """Also where the cut takes away the points that would make the other sides."""
    tree = answers.exact()
    box, camera = tree.node("right").box3d, tree.camera
    aim = np.array(box.position) - camera.position()
    pitch = math.atan2(-aim[2], float(np.hypot(*aim[:2])))
    tall = camera.fovy / 2
    wide = math.atan(math.tan(tall) * camera.width / camera.height_px)
    # The border goes through the box's middle: the camera looks past it by half the view.
    ahead = math.hypot(box.position[0], camera.height)
    aside = {0: math.tan(wide) * ahead, 2: -math.tan(wide) * ahead}.get(side, 0.0)
    pitch += {1: tall, 3: -tall}.get(side, 0.0)
    turned = camera.model_copy(update={"pitch": pitch, "roll": 0.2})
    placed = box.model_copy(update={"position": (box.position[0], aside, 0.0)})
    node = tree.node("right").model_copy(update={"box3d": placed, "occluded": True})
    corners = visible_box(turned, placed.corners())
    assert corners is not None
    box2d = Box2D(**dict(zip(("x0", "y0", "x1", "y1"), corners, strict=True)))
    node = node.model_copy(update={"box2d": box2d})
    cut = SceneTree(camera=turned, nodes=(tree.node("table"), node))
    fitted, report = fit_tree(cut)
    assert report.objects["right"].hidden[side]
    assert fitted.node("right") == node


def test_one_inconsistent_object_does_not_affect_the_others():
    """Also boxes that no camera could have seen so."""
    truth = answers.exact()
    wrong = answers.moved(truth, "right", position=(0.04, 0.02, 0))
    wrong = answers.with_node(wrong, "can", box2d=Box2D(x0=5, y0=5, x1=25, y1=400))
    fitted, report = fit_tree(wrong)
    assert report.objects["right"].agreement_after > 0.85
    assert not report.objects["right"].refused
    assert fitted.camera == wrong.camera
    assert fitted.node("left") == wrong.node("left")


def test_cues_fix_their_numbers():
    """A contact pixel gives the distance of a thing of which little else is seen."""
    truth = answers.exact()
    node = truth.node("right")
    corners = node.box3d.corners()[::2]  # Those of its bottom.
    pixels, _ = truth.camera.project(corners)
    contact = tuple(pixels[pixels[:, 1].argmax()].tolist())
    wrong = answers.moved(truth, "right", position=(0.04, 0.0, 0))
    hidden = ("left", "top", "right", "bottom")
    blind = answers.with_node(wrong, "right", cues=Cues(cut_sides=hidden))
    told = answers.with_node(wrong, "right", cues=Cues(cut_sides=hidden, contact=contact))

    def off(tree):
        fitted, _ = fit_tree(tree)
        return np.linalg.norm(
            np.subtract(fitted.node("right").box3d.position, node.box3d.position)[:2]
        )

    assert off(told) < 0.015 < 0.5 * off(wrong) + 0.02
    assert off(told) < off(blind)
    sure = answers.with_node(wrong, "right", cues=Cues(known_size=("x", "y", "z")))
    fitted, _ = fit_tree(sure)
    assert np.allclose(fitted.node("right").box3d.size, node.box3d.size, rtol=0.01)


def extents(camera, points, edges):
    owners = np.zeros(len(edges), int)
    return extents_in_picture(camera, points[None], edges, owners)[0]


def test_extents_in_picture_match_dense_points():
    """Against dense points of the same surface, also where it goes past the camera."""
    camera = answers.exact().camera
    rng = np.random.default_rng(3)
    corners = np.array(np.meshgrid(*([-0.5, 0.5],) * 3)).reshape(3, -1).T
    share = rng.uniform(size=(60_000, 3))
    share[np.arange(len(share)), rng.integers(3, size=len(share))] = rng.integers(
        2, size=len(share)
    )
    size = np.array([camera.width, camera.height_px])
    for middle, scale in (
        ((0.5, 0.0, 1.0), (1.0, 0.2, 0.4)),  # The right border.
        ((-0.4, -0.5, 0.9), (0.8, 0.9, 0.2)),  # The upper left corner.
        ((0.0, 0.0, 1.5), (9.0, 0.3, 0.2)),  # Both sides.
        ((0.1, 0.2, 0.4), (0.2, 0.2, 1.0)),  # Past the camera.
    ):
        frame = hull_wireframe(corners)
        box = extents(camera, frame.points * scale + middle, frame.edges)
        view = (share - 0.5) * scale + middle
        view = view[view[:, 2] > 0.02]
        pixels = view[:, :2] / view[:, 2:] * camera.focal + size / 2
        inside = pixels[((pixels >= 0) & (pixels <= size)).all(axis=1)]
        expected = [*inside.min(axis=0), *inside.max(axis=0)]
        assert box == pytest.approx(expected, abs=0.02 * size.max())
    out = frame.points * 0.1 + [5.0, 0.0, 1.0]
    assert np.isnan(extents(camera, out, frame.edges)).all()


def test_objects_on_a_wall_neither_leave_it_nor_turn():
    tree = answers.exact()
    wall = tree.node("table").model_copy(
        update={
            "name": "wall",
            "box3d": Box3D(position=(1.4, 0.0, 0.0), size=(0.1, 2.0, 1.5), yaw=0.3),
        }
    )
    hung = tree.node("right").model_copy(
        update={
            "name": "picture",
            "parent": "wall",
            "relation": "attached",
            "box3d": Box3D(position=(1.3, 0.0, 0.02), size=(0.02, 0.3, 0.12), yaw=0.3),
        }
    )
    tree = SceneTree(camera=tree.camera, nodes=(*tree.nodes, wall, hung))
    corners = visible_box(tree.camera, hung.box3d.corners())
    assert corners is not None
    x0, y0, x1, y1 = corners + np.array([30.0, 10.0, 50.0, 5.0])  # Aside, and wider.
    wrong = answers.with_node(tree, "picture", box2d=Box2D(x0=x0, y0=y0, x1=x1, y1=y1))
    box = fit_tree(wrong)[0].node("picture").box3d
    normal = np.array([math.cos(0.3), math.sin(0.3), 0.0])
    off = np.subtract(box.position, hung.box3d.position)
    assert np.linalg.norm(off) > 0.005
    assert abs(off @ normal) < 2e-5 and box.yaw == hung.box3d.yaw


@pytest.mark.parametrize("relation", ["in", "on"])
def test_contents_are_fitted_into_their_container(relation):
    tree = answers.exact()
    outer = tree.node("right").box3d
    place = np.array(outer.position)
    inner = tree.node("right").model_copy(
        update={
            "name": "inner",
            "parent": "right",
            "relation": relation,
            "box3d": Box3D(
                position=tuple(place + [0, 0, 0.5 * outer.size[2]]),
                size=tuple(0.9 * np.array(outer.size)),
                yaw=outer.yaw,
            ),
        }
    )
    corners = visible_box(tree.camera, inner.box3d.corners())
    assert corners is not None
    box2d = Box2D(**dict(zip(("x0", "y0", "x1", "y1"), corners.tolist(), strict=True)))
    # Six centimetres towards the camera, along the line of sight: the picture hardly tells.
    eye = tree.camera.position()
    centre = inner.box3d.corners().mean(axis=0)
    nearer = centre + 0.06 * (eye - centre) / np.linalg.norm(eye - centre)
    ratio = float(np.linalg.norm(nearer - eye) / np.linalg.norm(centre - eye))
    size = ratio * np.array(inner.box3d.size)
    wrong = inner.model_copy(
        update={
            "box2d": box2d,
            "box3d": Box3D(
                position=(*nearer[:2], float(nearer[2] - size[2] / 2)),
                size=tuple(size),
                yaw=outer.yaw,
            ),
        }
    )
    fitted, _ = fit_tree(SceneTree(camera=tree.camera, nodes=(*tree.nodes, wrong)))
    found, carrier = (np.array(fitted.node(n).box3d.position) for n in ("inner", "right"))
    off = float(np.linalg.norm((found - carrier)[:2]))
    assert off < 0.02 if relation == "in" else off > 0.03


@pytest.mark.parametrize("yaw_deg", [0, 45])
def test_a_pot_that_is_smaller_than_its_box_does_not_shrink(yaw_deg):
    """Two handles make the box of a pot long; at 45 degrees nothing of the pot is in its corners.

    The 2D box is that of a round body with two points at the ends, which are the handles.
    """
    pot = answers.item(
        "pot", (0.8, 0, 0), (0.12, 0.074, 0.04), label="cooking pot", yaw_deg=yaw_deg
    )
    tree = answers.exact(answers.answer(pot))
    node = tree.node("pot")
    body = ROUND_POINTS * [0.074 / 0.12, 1, 1]
    points = np.concatenate([body, [(-0.5, 0, 0.8), (0.5, 0, 0.8)]])
    pixels, _ = tree.camera.project(to_world(points, node.box3d))
    (x0, y0), (x1, y1) = pixels.min(axis=0), pixels.max(axis=0)
    seen = answers.with_node(tree, "pot", box2d=Box2D(x0=x0, y0=y0, x1=x1, y1=y1))
    fitted, report = fit_tree(seen)
    assert fitted.node("pot").box3d.size == pytest.approx(node.box3d.size, rel=0.01)
    assert report.objects["pot"].agreement_before > 0.95
