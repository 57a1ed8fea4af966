"""One verdict: run.json, the terminal, `check`, the report and the page give the same reasons."""

import json

import pytest

from neoworld_mjx.config import load_config
from neoworld_mjx.pipeline import refine_again
from neoworld_mjx.run_folder import RunFolder
from neoworld_mjx.spec import SceneSpec, world_poses
from neoworld_mjx.view.scene_viewer import verdict_of
from neoworld_mjx.view.target import open_target
from tests.support import scenes

CONFIG = load_config(
    None,
    {
        "render": {"width": 64, "supersample": 1},
        "refine": {
            "check_duration_s": 0.5,
            "cem": {"population": 2, "iterations": 1},
            "rollout": {"duration_s": 0.2, "samples_per_object": 16},
            "max_tilt_deg": 7.0,
        },
    },
)


@pytest.fixture(scope="module")
def fallen(tmp_path_factory):
    """A refined run in which a plate that would fall from its support is held there."""
    low = scenes.block("low", (0.1, 0.1, 0.06))
    plate = scenes.block("plate", (0.1, 0.06, 0.02))
    scene = scenes.on_table(
        (low, (0, 0), 0.0, {}), (plate, (0.12, 0.0), 0.0, {"parent": "low", "z": 0.06})
    )
    out = tmp_path_factory.mktemp("fallen") / "out"
    with RunFolder(out, CONFIG) as run, run.step("compose", {}) as stage:
        (stage / "compose").mkdir()
        (stage / "compose" / "scene.json").write_text(scene.to_json())
    return out, refine_again(out)


def test_a_scene_in_which_an_object_would_fall_is_not_valid_anywhere(fallen, neoworld):
    out, result = fallen
    run = json.loads((out / "run.json").read_text())
    failed = [check for check in run["metrics"]["checks"] if not check["passed"]]
    assert [check["name"] for check in failed] == ["held"]
    # The plate would fall, and it is held together with what carries it.
    assert failed[0]["failing"] == ["low", "plate"] and failed[0]["phrase"].startswith("low, plate")
    scene = SceneSpec.model_validate_json((out / "scene.json").read_text())
    assert world_poses(scene)["plate"].pos[2] == pytest.approx(0.06, abs=2e-3)
    line = result.verdict
    assert line == f"not valid: {failed[0]['phrase']}" and line in repr(result)
    checked = neoworld("check", out)
    assert checked.returncode == 1 and checked.stdout.splitlines()[0] == line
    details = json.loads(neoworld("check", out, "--json").stdout)
    assert details["checks"] == run["metrics"]["checks"]
    assert neoworld("report", out).stdout.splitlines()[0] == line
    report = (out / "report.html").read_text()
    assert line in report.partition("</header>")[0]
    assert verdict_of(open_target(out, CONFIG))[1] == line
    assert any(failed[0]["phrase"] in entry["why"] for entry in result.fallbacks)


def test_other_options_check_a_run_again(fallen, neoworld):
    out, _ = fallen
    checked = json.loads(neoworld("check", out, "--json", "--set", "refine.max_tilt_deg=3").stdout)
    assert {c["name"]: c["threshold"] for c in checked["checks"]}["max_tilt_deg"] == 3.0
    assert not checked["passed"]
