"""Sizes of meshes from the heights at which they are given."""

import numpy as np
import pytest
import trimesh
from neoworld_bench.rescues.disturbed_scenes import lifted, scene_of_meshes, upright
from scipy.optimize import minimize

from neoworld_mjx.compose.mesh_supports import find_supports, with_supports
from neoworld_mjx.spec import SceneSpec, bounds, world_poses

TOP, SUNK = 0.4, 0.02
HEIGHTS = {"low": 0.1, "high": 0.06, "left": 0.08, "right": 0.12}
EDGE = 0.08
PLACES = {"low": 0.0, "high": 0.0, "left": 0.25, "right": -0.25}


def shelf(sizes=(), rises=(), names=tuple(HEIGHTS)) -> SceneSpec:
    """Return boxes on a table, `high` on `low`, all too low alike.

    Args:
        sizes: wrong sizes by name; boxes are scaled about their middles.
        rises: further errors of height [m] by name.
        names: of the boxes.
    """
    table = lifted(trimesh.creation.box((0.8, 1.0, 0.04)))
    objects = {"table": (table, upright(np.array([0.9, 0, TOP - 0.04]), 0))}
    for name in names:
        edge = 0.5 * EDGE if name == "high" else EDGE
        box = trimesh.creation.box((edge, edge, HEIGHTS[name]))
        pose = upright(np.array([0.9, PLACES[name], middle(name) - SUNK]), 0.3)
        pose[2, 3] += dict(rises).get(name, 0.0)
        pose[:3, :3] *= dict(sizes).get(name, 1.0)
        objects[name] = box, pose
    return scene_of_meshes(objects).spec


def middle(name: str) -> float:
    """Return the true height of a box's middle [m]."""
    return TOP + HEIGHTS[name] / 2 + (HEIGHTS["low"] if name == "high" else 0)


def height(scene: SceneSpec, name: str) -> float:
    return float(np.subtract(*bounds(scene.object(name).spec)[::-1])[2])


def fitted(scene: SceneSpec, **options) -> SceneSpec:
    return with_supports(find_supports(scene), sizes=True, **options).scene


def test_sizes_are_those_at_which_surfaces_move_least():
    """The result of a general minimizer over sizes and the common shift, with contact by hand."""
    sizes = {"low": 0.9, "high": 1.05, "left": 1.08}
    given = {name: sizes.get(name, 1.0) * h for name, h in HEIGHTS.items()}

    def square(name):  # Mean square distance of a surface from the middle, by samples.
        edge = sizes.get(name, 1.0) * (0.5 * EDGE if name == "high" else EDGE)
        box = trimesh.creation.box((edge, edge, given[name]))
        return (trimesh.sample.sample_surface(box, 200_000, seed=1)[0] ** 2).sum(axis=1).mean()

    squares = {name: square(name) for name in HEIGHTS}

    def motion(x):
        end = {name: (1 + e) * given[name] for name, e in zip(HEIGHTS, x, strict=False)}
        total = 0.0
        for name, e in zip(HEIGHTS, x, strict=False):
            at = TOP + end[name] / 2 + (end["low"] if name == "high" else 0)
            total += (at - (middle(name) - SUNK) - x[-1]) ** 2 + e**2 * squares[name]
        return 1e6 * total

    expected = minimize(motion, np.zeros(5), tol=1e-12).x
    made = fitted(shelf(sizes))
    for name, change in zip(HEIGHTS, expected, strict=False):
        assert height(made, name) / given[name] - 1 == pytest.approx(change, abs=3e-3), name


def test_what_stands_on_a_box_of_a_wrong_size_gets_nearer_to_where_it_stood():
    given = shelf({"low": 0.9})
    kept = with_supports(find_supports(given)).scene
    errors = [abs(world_poses(s)["high"].pos[2] - 0.5) for s in (kept, fitted(given))]
    assert errors[0] == pytest.approx(0.01, abs=5e-4) and errors[1] < 0.5 * errors[0]


@pytest.mark.parametrize("names", [("low",), tuple(HEIGHTS)])
def test_a_common_error_of_height_changes_no_size(names):
    made = fitted(shelf(names=names))
    for name in names:
        assert height(made, name) == pytest.approx(HEIGHTS[name], rel=2e-3)
    assert world_poses(made)["low"].pos[2] == pytest.approx(TOP, abs=5e-4)


def test_an_object_in_the_air_says_nothing_of_sizes():
    made = fitted(shelf({"low": 0.9}, {"right": 0.3}))
    assert height(made, "right") == pytest.approx(HEIGHTS["right"])
    apart = fitted(shelf({"low": 0.9}, names=("low", "high", "left")))
    assert height(made, "low") == pytest.approx(height(apart, "low"), rel=1e-3)


def test_what_rests_keeps_size_tilt_and_place():
    given = shelf({"low": 0.9})
    made = fitted(given, resting=("low", "high"))
    before, after = world_poses(given), world_poses(made)
    for name in ("low", "high"):
        assert height(made, name) == pytest.approx(height(given, name))
        assert np.allclose(before[name].pos, after[name].pos, atol=1e-9)
    # What stands on something that moves, moves along.
    made = fitted(given, resting=("high",))
    low, high = (world_poses(made)[name].pos[2] for name in ("low", "high"))
    assert high == pytest.approx(low + height(made, "low"), abs=1e-3)
