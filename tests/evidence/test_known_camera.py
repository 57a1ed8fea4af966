"""Known cameras in scene trees: objects keep their pixels, distances follow what is known."""

import math

import numpy as np
import pytest
from PIL import Image

from neoworld_mjx.evidence.exif import exif_camera
from neoworld_mjx.evidence.known_camera import (
    EXACT_ANGLE,
    EXACT_FOCAL,
    EXACT_HEIGHT,
    KnownCamera,
    with_known_camera,
)
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


def test_the_environment_moves_with_the_middle_of_the_objects():
    known = KnownCamera(size=(640, 480), focal=GUESS.focal, pitch=GUESS.pitch, roll=0.0, height=1.0)
    after = with_known_camera(tree(), known)
    # The median of the shifts is that from the camera to the middle, (1.0, 0.05).
    table = after.node("table").box3d
    assert table.position == pytest.approx((2.0, 0.05, -0.04))
    assert table.size == (1.0, 1.0, 0.04)
    assert after.camera == GUESS.model_copy(update={"height": 1.0})
    assert with_known_camera(tree(), KnownCamera(size=(640, 480))) == tree()


@pytest.mark.parametrize("change", [{"focal": 1100.0}, {"pitch": 0.7}, {"roll": 0.2}])
def test_an_object_keeps_its_distance_if_the_height_is_unknown(change):
    """In proportion to the focal length, so that it keeps its size, too."""
    table, cup, *_ = tree().nodes
    raised = cup.box3d.model_copy(update={"position": (0.9, 0.1, 0.15)})
    cup = cup.model_copy(update={"box3d": raised})
    single = tree().model_copy(update={"nodes": (table, cup)})
    after = with_known_camera(single, KnownCamera(size=(640, 480), **change))
    box = after.node("cup").box3d
    distance = np.linalg.norm(np.subtract(cup.box3d.position, GUESS.position()))
    zoom = after.camera.focal / GUESS.focal
    moved = np.linalg.norm(np.subtract(box.position, after.camera.position()))
    assert moved == pytest.approx(zoom * distance)
    assert box.size == pytest.approx(cup.box3d.size)
    assert pixels(after)["cup"] == pytest.approx(pixels(single)["cup"])


def test_objects_behind_the_camera_or_far_beyond_their_distance_stay():
    table, cup, can, book = tree().nodes
    behind = can.model_copy(
        update={"box3d": can.box3d.model_copy(update={"position": (-1.0, 0.0, 0.0)})}
    )
    far = book.model_copy(
        update={"box3d": book.box3d.model_copy(update={"position": (8.0, 0.0, 0.0)})}
    )
    scene = tree().model_copy(update={"nodes": (table, cup, behind, far)})
    # Seen by the new camera, the far object would be above the horizon.
    after = with_known_camera(scene, KnownCamera(size=(640, 480), pitch=0.4, height=0.5))
    assert after.node("can") == behind and after.node("book") == far
    assert after.node("cup") != cup
    stays = set()
    for pitch in (0.2, 0.36, 0.44):
        after = with_known_camera(tree(), KnownCamera(size=(640, 480), pitch=pitch, height=0.5))
        ray = after.camera.rays(pixels(tree())["book"])
        distance = -0.5 / ray[2]
        old = np.linalg.norm(np.subtract(book.box3d.position, GUESS.position()))
        stays.add(after.node("book") == book)
        assert (after.node("book") != book) is bool(0 < distance < 3 * old)
    assert stays == {False, True}


def test_what_is_known_has_its_deviation_and_source():
    known = KnownCamera(size=(640, 480), focal=800.0, pitch=0.5)
    assert known.deviations() == {"pitch": EXACT_ANGLE, "focal": EXACT_FOCAL}
    assert (EXACT_FOCAL, EXACT_HEIGHT) == (1e-4, 1e-4)
    assert math.degrees(EXACT_ANGLE) == pytest.approx(0.02)
    other = KnownCamera(size=(640, 480), roll=0.1, angle_sd=0.02, height=1.0, height_sd=0.1)
    assert other.deviations() == {"roll": 0.02, "height": 0.1}
    assert known.source_of("focal") == known.source_of("pitch") == "given"
    file = KnownCamera(size=(640, 480), source="a.json", focal_source="EXIF")
    assert (file.source_of("focal"), file.source_of("pitch")) == ("EXIF", "a.json")


def test_pixels_of_a_known_camera_refer_to_its_own_image():
    known = KnownCamera(size=(1280, 960), focal=1600.0, principal=(40.0, -20.0))
    camera = known.camera(GUESS)
    assert camera.focal == pytest.approx(800.0)
    assert camera.center == pytest.approx((340.0, 230.0))


def test_base_frame_of_a_camera():
    known = KnownCamera(size=(640, 480), base=(0.4, -0.2, 1.1), heading=math.pi / 2)
    frame = known.base_frame(GUESS)
    assert frame is not None
    assert frame.apply([0.0, 0.0, GUESS.height]) == pytest.approx([0.4, -0.2, 1.1])
    assert frame.apply([1.0, 0.0, 0.0])[:2] == pytest.approx([0.4, 0.8])
    assert KnownCamera(size=(640, 480)).base_frame(GUESS) is None


def test_the_focal_length_of_a_photograph_is_for_a_film_of_its_diagonal(tmp_path):
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA405] = 43  # FocalLengthIn35mmFilm
    Image.new("RGB", (300, 400)).save(tmp_path / "photo.jpg", exif=exif)
    assert exif_camera(tmp_path / "photo.jpg", (300, 400)).focal == pytest.approx(500, rel=0.01)
