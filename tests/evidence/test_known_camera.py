"""Known cameras in scene trees: objects keep their pixels, distances follow what is known."""

import math

import numpy as np
import pytest

from neoworld_mjx.evidence.known_camera import KnownCamera, with_known_camera
from neoworld_mjx.spec import Box2D, Box3D, Camera, SceneTree, TreeNode

GUESS = Camera(width=640, height_px=480, fovy=0.6, height=0.5, pitch=0.5)


def tree():
    box = Box2D(x0=10, y0=10, x1=50, y1=50)
    table = TreeNode(
        name="table",
        label="table",
        environment=True,
        box2d=box,
        box3d=Box3D(position=(1.0, 0.0, -0.04), size=(1.0, 1.0, 0.04)),
    )
    places = {"cup": (0.9, 0.1, 0.0), "can": (1.0, -0.1, 0.0), "book": (1.1, 0.05, 0.0)}
    nodes = [
        TreeNode(
            name=name,
            label=name,
            parent="table",
            box2d=box,
            box3d=Box3D(position=place, size=(0.1, 0.1, 0.1)),
        )
        for name, place in places.items()
    ]
    return SceneTree(camera=GUESS, nodes=(table, *nodes))


def pixels(scene):
    return {
        node.name: scene.camera.project(node.box3d.position)[0]
        for node in scene.nodes
        if not node.environment
    }


@pytest.mark.parametrize(
    "change",
    [
        {"focal": 1100.0},
        {"pitch": 0.62, "roll": 0.04},
        {"height": 0.6, "pitch": 0.55},
        {"focal": 700.0, "pitch": 0.4, "roll": -0.05, "height": 0.45},
    ],
)
def test_objects_keep_their_pixels(change):
    known = KnownCamera(size=(640, 480), **change)
    after = with_known_camera(tree(), known)
    for name, value in change.items():
        held = after.camera.focal if name == "focal" else getattr(after.camera, name)
        assert held == pytest.approx(value)
    before, now = pixels(tree()), pixels(after)
    # The view of a plane from another distance is another one, so the outer pixels change a little.
    tolerance = 1e-6 if "height" in change else 25.0
    for name, pixel in before.items():
        assert np.linalg.norm(now[name] - pixel) < tolerance


def test_known_height_scales_the_scene():
    """Twice as high with the same view: everything is twice as far and as large."""
    known = KnownCamera(size=(640, 480), focal=GUESS.focal, pitch=GUESS.pitch, roll=0.0, height=1.0)
    after = with_known_camera(tree(), known)
    for old, new in zip(tree().nodes[1:], after.nodes[1:], strict=True):
        assert new.box3d.position[:2] == pytest.approx(np.multiply(2, old.box3d.position[:2]))
        assert new.box3d.size == pytest.approx((0.2, 0.2, 0.2))


def test_base_frame_of_a_camera():
    known = KnownCamera(size=(640, 480), base=(0.4, -0.2, 1.1), heading=math.pi / 2)
    frame = known.base_frame(GUESS)
    assert frame.apply([0.0, 0.0, GUESS.height]) == pytest.approx([0.4, -0.2, 1.1])
    assert frame.apply([1.0, 0.0, 0.0])[:2] == pytest.approx([0.4, 0.8])
    assert KnownCamera(size=(640, 480)).base_frame(GUESS) is None
