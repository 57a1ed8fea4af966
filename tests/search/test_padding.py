"""A padded scene gives the same results, and another scene of its bucket compiles nothing."""

import jax
import numpy as np
import pytest
from jax import monitoring

from neoworld_mjx.config import RefineOptions, load_config
from neoworld_mjx.physics import model
from neoworld_mjx.physics.engine import rollout
from neoworld_mjx.physics.placed import measure_settled
from neoworld_mjx.physics.scene_arrays import pad_scene
from neoworld_mjx.search import refine
from neoworld_mjx.search.algorithm import evaluate, open_problem
from neoworld_mjx.search.cem import open_cem
from neoworld_mjx.search.evaluation import pad_rollout
from tests.support import scenes
from tests.support.scenes import compile_scene


@pytest.fixture(scope="module")
def scene():
    """Furniture with joints: boxes, hulls and slides."""
    return compile_scene(scenes.furnished(), samples=32)


def unpadded(tree, scene):
    return jax.tree.map(lambda x: np.asarray(x)[:, : scene.count], tree)


def test_padded_equals_unpadded(scene):
    o = RefineOptions()
    padded = pad_scene(scene)
    cem, wide = (open_cem(of, o.cem) for of in (scene, padded))
    key = jax.random.key(1)
    layouts, drawn = (c.ask(key, c.init(), 8) for c in (cem, wide))
    jax.tree.map(np.testing.assert_array_equal, unpadded(drawn, scene), unpadded(layouts, scene))
    one, two = (
        measure_settled(s, p := s.place(z), p) for s, z in ((scene, layouts), (padded, drawn))
    )
    moved = rollout(scene, layouts, engine="native", duration=0.2)
    first = evaluate(scene, open_problem(scene, o), layouts, moved, one)
    wide_moved = pad_rollout(jax.device_get(moved), padded)
    second = evaluate(padded, open_problem(padded, o), drawn, wide_moved, two)
    assert float(np.max(first.terms["d_pen"])) > 1e-3
    near = lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-4, atol=2e-6)
    near(one.poses.pos, np.asarray(two.poses.pos)[:, : scene.count])
    for name in first.terms:
        near(first.terms[name], second.terms[name])
    near(first.reward, second.reward)
    np.testing.assert_array_equal(first.valid, second.valid)
    np.testing.assert_array_equal(first.rests, np.asarray(second.rests)[:, : scene.count])


def toppling(scene):
    """The scene with a plate that tips over the edge of a block, so that it is searched."""
    block = scenes.block("base", (0.1, 0.1, 0.06))
    plate = scenes.block("plate", (0.1, 0.06, 0.02))
    added = scenes.on_table(
        (block, (0.2, -0.3), 0.0, {}), (plate, (0.06, 0.0), 0.0, {"parent": "base", "z": 0.06})
    ).objects[1:]
    return scene.model_copy(update={"objects": scene.objects + added})


def test_a_second_scene_compiles_nothing(monkeypatch):
    # Eviction from the in-process cache would be counted as a compilation.
    monkeypatch.setattr(model, "free_memory_maps", lambda: False)
    options = load_config(
        None,
        {
            "refine": {
                "cem": {"population": 8, "iterations": 2},
                "rollout": {"samples_per_object": 32},
            }
        },
    ).refine
    programs = []
    monitoring.register_event_duration_secs_listener(
        lambda event, _, **details: (
            programs.append(details.get("fun_name"))
            if event == "/jax/core/compile/backend_compile_duration"
            else None
        )
    )
    first = refine(toppling(scenes.furnished()), options, engine="native")
    assert first.iterations > 1 and len(programs) <= 12, programs
    programs.clear()
    second = refine(toppling(scenes.blocks()), options, engine="native")
    assert second.iterations > 1 and not programs
