import pytest

from neoworld_mjx.compose.layout_patch import (
    LAYOUT_PATCH,
    LayoutPatch,
    ObjectPlacement,
    apply_layout,
    read_layout_patch,
    write_layout_patch,
)
from neoworld_mjx.compose.on_supports import snap
from neoworld_mjx.errors import SpecError
from neoworld_mjx.spec import Box2D
from tests.support import scenes


def test_a_patch_changes_only_the_objects_that_it_names():
    scene = snap(scenes.blocks())
    name = next(obj.name for obj in scene.objects if not obj.environment)
    x, y = scene.object(name).xy
    box = Box2D(x0=1, y0=2, x1=30, y1=40)
    patch = LayoutPatch().merged(name, ObjectPlacement(xy=(x + 0.01, y), yaw=0.3))
    patch = patch.merged(name, ObjectPlacement(box2d=box))
    moved, stale = apply_layout(scene, patch)
    assert stale == ()
    assert moved.object(name).xy == (x + 0.01, y) and moved.object(name).yaw == 0.3
    assert moved.object(name).box2d == box and scene.object(name).box2d is None
    others = [obj.name for obj in scene.objects if obj.name != name and obj.parent != name]
    assert all(moved.object(n) == scene.object(n) for n in others)


def test_the_file_round_trips_and_an_invalid_one_is_an_error(tmp_path):
    patch = LayoutPatch().merged("cup", ObjectPlacement(xy=(0.1, 0.2)))
    write_layout_patch(tmp_path, patch)
    assert read_layout_patch(tmp_path) == patch
    (tmp_path / LAYOUT_PATCH).write_text('{"objects": {"cup": {"xy": [1]}}}')
    with pytest.raises(SpecError, match=r"layout\.patch\.json"):
        read_layout_patch(tmp_path)
    write_layout_patch(tmp_path, LayoutPatch())
    assert not (tmp_path / LAYOUT_PATCH).exists()
