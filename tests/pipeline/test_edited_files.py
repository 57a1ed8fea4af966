"""Files of a run that a person edits between steps: programs, sizes, trees and the layout patch."""

import json
import re
import shutil
from pathlib import Path

import pytest

from neoworld_mjx.compose.layout_patch import LayoutPatch
from neoworld_mjx.errors import ProgramError
from neoworld_mjx.pipeline import reconstruct
from neoworld_mjx.spec import ObjectSpec, bounds, read_scene

PAGES = Path(__file__).parents[2] / "docs"
HEIGHT, HIGHER = "H, R, WALL = 0.050", "H, R, WALL = 0.070"


@pytest.fixture(scope="module")
def edited(example_run, photo, tmp_path_factory, quick_config):
    """The example up to its composed scene, with a higher cup and a spoon moved by 6 cm."""
    run = shutil.copytree(example_run[0], tmp_path_factory.mktemp("edited") / "run")
    program = run / "objects" / "cup" / "program.py"
    program.write_text(program.read_text().replace(HEIGHT, HIGHER))
    tree = json.loads((run / "tree.json").read_text())
    (spoon,) = [node for node in tree["nodes"] if node["name"] == "spoon"]
    spoon["box3d"]["position"][1] += 0.06
    (run / "tree.json").write_text(json.dumps(tree))
    return reconstruct(photo, run, quick_config, start="verify", until="compose")


def edges(spec, state):
    low, high = bounds(spec, state)
    return (high - low).tolist()


def test_an_edited_program_is_built_by_the_next_step(edited):
    home = edited.folder / "objects" / "cup"
    assert HIGHER in (home / "program.py").read_text()
    spec = ObjectSpec.model_validate_json((home / "spec.json").read_text())
    assert edges(spec, {})[2] == pytest.approx(0.07, abs=5e-4)
    assert {
        "step": "verify/cup",
        "what": "cup was built again",
        "why": "program.py was edited",
    } in (edited.notes)


def test_an_edited_size_is_kept_by_composition_and_alignment(edited):
    scene = read_scene(edited.folder / "compose" / "scene.json")
    cup = scene.object("cup")
    home = edited.folder / "objects" / "cup"
    built = ObjectSpec.model_validate_json((home / "spec.json").read_text())
    assert edges(cup.spec, {}) == pytest.approx(edges(built, {}), rel=1e-4)
    saucer = json.loads((edited.folder / "compose" / "align.json").read_text())["objects"]["saucer"]
    assert saucer["size_ratio"] != pytest.approx(1, abs=1e-4)  # Not edited, so it is estimated.


def test_an_edited_program_that_builds_nothing_is_an_error(edited, photo, tmp_path):
    run = shutil.copytree(edited.folder, tmp_path / "run")
    program = run / "objects" / "cup" / "program.py"
    program.write_text(program.read_text() + "\ncup.hinge(1)\n")
    with pytest.raises(ProgramError, match="which was edited, builds no object: "):
        reconstruct(photo, run, start="verify", until="verify")


def test_the_documented_layout_patch_is_one():
    page = (PAGES / "run-folder.md").read_text()
    (block,) = re.findall(r"```json title=\"layout.patch.json\"\n(.*?)```", page, re.DOTALL)
    patch = LayoutPatch.model_validate_json(block)
    assert patch.objects["cup"].xy and patch.objects["cabinet"].joint_state
    for name in type(patch.objects["cup"]).model_fields:
        assert f"`{name}`" in page
