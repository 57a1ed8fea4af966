"""The example that loads a scene in simulators measures motion, and states failures as such."""

import json
import runpy
from pathlib import Path

import mujoco
import pytest

from neoworld_mjx.export import export_scene
from tests.support import scenes

SCRIPT = Path(__file__).parents[2] / "examples" / "load_in_simulators.py"
EXAMPLE = runpy.run_path(str(SCRIPT))


@pytest.fixture
def out(tmp_path):
    scene = scenes.without(scenes.blocks(), "ball")
    export_scene(scene, tmp_path)
    return tmp_path


def cells(label, out):
    return [cell.strip() for cell in EXAMPLE["row"](label, out).strip("|").split("|")]


def test_motion_failures_and_missing_simulators_are_told_apart(out, monkeypatch):
    _, version, bodies, joints, moved, turned, _ = cells("MuJoCo", out)
    assert version == mujoco.__version__ and (bodies, joints) == ("3", "0")
    assert float(moved) < 2 and float(turned) < 1

    stored = json.loads((out / "scene.json").read_text())
    stored["world_poses"]["high"]["pos"][2] += 0.05
    (out / "scene.json").write_text(json.dumps(stored))
    assert 48 < float(cells("MuJoCo", out)[4]) < 52

    (out / "scene.xml").write_text("<mujoco><wrong/></mujoco>")
    assert cells("MuJoCo", out)[2].startswith("failed: ValueError")
    monkeypatch.setitem(EXAMPLE["SIMULATORS"], "PyBullet", ("no-such-distribution", None))
    assert cells("PyBullet", out) == ["PyBullet", "not installed"]
