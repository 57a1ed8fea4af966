"""The page on a loop of one's own runs as it stands, on the composed scene of the example."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from neoworld_mjx.physics.native import NativeEngine

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs/how-to/simulate-with-mjx.md"
SCENE = ROOT / "benchmarks/neoworld_bench/photographs/real/coffee.json"


@pytest.mark.slow
def test_the_pages_loop_steps_as_mujoco_does(tmp_path, monkeypatch, capsys):
    (code,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)
    assert code.count("\n") <= 20
    (tmp_path / "out").mkdir()
    shutil.copy(SCENE, tmp_path / "out" / "scene.json")
    monkeypatch.chdir(tmp_path)
    space = {}
    exec(code, space)
    scene, data = space["scene"], space["data"]
    assert space["step"]._cache_size() == 1  # A second compilation takes as long as the first.
    assert re.match(r"\d+ of 16 candidates", capsys.readouterr().out)
    theirs = NativeEngine().rollout(scene, scene.place(space["layouts"]), duration=0.1)
    free = np.flatnonzero(np.asarray(scene.movable))
    ours = np.asarray(data.qpos).reshape(16, len(free), 7)[..., :3]
    apart = np.linalg.norm(ours - np.asarray(theirs.pos)[:, -1, free], axis=-1).max(axis=1)
    assert np.median(apart) < 2e-3
