"""Measures of depth, poses, volumes and colliders: analytic cases, and second implementations."""

import numpy as np
import pytest
import trimesh
from neoworld_bench.dataset.truth_scene import built
from neoworld_bench.measures.collider_measure import collider_gap
from neoworld_bench.measures.depth_measure import (
    Intrinsics,
    Similarity,
    depth_measure,
    least_squares_similarity,
    measured_points,
    robust_similarity,
)
from neoworld_bench.measures.pose_measure import (
    add,
    add_s,
    adi,
    axis_box_iou,
    icp_rotation_deg,
    layout_measure,
    recall,
)
from neoworld_bench.measures.volume_measure import normalized, volume_measure, voxel_iou
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from neoworld_mjx.measure import iou_3d
from neoworld_mjx.spec import Box, Box3D, Mesh
from neoworld_mjx.templates import template, templates
from tests.support.scenes import single

RNG = np.random.default_rng(3)
CLOUD = RNG.normal(size=(4000, 3)) * [0.3, 0.2, 0.1] + [0, 0, 1.5]


def transform(angle_deg=0.0, shift=(0.0, 0.0, 0.0), axis=(0.2, 0.5, 0.8)):
    result = np.eye(4)
    turn = np.radians(angle_deg) * np.asarray(axis) / np.linalg.norm(axis)
    result[:3, :3], result[:3, 3] = Rotation.from_rotvec(turn).as_matrix(), shift
    return result


def moved(points, matrix):
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def bracket(scale=1.0):
    """An L without any symmetry, of two boxes in one mesh."""
    foot = trimesh.creation.box(extents=(0.2, 0.12, 0.03))
    wall = trimesh.creation.box(extents=(0.03, 0.07, 0.15))
    wall.apply_translation((-0.085, -0.025, 0.09))
    mesh = trimesh.boolean.union([foot, wall], engine="manifold")
    mesh.apply_scale(scale)
    return mesh


def samples(mesh, count=6000, seed=0):
    return trimesh.sample.sample_surface(mesh, count, seed=seed)[0]


def test_similarity_is_recovered_exactly():
    true = Similarity(1.3, transform(25)[:3, :3], np.array([0.1, -0.2, 0.05]))
    found = least_squares_similarity(CLOUD, true.apply(CLOUD))
    assert found.scale == pytest.approx(1.3, abs=1e-12)
    assert np.allclose(found.rotation, true.rotation) and np.allclose(
        found.translation, true.translation
    )
    assert found.angle_deg == pytest.approx(25)


def test_similarity_has_least_squares():
    """A numeric minimizer finds no better one."""
    from scipy.optimize import minimize

    target = 0.8 * CLOUD + RNG.normal(size=CLOUD.shape) * 0.05
    weights = RNG.random(len(CLOUD))
    found = least_squares_similarity(CLOUD, target, weights)

    def loss(x):
        other = Similarity(np.exp(x[0]), Rotation.from_rotvec(x[1:4]).as_matrix(), x[4:7])
        return weights @ np.sum((other.apply(CLOUD) - target) ** 2, axis=1)

    turn = Rotation.from_matrix(found.rotation).as_rotvec()
    start = np.array([np.log(found.scale), *turn, *found.translation])
    assert minimize(loss, start + 0.01, tol=1e-12).fun == pytest.approx(loss(start), rel=1e-9)


def test_similarity_ignores_a_third_of_outliers():
    true = Similarity(0.95, transform(5)[:3, :3], np.array([0.02, 0.05, -0.1]))
    target = true.apply(CLOUD)
    target[::3] += [0.0, 0.0, 0.6]
    found = robust_similarity(CLOUD, target, 0.02)
    assert found.scale == pytest.approx(0.95, abs=2e-3)
    assert np.linalg.norm(found.apply(CLOUD) - true.apply(CLOUD), axis=1).max() < 4e-3


def flat_view(depths, owners, camera):
    owner = np.repeat(np.array(owners), 20)[None].repeat(60, axis=0)
    depth = np.repeat(np.array(depths, float), 20)[None].repeat(60, axis=0)
    # Slanted, so that the points lie in no plane.
    depth = depth + 0.002 * np.arange(60)[:, None] + 0.05 * np.sin(np.arange(owner.shape[1]) / 9)
    return measured_points(depth, camera), owner


def test_depth_error_of_an_object_is_its_own():
    camera = Intrinsics(200.0, 210.0, 39.0, 31.0)
    own, owner = flat_view([1.0, 1.1, 1.2, 1.05], [0, 1, 0, 2], camera)
    result = depth_measure(own, owner, ("table", "mug", "book"), own)
    assert result.inliers == 1 and result.similarity.scale == pytest.approx(1)
    assert all(abs(value) < 1e-6 for e in result.objects.values() for value in e[:3])
    far = own.copy()
    far[owner == 1] *= 1 + 0.03 / far[owner == 1][:, 2:]
    result = depth_measure(far, owner, ("table", "mug", "book"), own)
    mug, table = result.objects["mug"], result.objects["table"]
    assert mug.bias_mm == pytest.approx(30, abs=1.5)
    assert mug.depth_error_mm == pytest.approx(30, abs=1.5) and mug.error_mm >= mug.depth_error_mm
    assert table.error_mm < 1 and result.objects["book"].error_mm < 1.5
    assert mug.visible_px == mug.measured_px == 1200
    # The scene's own scale and camera do not count.
    view = Similarity(1.4, transform(8)[:3, :3], np.array([0.1, 0, 0.2]))
    turned = view.apply(own.reshape(-1, 3)).reshape(own.shape)
    result = depth_measure(turned, owner, ("table", "mug", "book"), own)
    assert result.similarity.scale == pytest.approx(1 / 1.4, rel=1e-6)
    assert result.similarity.angle_deg == pytest.approx(8, abs=1e-4)
    assert max(e.error_mm for e in result.objects.values()) < 1e-3


def test_depth_measure_needs_pixels_and_skips_what_the_sensor_does_not_see():
    camera = Intrinsics(200.0, 210.0, 39.0, 31.0)
    own, owner = flat_view([1.0, 1.1, 1.2, 1.05], [0, 1, 0, 2], camera)
    sensor = own.copy()
    sensor[owner == 1] = 0
    mug = depth_measure(own, owner, ("table", "mug", "book"), sensor).objects["mug"]
    assert (mug.visible_px, mug.measured_px) == (1200, 0) and np.isnan(mug.error_mm)
    with pytest.raises(ValueError, match="0 pixels"):
        depth_measure(own, owner, ("table", "mug", "book"), np.zeros_like(own))


def test_add_and_adi_against_their_definitions():
    model = samples(bracket(), 500)
    estimate, truth = transform(20, (0.01, 0, 0)), transform(0)
    a, b = moved(model, estimate), moved(model, truth)
    assert add(model, estimate, truth) == pytest.approx(np.linalg.norm(a - b, axis=1).mean())
    # bop_toolkit's adi: from the points of the truth to the nearest of the estimate.
    assert adi(model, estimate, truth) == pytest.approx(cdist(b, a).min(axis=1).mean())
    both = (cdist(a, b).min(axis=1).mean() + cdist(b, a).min(axis=1).mean()) / 2
    assert add_s(a, b) == pytest.approx(both)
    assert add(model, truth, truth) == adi(model, truth, truth) == 0
    pushed = transform(0, (0.03, 0, 0))
    assert add(model, pushed, truth) == pytest.approx(0.03)


def test_a_symmetric_object_has_adi_alone():
    square = np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0.0]])
    quarter = transform(90, axis=(0, 0, 1))
    assert adi(square, quarter, np.eye(4)) == pytest.approx(0, abs=1e-12)
    assert add(square, quarter, np.eye(4)) == pytest.approx(2)


@pytest.mark.parametrize("angle", [0, 3, 12, 25])
def test_icp_rotation_is_the_angle(angle):
    own = samples(bracket(), 3000)
    turned = moved(own, transform(angle, (0.004, -0.003, 0.002)))
    assert icp_rotation_deg(turned, own) == pytest.approx(angle, abs=0.02)


def test_icp_rotation_agrees_with_trimesh():
    own = samples(bracket(), 1500)
    other = moved(samples(bracket(), 1500, seed=4), transform(10, (0.003, 0, 0)))
    result = trimesh.registration.icp(
        other, own, threshold=1e-12, max_iterations=200, scale=False, reflection=False
    )[0]
    expected = np.degrees(Rotation.from_matrix(result[:3, :3]).magnitude())
    assert icp_rotation_deg(other, own) == pytest.approx(expected, abs=0.05)
    assert expected == pytest.approx(10, abs=0.5)


def test_box_iou_against_the_upright_one():
    corners = np.array(trimesh.creation.box(extents=(2, 1, 1)).vertices)
    assert axis_box_iou(corners, corners) == 1 and axis_box_iou(corners, corners + 5) == 0
    pushed = axis_box_iou(corners, corners + [0.5, 0.25, 0.0])
    first = Box3D(position=(0, 0, 0), size=(2, 1, 1), yaw=0)
    second = Box3D(position=(0.5, 0.25, 0), size=(2, 1, 1), yaw=0)
    assert pushed == pytest.approx(iou_3d(first, second))
    assert axis_box_iou(1.1 * corners, corners) == pytest.approx(1 / 1.1**3)
    points = samples(trimesh.creation.box(extents=(2, 1, 1)))
    assert axis_box_iou(points, corners) == pytest.approx(1, abs=0.01)


def test_layout_measure_of_a_pushed_object():
    own = samples(trimesh.creation.box(extents=(0.1, 0.1, 0.1)))
    diameter = 0.1 * np.sqrt(3)
    perfect = layout_measure(own, own, diameter)
    assert (perfect.add_s, perfect.correct) == (0, True)
    assert perfect.icp_rot_deg == pytest.approx(0, abs=1e-5)
    near, far = (layout_measure(own + [d, 0, 0], own, diameter) for d in (0.01, 0.1))
    assert near.correct and not far.correct
    # Half of each cube's faces slide within themselves, the other points are d away at the most.
    assert 0 < near.add_s * diameter < 0.01 < far.add_s * diameter < 0.1


def test_missed_objects_count_against_the_recall():
    assert recall([0.05, 0.2, None, 0.09]) == 0.5
    assert recall([]) is None


def test_volumes_of_boxes_that_overlap():
    a, b = (trimesh.creation.box(extents=(2, 2, 2)) for _ in range(2))
    perfect = volume_measure(a, a)
    assert perfect.voxel_iou == 1 and perfect.f_score == 1 and perfect.chamfer == 0
    b.apply_translation((0.5, 0, 0))
    assert voxel_iou(a, b) == pytest.approx(1.5 / 2.5, abs=0.03)
    # An exact Boolean of another library.
    l_shape, pushed = bracket(8.0), bracket(8.0)
    pushed.apply_translation((0.1, 0.06, 0.05))
    common = trimesh.boolean.intersection([l_shape, pushed], engine="manifold").volume
    exact = common / (l_shape.volume + pushed.volume - common)
    assert voxel_iou(l_shape, pushed) == pytest.approx(exact, abs=0.06)
    assert voxel_iou(l_shape, pushed, pitch=0.016) == pytest.approx(exact, abs=0.02)


def test_volume_measure_is_in_the_frame_of_the_truth():
    truth = bracket()
    framed = normalized(truth, truth)
    assert np.abs(framed.bounds).max() == pytest.approx(1)
    pushed = truth.copy()
    pushed.apply_translation((0, 0, 0.3))
    result = volume_measure(pushed, truth)
    assert result.f_score == 0 and result.voxel_iou == 0
    # The longest side of 0.2 m has 2 units: 0.3 m are 3, both ways at least 3 - 1.8.
    assert 2.4 < result.chamfer < 6
    scaled, frame = truth.copy(), truth.copy()
    for mesh in (scaled, frame):
        mesh.apply_scale(7.0)
    assert volume_measure(scaled, frame) == volume_measure(truth, truth)
    huge = truth.copy()
    huge.apply_scale(1e4)
    with pytest.raises(ValueError, match="too many voxels"):
        volume_measure(huge, truth)


def meshed(name, mesh, hulls):
    shape = Mesh(
        vertices=tuple(map(tuple, mesh.vertices.tolist())),
        faces=tuple(map(tuple, mesh.faces.tolist())),
        hulls=tuple(tuple(map(tuple, np.asarray(points).tolist())) for points in hulls),
    )
    return single(name, (shape, (0, 0, 0)))


def parts_of(name):
    """Return convex parts [m] that make up a bracket, a bowl or a table."""
    boxes = {
        "bracket": [((0.2, 0.12, 0.03), (0, 0, 0.015)), ((0.03, 0.12, 0.15), (-0.085, 0, 0.105))],
        "tray": [
            ((0.3, 0.2, 0.01), (0, 0, 0.005)),
            *(((0.3, 0.01, 0.08), (0, y, 0.05)) for y in (-0.095, 0.095)),
            *(((0.01, 0.18, 0.08), (x, 0, 0.05)) for x in (-0.145, 0.145)),
        ],
        "stool": [
            ((0.4, 0.4, 0.03), (0, 0, 0.435)),
            *(((0.04, 0.04, 0.42), (x, y, 0.21)) for x in (-0.18, 0.18) for y in (-0.18, 0.18)),
        ],
    }[name]
    meshes = []
    for size, at in boxes:
        mesh = trimesh.creation.box(extents=size)
        mesh.apply_translation(at)
        meshes.append(mesh)
    return meshes


POISONS = {
    "shifted": lambda hulls, size: [points + [0.15 * size, 0, 0] for points in hulls],
    "grown": lambda hulls, size: [
        points.mean(axis=0) + 1.6 * (points - points.mean(axis=0)) for points in hulls
    ],
    "one hull": lambda hulls, size: [np.vstack(hulls)],
}


@pytest.mark.parametrize("name", ["bracket", "tray", "stool"])
def test_poisoned_colliders_are_found(name):
    """Nine meshes whose visual geometry is right: the gap finds all, and none of the sound ones."""
    meshes = parts_of(name)
    whole = trimesh.util.concatenate(meshes)
    hulls = [np.asarray(mesh.vertices) for mesh in meshes]
    size = float(np.linalg.norm(whole.extents))
    sound = collider_gap(meshed(name, whole, hulls))
    assert sound is not None and sound.sound and sound.short_m < 1e-9
    for poison, change in POISONS.items():
        gap = collider_gap(meshed(name, whole, change(hulls, size)))
        assert gap is not None and not gap.sound, poison


def test_collider_gaps_are_distances():
    box = trimesh.creation.box(extents=(0.2, 0.2, 0.2))
    corners = np.asarray(box.vertices)
    pushed = collider_gap(meshed("box", box, [corners + [0.03, 0, 0]]))
    assert pushed is not None
    assert pushed.short_m == pytest.approx(0.03, abs=1e-6)
    assert pushed.protruding_m == pytest.approx(0.03, abs=2e-3)
    small = collider_gap(meshed("box", box, [0.5 * corners]))
    assert small is not None
    # Half as large about the center: the faces are 5 cm within the visual ones.
    assert small.short_m == pytest.approx(0.05, abs=1e-6)
    assert small.protruding_m == pytest.approx(0.05, abs=3e-3)
    assert collider_gap(single("block", (Box(size=(0.1, 0.1, 0.1)), (0, 0, 0.05)))).sound


@pytest.mark.slow
def test_sound_colliders_raise_few_alarms():
    """The 91 templates collide as they look; at most 5 % exceed the bound."""
    gaps = {name: collider_gap(built(template(name).program({}))) for name in templates()}
    alarms = [name for name, gap in gaps.items() if gap is None or not gap.sound]
    assert len(alarms) <= 0.05 * len(gaps), alarms
