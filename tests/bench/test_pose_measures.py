"""Measures of depth and poses: analytic cases, and second implementations."""

import numpy as np
import pytest
import trimesh
from neoworld_bench.measures.pose_measure import (
    Intrinsics,
    Similarity,
    add_s,
    depth_measure,
    icp_rotation_deg,
    measured_points,
    robust_similarity,
)
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

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
    assert all(abs(value) < 1e-6 for e in result.objects.values() for value in e[:4])
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
    assert min(e.absolute_mm for e in result.objects.values()) > 100


def test_add_s_against_its_definition():
    a = samples(bracket(), 500)
    b = moved(a, transform(20, (0.01, 0, 0)))
    both = (cdist(a, b).min(axis=1).mean() + cdist(b, a).min(axis=1).mean()) / 2
    assert add_s(a, b) == pytest.approx(both)


@pytest.mark.parametrize("angle", [0, 3, 12, 25])
def test_icp_rotation_is_the_angle(angle):
    own = samples(bracket(), 3000)
    turned = moved(own, transform(angle, (0.004, -0.003, 0.002)))
    assert icp_rotation_deg(turned, own) == pytest.approx(angle, abs=0.02)
