"""Vertical edges as evidence about the camera."""

import functools
import math

import numpy as np
import pytest

from neoworld_mjx.config import AlignOptions
from neoworld_mjx.estimate.align import align
from neoworld_mjx.estimate.rows.edges import (
    camera_estimates,
    edges_of_photo,
    has_vertical_edges,
    is_flat,
    linearized_edges,
)
from neoworld_mjx.estimate.unknowns import CAMERA
from neoworld_mjx.evidence.depth_image import DepthImage
from neoworld_mjx.evidence.evidence import Evidence
from neoworld_mjx.evidence.known_camera import KnownCamera
from neoworld_mjx.render import visible_surface
from neoworld_mjx.render.rasterize import WorldMesh
from neoworld_mjx.spec import Box, Cylinder, Sphere
from neoworld_mjx.spec.pose import from_axis_angle, matrix
from tests.estimate import desk


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


def test_a_board_is_flat_only_if_it_lies():
    """Edges of tables are no walls: only what does not lie can show the vertical."""
    vertices, triangles = visible_surface(desk.colored("board", Box(size=(0.6, 0.4, 0.02)), "red"))
    for order, flat in (([0, 1, 2], True), ([0, 2, 1], False), ([2, 1, 0], False)):
        assert is_flat(WorldMesh(vertices[:, order], triangles)) is flat


@pytest.mark.parametrize("pitch_deg", [0.0, -4.0])
def test_edges_show_the_pitch_and_the_roll(five, photo, pitch_deg):
    wrong = with_camera(five, pitch=math.radians(pitch_deg), roll=math.radians(1.5))
    found = edges_at_start(wrong, photo)
    assert abs(found.pitch - five.camera.pitch) < 1.5 * found.pitch_sd < math.radians(3.5)
    assert abs(found.roll) < 1.5 * found.roll_sd < math.radians(0.6)
    assert found.count > 4


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


def test_alignment_with_edges_corrects_the_roll(five, photo):
    wrong = with_camera(five, pitch=math.radians(-3.0), roll=math.radians(2.0))
    plain, result = (align(wrong, photo, AlignOptions(edges=edges)) for edges in (False, True))
    assert abs(result.scene.camera.roll) < 0.6 * abs(plain.scene.camera.roll)


@pytest.fixture(scope="module")
def aligned(five, photo):
    """A function of the degrees that the field of view is off by: the scene and its result."""

    @functools.cache
    def result(fovy_deg):
        wrong = with_camera(five, fovy=math.radians(fovy_deg))
        return wrong, align(wrong, photo)

    return result


@pytest.mark.parametrize("fovy_deg", [12.0, pytest.param(-10.0, marks=pytest.mark.slow)])
def test_alignment_with_edges_corrects_a_misjudged_field_of_view(five, photo, aligned, fovy_deg):
    wrong, result = aligned(fovy_deg)
    plain = align(wrong, photo, AlignOptions(edges=False))
    off = lambda alignment: abs(math.degrees(alignment.scene.camera.fovy - five.camera.fovy))
    assert off(result) < 0.25 * off(plain)


def test_edges_that_contradict_a_measured_camera_are_not_used(five, photo, aligned):
    """The same edges correct a camera that a response only estimated."""
    wrong, result = aligned(12.0)
    measured = align(wrong, photo, measured=("pitch", "roll", "fovy"))
    assert measured.misleading_edges
    assert ("edges that look vertical are not used", "the camera contradicts them") in [
        *measured.notes()
    ]
    assert not result.misleading_edges
    assert not align(five, photo, measured=("pitch", "roll", "fovy")).misleading_edges


def test_a_photograph_without_edges_tells_nothing(five, photo):
    blank = np.full_like(photo, 128)
    assert edges_at_start(five, blank) is None
    assert align(five, blank).scene == align(five, blank, AlignOptions(edges=False)).scene


def test_sources_of_the_camera_are_named():
    focal = desk.CAMERA.focal
    exif = KnownCamera(
        (640, 480), focal=focal, focal_sd=0.03, pitch=0.5, source="a.json", focal_source="EXIF"
    )
    depth = DepthImage(np.ones((48, 64)))
    deviations = np.array([0.01, 0.02, 0.03, 0.04])

    def sources(evidence, **more):
        options = {"measured": ("pitch", "height"), "edges": True} | more
        estimates = camera_estimates(desk.CAMERA, deviations, evidence, **options)
        assert estimates["fovy"].deviation == pytest.approx(0.03 * math.sin(desk.CAMERA.fovy))
        assert estimates["height"].deviation == pytest.approx(0.04 * desk.CAMERA.height)
        assert estimates["pitch"].value == desk.CAMERA.pitch
        return [estimate.source for estimate in estimates.values()]

    assert sources(Evidence()) == [
        "estimated: measured in the response, vertical edges",
        "estimated: vertical edges",
        "estimated",
        "estimated: measured in the response",
    ]
    assert sources(Evidence(camera=exif, depth=depth), measured=(), edges=False) == [
        "a.json",
        "estimated: depth",
        "EXIF",
        "estimated: depth",
    ]
    bare = KnownCamera((640, 480), roll=0.0, height=0.5)
    assert sources(Evidence(camera=bare), measured=(), edges=False)[1::2] == ["given", "given"]


def test_alignment_states_the_camera(five, photo):
    known = KnownCamera(
        (640, 480), focal=five.camera.focal, pitch=five.camera.pitch, source="camera.json"
    )
    camera = align(desk.boxed(five), photo, evidence=Evidence(camera=known)).camera
    assert [camera[name].source for name in ("pitch", "fovy")] == ["camera.json"] * 2
    assert camera["fovy"].deviation < 1e-3 < camera["height"].deviation
    assert camera["height"].source == "estimated"
