"""The page on rewards says what works: its function, named in its configuration, is used."""

import re
import sys
from pathlib import Path

import jax
import numpy as np
from neoworld_bench.engines.table_scenes import noisy_layouts

from neoworld_mjx.config import load_config
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.physics.placed import measure_in_chunks
from neoworld_mjx.search import refine
from neoworld_mjx.search.algorithm import evaluate, open_problem
from tests.support import scenes
from tests.support.scenes import compile_scene

PAGE = Path(__file__).parents[2] / "docs/how-to/write-a-reward.md"


def _blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)


def test_the_pages_term_is_short_and_is_used_from_its_config(tmp_path, monkeypatch):
    code = _blocks("python")[0]
    assert code.count("\n") <= 15
    (tmp_path / "my_rewards.py").write_text(code, encoding="utf-8")
    (tmp_path / "square.yaml").write_text(_blocks("yaml")[0], encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "my_rewards", raising=False)

    options = load_config(tmp_path / "square.yaml").refine
    scene = compile_scene(scenes.blocks())
    layouts = jax.device_put(noisy_layouts(scene, 4))
    poses = scene.place(layouts)
    rollout = NativeEngine().rollout(scene, poses, duration=0.1)
    placed = measure_in_chunks(scene, poses, poses)

    def scored(of):
        return evaluate(scene, open_problem(scene, of), layouts, rollout, placed)

    plain = options.model_copy(update={"reward": options.reward.model_copy(update={"terms": {}})})
    with_term, without = scored(options), scored(plain)
    turned = 2 * np.arctan2(rollout.quat[:, -1, :, 3], rollout.quat[:, -1, :, 0])
    expected = np.cos(4 * turned[:, 1:]).mean(axis=1)
    assert np.allclose(with_term.reward - without.reward, expected, atol=1e-4)


def test_the_pages_call_refines(tmp_path, monkeypatch):
    (tmp_path / "my_rewards.py").write_text(_blocks("python")[0], encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "my_rewards", raising=False)
    call = _blocks("python")[1]
    small = '"cem": {"population": 16, "iterations": 1}, "reward"'
    call = call.replace('"reward"', small)
    space = {"scene": scenes.blocks()}
    exec(call, space)
    # With a user's term a scene that passes is searched.
    assert space["refined"].history["reward"].shape == (1, 16)
    assert space["refine"] is refine


def test_what_the_page_lists_is_there():
    scene = compile_scene(scenes.blocks())
    layouts = noisy_layouts(scene, 2)
    rollout = NativeEngine().rollout(scene, scene.place(layouts), duration=0.1)
    given = {"scene": scene, "layouts": layouts, "rollout": rollout}
    rows = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if "| `" in line]
    named = 0
    for row in rows:
        stem = ""
        for name in re.findall(r"`([a-z_.]+)`", row.split("|")[1]):
            path = stem + name if name.startswith(".") else name
            stem = path.rsplit(".", 1)[0]
            value = given[path.split(".")[0]]
            for step in path.split(".")[1:]:
                value = getattr(value, step)
            named += 1
    assert named == 15
