"""Scenes of other methods: reading, scores and errors."""

import re
from pathlib import Path

import pytest
from neoworld_bench.dataset.declaration import declarations
from neoworld_bench.dataset.truth_scene import truth_scene
from neoworld_bench.fidelity.rendered_responses import exact_response
from neoworld_bench.fidelity.rendered_scenes import see
from neoworld_bench.methods.layout_errors import displaced, layout_errors, unmatched, validity
from neoworld_bench.methods.submission import submission_name, submitted

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.errors import SpecError
from neoworld_mjx.export import export_scene
from neoworld_mjx.spec import SceneSpec
from tests.support.bop_sample import desk
from tests.support.mesh_scenes import write_glb, write_poses

QUICK = RefineOptions(check_duration_s=0.2)
DOCS = Path("docs/benchmark.md")


@pytest.fixture(scope="module")
def truth() -> SceneSpec:
    return truth_scene(declarations()["dominoes"])


def write(folder: Path, scene: SceneSpec) -> Path:
    place = folder / "dominoes"
    place.mkdir(parents=True, exist_ok=True)
    (place / "scene.json").write_text(scene.to_json())
    return folder


def test_ground_truth_as_json_and_mjcf_scores_perfectly(tmp_path, truth: SceneSpec):
    write(tmp_path, truth)
    own = submitted(tmp_path, truth, QUICK)
    assert own.scene == truth and own.accepted is None
    assert validity(own.scene, own.measure, truth, QUICK).valid
    export_scene(truth, tmp_path / "mjcf" / "dominoes")
    (tmp_path / "mjcf" / "dominoes" / "scene.json").unlink()
    read = submitted(tmp_path / "mjcf", truth, QUICK)
    assert validity(read.scene, read.measure, truth, QUICK).valid
    assert read.seconds is None and read.scene.camera == truth.camera
    assert unmatched(read.scene, truth) == ([], []) and displaced(read.scene, truth) == []
    assert max(layout_errors(read.scene, truth).values()) < 1e-6
    assert read.measure.max_drift_m == pytest.approx(own.measure.max_drift_m, abs=1e-5)


def test_ground_truth_as_meshes_scores_perfectly(tmp_path):
    """Supports are those of the ground truth, and colliders are made from the meshes."""
    truth = desk()
    write_glb(tmp_path / "glb" / "desk" / "scene.glb", truth)
    write_poses(tmp_path / "obj" / "desk", truth)
    for folder in (tmp_path / "glb", tmp_path / "obj"):
        read = submitted(folder, truth, QUICK)
        assert [item.name for item in read.scene.objects if item.static] == ["table"]
        assert unmatched(read.scene, truth) == ([], []) and displaced(read.scene, truth) == []
        assert max(layout_errors(read.scene, truth).values()) < 1e-4
        assert validity(read.scene, read.measure, truth, QUICK).valid


def test_errors_of_broken_submissions_name_the_folder(tmp_path, truth: SceneSpec):
    file = tmp_path / "dominoes" / "scene.json"
    with pytest.raises(SpecError, match=r"dominoes has none of scene\.json.*--scenes"):
        submitted(tmp_path, truth, QUICK)
    file.parent.mkdir()
    file.write_text('{"objects": [')
    with pytest.raises(SpecError, match=r"scene\.json is not a scene"):
        submitted(tmp_path, truth, QUICK)
    table = truth.model_copy(update={"objects": truth.objects[:1]})
    with pytest.raises(SpecError, match=r"no object of the scene that is free to move.*domino_0"):
        submitted(write(tmp_path, table), truth, QUICK)
    file.unlink()
    file.with_suffix(".xml").write_text(
        '<mujoco><worldbody><body name="domino_0"><freejoint/><geom size="0.1"/></body>'
        "</worldbody></mujoco>"
    )
    with pytest.raises(SpecError, match="holds one object, not a scene"):
        submitted(tmp_path, truth, QUICK)
    assert submission_name(tmp_path / "a|b <i>") == "submission:a_b__i_"


def test_documented_submission_program_needs_no_package(tmp_path, truth: SceneSpec, monkeypatch):
    code = re.search(r'```python title="boxes.py"\n(.*?)```', DOCS.read_text(), re.DOTALL)
    assert code is not None and "neoworld" not in code[1]
    monkeypatch.chdir(tmp_path)
    Path("data/scenes/dominoes").mkdir(parents=True)
    Path("data/scenes/dominoes/tree.json").write_text(exact_response(see(truth)).to_json())
    exec(code[1], {})
    made = submitted(Path("boxes"), truth, QUICK)
    assert unmatched(made.scene, truth) == ([], [])
    assert layout_errors(made.scene, truth)["xy_error_m"] < 1e-6
