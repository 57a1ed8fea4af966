"""The bundled examples: their tapes answer today's requests, and they are what the table says."""

import json
from pathlib import Path

import pytest
from neoworld_bench.photographs.example_runs import run_example

from neoworld_mjx.config import load_config
from neoworld_mjx.errors import PhotoError
from neoworld_mjx.measure import measured, scene_checks
from neoworld_mjx.pipeline import reconstruct
from neoworld_mjx.pipeline.bundled_examples import bundled_examples, photo_of
from neoworld_mjx.program import build
from neoworld_mjx.program.ask import join_texts
from neoworld_mjx.program.blender.blender_process import unavailable
from neoworld_mjx.spec import ObjectSpec, SceneTree, read_scene
from tests.support.example_figures import EXPECTED, check_figures

MOST_BYTES = 470_000
PAPER = Path(__file__).parents[1] / "configs" / "paper.yaml"


@pytest.mark.parametrize(
    "name", ["drawers", "microwave"]
)  # For coffee, see tests/test_pipeline.py.
def test_an_example_is_what_the_table_says(name, tmp_path):
    example = bundled_examples()[name]
    assert example.photo.stat().st_size < MOST_BYTES
    config = load_config(None, {"provider": "replay"})
    reconstruct(example.photo, tmp_path / "run", config, until="program")
    tree = SceneTree.model_validate_json((tmp_path / "run" / "tree.json").read_text())
    assert sum(not node.environment for node in tree.nodes) == example.objects
    specs = [
        ObjectSpec.model_validate_json(path.read_text())
        for path in (tmp_path / "run" / "objects").glob("*/spec.json")
    ]
    joints = [joint for spec in specs for joint in spec.joints if joint.type != "fixed"]
    assert len(joints) == example.joints
    # Nothing that was seen to move is without its joint.
    assert sum(len(node.articulation) for node in tree.nodes) == example.joints


@pytest.mark.slow  # coffee, too, in tests/test_pipeline.py, which reconstructs it anyway.
@pytest.mark.parametrize("name", ["microwave", "drawers"])
def test_a_reconstruction_gives_the_figures_of_the_pages(name, tmp_path):
    example = bundled_examples()[name]
    row = run_example(name, example, load_config(), tmp_path / "run")
    check_figures(name, {key: getattr(row, key) for key in EXPECTED[name]})
    known = (example.responses.by, example.responses.date, example.responses.prompts)
    assert (row.answered_by, row.date, row.prompts) == known


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(bundled_examples()))
def test_an_example_is_far_from_every_bound_of_the_final_check(name, tmp_path):
    config = load_config(None, {"provider": "replay"})
    reconstruct(bundled_examples()[name].photo, tmp_path / "run", config)
    near = near_a_bound(tmp_path / "run" / "scene.json", config)
    assert not near, near


def near_a_bound(scene, config):
    """Return the measures of a scene within 0.2 mm (depth), 2 mm, or 1.5 degrees of a bound."""
    checks = scene_checks(measured(read_scene(scene), config.refine), config.refine)
    margins = {"depth_m": 0.2e-3, "drift_m": 2e-3, "slide_m": 2e-3, "_deg": 1.5}
    margin = {c.name: next(m for end, m in margins.items() if c.name.endswith(end)) for c in checks}
    return [c.phrase() for c in checks if c.value > c.threshold - margin[c.name]]


def test_the_papers_three_programs_replay_and_are_one(tmp_path):
    over = {
        "provider": "replay",
        "program": {"language": "sdk"},
        "refine": {"semantic": {"scorer": "geometric"}},
    }
    config = load_config(PAPER, over)
    result = reconstruct(bundled_examples()["microwave"].photo, tmp_path, config, until="program")
    home = tmp_path / "objects" / "microwave"
    texts = {
        name: (home / f"{name}.py").read_text() for name in ("geometry", "articulation", "export")
    }
    assert (home / "program.py").read_text() == join_texts(texts)
    spec = build((home / "program.py").read_text()).spec
    assert spec is not None and spec.to_json() == (home / "spec.json").read_text()
    rounds = json.loads((home / "program.json").read_text())["rounds"]
    assert [list(each["verdicts"])[-1] for each in rounds] == ["geometry", "articulation", "export"]
    assert result.fallbacks == []


@pytest.mark.slow
@pytest.mark.parametrize(("name", "joints", "calls"), [("coffee", 0, 17), ("microwave", 5, 9)])
def test_the_paper_replays_in_its_own_language(name, joints, calls, tmp_path):
    why = unavailable()
    if why is not None:
        pytest.skip(why)
    over = {"provider": "replay", "refine": {"semantic": {"scorer": "geometric"}}}
    config = load_config(PAPER, over)
    assert config.program.language == "blender"
    result = reconstruct(bundled_examples()[name].photo, tmp_path, config, until="verify")
    specs = [
        ObjectSpec.model_validate_json(path.read_text())
        for path in (tmp_path / "objects").glob("*/spec.json")
    ]
    assert sum(joint.type != "fixed" for spec in specs for joint in spec.joints) == joints
    verdicts = [json.loads(p.read_text()) for p in (tmp_path / "objects").glob("*/verify.json")]
    assert all(verdict["passed"] for verdict in verdicts)
    assert result.fallbacks == []
    assert result.cost["calls"] == calls


def test_an_example_is_named_or_given_by_its_file(tmp_path):
    example = bundled_examples()["microwave"]
    assert photo_of(example.photo) == photo_of(type(example.photo)("microwave")) == example.photo
    with pytest.raises(PhotoError, match="did you mean 'drawers'"):
        photo_of(type(example.photo)("drawer"))
