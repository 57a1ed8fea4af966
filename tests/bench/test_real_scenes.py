"""Search on the scenes of photographs."""

import pytest
from neoworld_bench.photographs.real_scenes import FOLDER, REAL, real_refinements

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.errors import EngineError
from neoworld_mjx.physics import model
from neoworld_mjx.spec import read_scene

QUICK = RefineOptions.model_validate(
    {"cem": {"population": 24, "iterations": 2}, "check_duration_s": 0.2}
)


@pytest.mark.parametrize("name", REAL)
def test_scenes_have_cameras_and_boxes(name):
    scene = read_scene(FOLDER / f"{name}.json")
    assert scene.camera is not None
    assert sum(item.box2d is not None for item in scene.objects) >= 3


@pytest.mark.slow
def test_valid_scene_stays_unchanged_and_compiles_nothing(monkeypatch):
    # A full process forgets what it has compiled; here that would be counted.
    monkeypatch.setattr(model, "free_memory_maps", lambda: False)
    (row,) = real_refinements(("rt1_move_near",), options=QUICK)
    assert row.valid and row.kept == row.movable == 6
    assert row.programs == 0 and row.rollouts == 1


def test_unknown_scene_is_refused_with_the_choices():
    with pytest.raises(EngineError, match="posecnn_3"):
        next(real_refinements(("posecnn",)))
