"""The compose step of a run with `compose.align.dimensions`: changed programs and their files."""

import json

import pytest
from neoworld_bench.fidelity.rendered_responses import exact_response

from neoworld_mjx.config import load_config
from neoworld_mjx.pipeline.compose_step import compose_scene
from neoworld_mjx.pipeline.object_steps import write_object_files
from neoworld_mjx.pipeline.step_context import Pictures, StepContext
from neoworld_mjx.program.sandbox import build
from neoworld_mjx.render import to_png
from neoworld_mjx.run_folder import RunFolder
from neoworld_mjx.spec import ObjectSpec, bounds, read_scene
from neoworld_mjx.verify.patch import MaterialEdit, Patch, apply, read_patch, write_patch
from neoworld_mjx.view.report.photograph import photograph_section
from tests.estimate import desk
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
        with run.step("parse", {}) as out:
            (out / "tree.json").write_text(exact_response(truth).to_json())
            (out / "photo.png").write_bytes(to_png(desk.photograph(truth, 640)))
        with run.step("program", {}) as out:
            for item in truth.objects:
                write_object_files(out, item.name, {"spec.json": item.spec.to_json()})
            spec = build(WRONG).spec.to_json()
            (out / "objects" / "brick" / "spec.json").write_text(spec)
            (out / "objects" / "brick" / "program.py").write_text(WRONG)
            # A program that builds something else than the composed object.
            (out / "objects" / "tower" / "program.py").write_text(BRICK)
        with run.step("verify", {}) as out:
            write_object_files(out, "brick", {"spec.json": patched(WRONG).to_json()})
            write_patch(out / "objects" / "brick" / "program.py", PATCH)
        with Pictures(run, CONFIG.render) as pictures:
            compose_scene(StepContext(run, CONFIG, None, None, pictures))
    return path


def test_the_changed_program_builds_the_composed_object(folder):
    home = folder / "objects" / "brick"
    text = (home / "program.py").read_text()
    assert (home / "history" / "program" / "program.py").read_text() == WRONG
    spec = ObjectSpec.model_validate_json((home / "spec.json").read_text())
    assert spec == patched(text) and spec.material("green").friction == 0.33
    assert read_patch(home / "program.py") == PATCH
    edges, composed = (
        high - low
        for low, high in (
            bounds(spec),
            bounds(read_scene(folder / "compose" / "scene.json").object("brick").spec),
        )
    )
    assert composed / edges == pytest.approx([composed[0] / edges[0]] * 3)
    assert edges[1] / edges[0] == pytest.approx(0.07 / 0.12, rel=0.02)
    changed = folder.glob("objects/*/history/program/program.py")
    assert {path.parents[2].name for path in changed} == {"brick"}


def test_run_json_and_report_name_the_change(folder):
    run = json.loads((folder / "run.json").read_text())
    outputs = run["steps"]["compose"]["outputs"]
    assert {"objects/brick/program.py", "objects/brick/spec.json"} <= set(outputs)
    whats = {note["what"]: note["why"] for note in run["notes"]}
    assert whats["brick has other dimensions than its program"].startswith("WIDTH 0.077 -> 0.0")
    aligned = json.loads((folder / "compose" / "align.json").read_text())["dimensions"]
    assert aligned["brick"]["edits"][0]["constant"] == "WIDTH"
    assert set(aligned) == {"brick"}
    assert "WIDTH 0.077 -&gt; 0.0" in str(photograph_section(folder))


def test_the_step_is_kept_and_its_programs_go_with_it(folder):
    def compose_again(config):
        with RunFolder(folder, config, "resume") as run:
            with Pictures(run, config.render) as pictures:
                compose_scene(StepContext(run, config, None, None, pictures))
            return run.data["steps"]["compose"]["seconds"]

    before = json.loads((folder / "run.json").read_text())["steps"]["compose"]["seconds"]
    assert compose_again(CONFIG) == before
    compose_again(load_config(None, {"compose": {"looks": False, "align": {"enabled": False}}}))
    home = folder / "objects" / "brick"
    assert (home / "program.py").read_text() == WRONG
    assert (home / "spec.json").read_text() == patched(WRONG).to_json()
    assert (home / "program.patch.json").is_file()
