"""Every recipe of AGENTS.md, carried out: its modules are written and its check is run."""

import json
import re
import sys
from functools import partial
from pathlib import Path

import pytest

import neoworld_mjx as nw

TEXT = (Path(__file__).parents[1] / "AGENTS.md").read_text(encoding="utf-8")
RECIPES = dict(
    re.findall(r"^### (.+?)\n(.*?)(?=^##)", TEXT.partition("## Recipes")[2], re.M | re.S)
)
BLOCK = re.compile(r'```(?:python|yaml) title="([\w.]+)"\n(.*?)```', re.S)
SEARCH = {
    "cem": {"population": 8, "iterations": 2, "stop_gain": 0, "hold_resting": False},
    "settle": {"enabled": False},
    "rollout": {"duration_s": 0.2, "engine": "native"},
    "check_duration_s": 0.1,
    "finalists": 1,
}


def test_there_is_a_recipe_for_each_usual_addition():
    kinds = "reward term, optimizer, engine, composite shape, template, joint type, command"
    kinds += ", benchmark suite"
    for kind in kinds.split(", "):
        assert any(kind in title for title in RECIPES), kind


@pytest.mark.parametrize("title", RECIPES)
def test_recipe(title, tmp_path, monkeypatch, capfd, blocks_model):
    """Write the recipe's modules, and run its check with the tables put back afterwards."""
    from neoworld_bench.suites import SUITES

    from neoworld_mjx import cli
    from neoworld_mjx.commands import COMMANDS
    from neoworld_mjx.config import load_config
    from neoworld_mjx.engines import ENGINES

    def command(*args):
        with pytest.raises(SystemExit) as end:
            cli.main(args)
        assert end.value.code == 0
        return json.loads(capfd.readouterr().out)

    for table in (ENGINES, COMMANDS, SUITES):
        for name, row in list(table.items()):
            monkeypatch.setitem(table, name, row)
    before = [dict(table) for table in (ENGINES, COMMANDS, SUITES)]
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.chdir(tmp_path)
    blocks = BLOCK.findall(RECIPES[title])
    assert blocks and blocks[-1][0] == "check"
    modules = [name for name, _ in blocks if name != "check"]
    for name, code in blocks:
        if name != "check":
            (tmp_path / name).write_text(code)
    given = {
        "nw": nw,
        "scene": blocks_model,
        "options": load_config(None, {"refine": SEARCH}).refine,
        "command": command,
        "everywhere": partial(joint_type_everywhere, tmp_path),
    }
    try:
        exec(compile(blocks[-1][1], f"AGENTS.md: {title}", "exec"), given)
    finally:
        for name in modules:
            sys.modules.pop(name.removesuffix(".py"), None)
        for table, rows in zip((ENGINES, COMMANDS, SUITES), before, strict=True):
            table.clear()
            table.update(rows)


def joint_type_everywhere(tmp_path, kind):
    """Take a joint of a type through kinematics, scaling, sweep, physics and the formats."""
    from neoworld_mjx.checks.joint_sweep import joint_positions, joint_states
    from neoworld_mjx.export import export_object, read_mjcf, read_urdf
    from neoworld_mjx.physics.mjcf import to_mjspec
    from neoworld_mjx.spec import Box, ObjectSpec, link_poses, scale
    from tests.support.mechanisms import WOOD, geom, joint, part

    block, upper = Box(size=(0.1, 0.1, 0.1)), 0.0 if kind == "fixed" else 0.5
    base = part("base", geom("base_box", block))
    top = part("top", geom("top_box", block, (0, 0, 0.1)))
    turns = joint("joint", kind, "base", "top", (0, 0, 0.1), upper=upper)
    made = ObjectSpec(name="thing", materials=(WOOD,), parts=(base, top), joints=(turns,))
    assert scale(made, 2.0).joint("joint").pos == (0, 0, 0.2)
    if kind != "fixed":
        states = [s for v in joint_positions(turns, 3) for s in joint_states(turns, v)]
        moved = {(*p.pos, *p.quat) for p in (link_poses(made, s)["top"] for s in states)}
        assert len(moved) > 2, "kinematics do not move it"
    model = to_mjspec(made).compile()
    assert model.njnt == 1 + (kind != "fixed"), "physics has no joint for it"
    export_object(made, tmp_path / kind)
    if kind != "fixed":  # MJCF and URDF readers may merge links that are welded together.
        for reader, file in ((read_mjcf, "object.xml"), (read_urdf, "object.urdf")):
            types = [joint.type for joint in reader(tmp_path / kind / file).joints]
            # URDF has no ball: it becomes three hinges.
            three = kind == "ball" and types == ["revolute"] * 3 and file == "object.urdf"
            assert kind in types or three, file


def test_the_architecture_page_names_what_there_is():
    root = Path(__file__).parents[1]
    text = (root / "docs" / "architecture.md").read_text(encoding="utf-8")
    named = re.findall(r"`([\w/]+\.py): (\w+)(?:\.(\w+))?`", text)
    assert len(named) > 15
    for file, name, member in named:
        files = [
            p
            for p in (root / "neoworld_mjx").rglob(file.rpartition("/")[2])
            if p.as_posix().endswith(file)
        ]
        assert len(files) == 1, file
        assert re.search(rf"(def|class) {member or name}\b", files[0].read_text()), (file, name)
    table = text.split("| line | paper |")[1].split("\n\n")[0]
    checked = 0
    for row in table.splitlines()[2:]:
        _, _, places, code = row.split("|")[1:-1]
        files = re.findall(r"`([\w/]+\.py)", places)
        folders = (root / "neoworld_mjx" / "search", root / "neoworld_mjx")
        paths = [folder / file for file in files for folder in folders]
        source = "".join(path.read_text(encoding="utf-8") for path in paths if path.exists())
        lines = [line.strip() for line in source.splitlines()]
        for snippet in re.findall(r"`([^`]+)`", code):
            assert snippet in lines, (files, snippet)
            checked += 1
    assert checked >= 14
