"""Vertical edges as evidence about the camera."""

import dataclasses
import math

import numpy as np
import pytest

from neoworld_mjx.align.align import align
from neoworld_mjx.align.camera_evidence import (
    edges_of_photo,
    has_vertical_edges,
    is_flat,
    linearized_edges,
)
from neoworld_mjx.align.rasterize import WorldMesh
from neoworld_mjx.align.unknowns import CAMERA, FOCAL, TILT
from neoworld_mjx.config import AlignOptions
from neoworld_mjx.render import visible_surface
from neoworld_mjx.spec import Box, Cylinder, Sphere
from neoworld_mjx.spec.pose import from_axis_angle, matrix
from tests.align import desk


def with_camera(scene, **changes):
    camera = scene.camera
    update = {name: getattr(camera, name) + change for name, change in changes.items()}
    return scene.model_copy(update={"camera": camera.model_copy(update=update)})


def edges_at_start(scene, photo):
    unknowns = desk.unknowns_of(scene)
    return edges_of_photo(unknowns, np.zeros(unknowns.size), photo)


@pytest.fixture(scope="module")
def edges(five, photo):
    """The estimate with the right camera."""
    return edges_at_start(five, photo)


@pytest.mark.parametrize(
    ("shape", "tilt_deg", "expected"),
    [
        (Box(size=(0.1, 0.2, 0.3)), 0.0, True),
        (Box(size=(0.02, 0.2, 0.3)), 0.0, True),
        (Cylinder(radius=0.05, height=0.1), 0.0, True),
        (Box(size=(0.02, 0.2, 0.3)), 12.0, False),
        (Cylinder(radius=0.05, height=0.1), 90.0, False),
        (Box(size=(1.0, 1.0, 0.03)), 0.0, False),
        (Sphere(radius=0.05), 0.0, False),
    ],
)
def test_upright_boxes_and_cylinders_have_vertical_edges(shape, tilt_deg, expected):
    vertices, triangles = visible_surface(desk.colored("solid", shape, "red"))
    turn = matrix(from_axis_angle((0.0, 1.0, 0.0), math.radians(tilt_deg)))
    yaw = matrix(from_axis_angle((0.0, 0.0, 1.0), 0.4))
    assert has_vertical_edges(WorldMesh(vertices @ (yaw @ turn).T, triangles)) is expected


def test_tables_are_flat_and_walls_are_not():
    table, wall = (
        WorldMesh(*visible_surface(desk.block("solid", *size, "red")))
        for size in ((1.0, 0.8, 0.05), (0.1, 3.0, 2.5))
    )
    assert is_flat(table) and not is_flat(wall)


def test_a_surface_without_area_has_no_vertical_edges():
    assert not has_vertical_edges(WorldMesh(np.zeros((8, 3)), np.zeros((0, 3), int)))


@pytest.mark.parametrize("pitch_deg", [0.0, -4.0])
def test_edges_show_the_pitch_and_the_roll(five, photo, pitch_deg):
    wrong = with_camera(five, pitch=math.radians(pitch_deg), roll=math.radians(1.5))
    found = edges_at_start(wrong, photo)
    assert abs(found.pitch - five.camera.pitch) < 1.5 * found.pitch_sd < math.radians(3.5)
    assert abs(found.roll) < 1.5 * found.roll_sd < math.radians(0.6)
    assert found.count > 4


def test_far_from_the_right_pitch_the_estimate_is_uncertain(five, photo):
    found = edges_at_start(with_camera(five, pitch=math.radians(5.0)), photo)
    assert abs(found.pitch - five.camera.pitch) < found.pitch_sd
    assert found.pitch_sd > math.radians(2.0)


def test_derivatives_are_those_of_the_residuals(five, edges):
    unknowns = desk.unknowns_of(five)
    x = np.zeros(unknowns.size)
    x[:CAMERA] = 0.03, -0.01, 0.12, 0.05
    residual, jacobian = linearized_edges(edges, unknowns, x)
    for u in range(CAMERA):
        step = 1e-6 * (np.arange(len(x)) == u)
        ends = [linearized_edges(edges, unknowns, x + sign * step)[0] for sign in (1, -1)]
        assert (ends[1] - ends[0]) / 2e-6 == pytest.approx(jacobian[:, u], abs=1e-4)
    assert np.abs(residual).max() > 0.5


def test_a_longer_focal_length_explains_a_larger_pitch(five, edges):
    """The point of the edges is f / tan(pitch) below the middle of the picture."""
    unknowns = desk.unknowns_of(five)
    x, log_focal = np.zeros(unknowns.size), 0.2
    x[FOCAL] = log_focal
    x[TILT] = math.atan(math.tan(five.camera.pitch) * math.exp(log_focal)) - five.camera.pitch
    seen = dataclasses.replace(edges, pitch=five.camera.pitch, roll=five.camera.roll)
    assert linearized_edges(seen, unknowns, x)[0] == pytest.approx(np.zeros(2), abs=1e-9)
    x[FOCAL] = 0.0
    assert abs(linearized_edges(seen, unknowns, x)[0][0]) > 2


def test_alignment_with_edges_corrects_the_roll(five, photo):
    wrong = with_camera(five, pitch=math.radians(-3.0), roll=math.radians(2.0))
    plain, result = (align(wrong, photo, AlignOptions(edges=edges)) for edges in (False, True))
    assert abs(result.scene.camera.roll) < 0.6 * abs(plain.scene.camera.roll)


@pytest.mark.parametrize("fovy_deg", [12.0, -10.0])
def test_alignment_with_edges_corrects_a_misjudged_field_of_view(five, photo, fovy_deg):
    wrong = with_camera(five, fovy=math.radians(fovy_deg))
    plain, result = (align(wrong, photo, AlignOptions(edges=edges)) for edges in (False, True))
    off = lambda alignment: abs(math.degrees(alignment.scene.camera.fovy - five.camera.fovy))
    assert off(result) < 0.25 * off(plain)


@pytest.mark.parametrize("options", [{"camera": False}, {"contours": False}])
def test_edges_are_not_used_without_camera_or_contours(five, photo, options):
    wrong = with_camera(five, roll=math.radians(2.0))
    results = [align(wrong, photo, AlignOptions(edges=edges, **options)) for edges in (True, False)]
    assert results[0].scene == results[1].scene


def test_a_photograph_without_edges_tells_nothing(five, photo):
    blank = np.full_like(photo, 128)
    assert edges_at_start(five, blank) is None
    assert align(five, blank).scene == align(five, blank, AlignOptions(edges=False)).scene


def test_a_scene_that_is_right_moves_only_as_a_whole(five, photo):
    """By an error of the edges, which is less than one standard deviation of the distance."""
    result = align(five, photo)
    assert max(desk.distances(result.scene, five, common=False).values()) < 2.0
    known = min(change.uncertainty.along for change in result.objects.values())
    assert max(desk.distances(result.scene, five).values()) < 1000 * known
