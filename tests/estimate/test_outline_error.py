"""Distances of outlines from the photograph's: known errors give the distances that they are."""

import numpy as np
import pytest
import trimesh
from neoworld_bench.rescues.rescue_rows import (
    CAMERA,
    TABLE_Z,
    photograph_of,
    scene_of_meshes,
    upright,
)

from neoworld_mjx.spec import SceneSpec, scale
from neoworld_mjx.view.evidence_pictures import outline_errors

RADIUS = 0.06


def scene_of(*, size: float = 1.0, y: float = 0.0) -> SceneSpec:
    """Return a ball above a table; its size and place may be wrong."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS)
    table = trimesh.creation.box(extents=(0.8, 1.0, 0.04))
    scene = scene_of_meshes(
        {
            "table": (table, upright(np.array([0.9, 0, TABLE_Z - 0.02]), 0)),
            "ball": (ball, upright(np.array([0.8, y, TABLE_Z + 0.1]), 0)),
        }
    ).spec
    table_item, item = scene.objects
    grown = item.model_copy(update={"spec": scale(item.spec, size)})
    fixed = table_item.model_copy(update={"environment": True})
    return scene.model_copy(update={"objects": (fixed, grown), "camera": CAMERA})


@pytest.fixture(scope="module")
def photo():
    return photograph_of(scene_of())


def radius_px() -> float:
    """Return the radius of the ball in an image 640 px wide."""
    distance = np.linalg.norm(np.array([0.8, 0.0, TABLE_Z + 0.1]) - CAMERA.position())
    return CAMERA.focal * RADIUS / np.sqrt(distance**2 - RADIUS**2)


def test_right_outline_is_near(photo):
    assert set(outline_errors(scene_of(), photo)) == {"ball"}
    assert outline_errors(scene_of(), photo)["ball"] < 0.7


@pytest.mark.parametrize("size", [0.9, 1.05, 1.15])
def test_wrong_size_is_its_distance(photo, size):
    """Everywhere the outline is off by as much as the radius is wrong."""
    expected = abs(size - 1) * radius_px()
    assert outline_errors(scene_of(size=size), photo)["ball"] == pytest.approx(expected, abs=1.0)


def test_object_of_its_backgrounds_color_is_unknown():
    scene = scene_of()
    flat = np.full((CAMERA.height_px, CAMERA.width, 3), 128, np.uint8)
    assert outline_errors(scene, flat) == {"ball": None}


def test_invisible_object_is_unknown(photo):
    assert outline_errors(scene_of(y=3.0), photo) == {"ball": None}
