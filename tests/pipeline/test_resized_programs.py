"""The compose step of a run with `compose.align.dimensions`: changed programs and their files."""

import json

import pytest
from neoworld_bench.fidelity.rendered_responses import exact_response

from neoworld_mjx.config import load_config
from neoworld_mjx.pipeline.compose_step import compose_scene
from neoworld_mjx.pipeline.resized_programs import program_files
from neoworld_mjx.pipeline.scene_pictures import Pictures
from neoworld_mjx.pipeline.step_context import StepContext
from neoworld_mjx.program.sandbox import build
from neoworld_mjx.render import to_png
from neoworld_mjx.run_folder import RunFolder
from neoworld_mjx.spec import ObjectSpec, bounds, read_scene
from neoworld_mjx.verify.patch import MaterialEdit, Patch, apply, read_patch, write_patch
from neoworld_mjx.view.report.photograph import photograph_section
from neoworld_mjx.view.target import open_target
from tests.align import desk
from tests.program.test_freed_dimensions import BRICK, WRONG, composed_with, object_of

CONFIG = load_config(None, {"compose": {"align": {"dimensions": True}, "looks": False}})
PATCH = Patch(materials={"green": MaterialEdit(friction=0.33)})


def patched(text):
    return apply(PATCH, build(text).spec)[0]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The run folder after its compose step; the brick is 10 % too wide, and patched by Step 3."""
    path = tmp_path_factory.mktemp("resized") / "run"
    truth = desk.boxed(composed_with(desk.five(), object_of(BRICK)))
    with RunFolder(path, CONFIG) as run:
        (path / "tree.json").write_text(exact_response(truth).to_json())
        (path / "photo.png").write_bytes(to_png(desk.photograph(truth, 640)))
        for item in truth.objects:
            home = path / "objects" / item.name
            home.mkdir(parents=True)
            (home / "spec.json").write_text(item.spec.to_json())
        home = path / "objects" / "brick"
        (home / "program.py").write_text(WRONG)
        (home / "spec.json").write_text(build(WRONG).spec.to_json())
        (home / "verified.json").write_text(patched(WRONG).to_json())
        write_patch(home / "program.py", PATCH)
        # A program that builds something else than the composed object.
        (path / "objects" / "tower" / "program.py").write_text(BRICK)
        with Pictures(run, CONFIG.render) as pictures:
            compose_scene(StepContext(run, CONFIG, None, None, pictures))
    return path


def test_the_changed_program_builds_the_composed_object(folder):
    home = folder / "objects" / "brick"
    text = (home / "resized.py").read_text()
    assert (home / "program.py").read_text() == WRONG
    spec = ObjectSpec.model_validate_json((home / "resized.json").read_text())
    assert spec == patched(text) and spec.material("green").friction == 0.33
    assert read_patch(home / "resized.py") == PATCH
    edges, composed = (
        high - low
        for low, high in (
            bounds(spec),
            bounds(read_scene(folder / "compose" / "scene.json").object("brick").spec),
        )
    )
    assert composed / edges == pytest.approx([composed[0] / edges[0]] * 3)
    assert edges[1] / edges[0] == pytest.approx(0.07 / 0.12, rel=0.02)
    assert {path.parent.name for path in folder.glob("objects/*/resized.py")} == {"brick"}


def test_run_json_report_and_viewer_name_the_change(folder):
    run = json.loads((folder / "run.json").read_text())
    outputs = run["steps"]["compose"]["outputs"]
    assert {"objects/brick/resized.py", "objects/brick/resized.json"} <= set(outputs)
    whats = {note["what"]: note["why"] for note in run["notes"]}
    assert whats["brick has other dimensions than its program"].startswith("WIDTH 0.077 -> 0.0")
    aligned = json.loads((folder / "compose" / "align.json").read_text())["dimensions"]
    assert aligned["brick"]["edits"][0]["constant"] == "WIDTH"
    assert aligned["can"]["reason"] == "it has no program"
    assert aligned["tower"]["reason"] == "its program does not build the composed object"
    report = str(photograph_section(folder))
    assert "WIDTH 0.077 -&gt; 0.0" in report and "unchanged: it has no program" in report
    target = open_target(folder / "objects" / "brick", CONFIG)
    assert target.title == "resized.py"


def test_the_step_is_kept_and_its_programs_go_with_it(folder):
    def compose_again(config):
        with RunFolder(folder, config, "resume") as run:
            with Pictures(run, config.render) as pictures:
                compose_scene(StepContext(run, config, None, None, pictures))
            return run.data["steps"]["compose"]["seconds"]

    before = json.loads((folder / "run.json").read_text())["steps"]["compose"]["seconds"]
    assert compose_again(CONFIG) == before
    names = {path.split("/")[0] for path in program_files(folder, exact_tree(folder))}
    assert names == {"brick", "tower"}
    compose_again(load_config(None, {"compose": {"looks": False}}))
    assert not list(folder.glob("objects/*/resized*"))
    assert (folder / "objects" / "brick" / "program.patch.json").is_file()


def exact_tree(folder):
    from neoworld_mjx.spec import SceneTree

    return SceneTree.model_validate_json((folder / "tree.json").read_text())
