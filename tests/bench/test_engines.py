"""Rates of engines, and agreement of their verdicts with MuJoCo on recompiled scenes."""

import json

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from neoworld_bench.engines import throughput
from neoworld_bench.engines.table_scenes import crowded, noisy_layouts
from neoworld_bench.engines.throughput import EngineTask, engine_rows, measure
from neoworld_bench.engines.verdicts import compare, motion, naive_loop

from neoworld_mjx import cli
from neoworld_mjx.errors import EngineError
from neoworld_mjx.physics.native import NativeEngine
from tests.support.scenes import compile_scene


@pytest.fixture(scope="module")
def three():
    scene = compile_scene(crowded(3))
    return scene, noisy_layouts(scene, 48)


def test_the_loop_agrees_with_the_native_engine(three):
    scene, layouts = three
    poses = scene.place_exactly(layouts)
    loop = naive_loop(scene, layouts[:12], poses[:12])
    ours = motion(scene, NativeEngine().rollout(scene, poses[:12]))
    assert np.median(np.abs(loop.motion - ours)) < 1e-3
    # Rounding decides one of these layouts: nudged by 1e-13, the loop gives either verdict.
    assert compare(loop.motion, ours).share(near=False) >= 0.8
    assert len(naive_loop(scene, layouts, poses, budget=0.0).motion) == 1


def test_an_engine_with_wrong_verdicts_or_that_cannot_run_has_no_rate(monkeypatch):
    class Frozen:
        def rollout(self, scene, poses, **options):
            real = NativeEngine().rollout(scene, poses, duration=options["duration"])
            pos, quat = (
                jnp.broadcast_to(start[:, None], moved.shape)
                for start, moved in ((real.start.pos, real.pos), (real.start.quat, real.quat))
            )
            return eqx.tree_at(lambda r: (r.pos, r.quat), real, (pos, quat))

    task = EngineTask(engine="native", population=24)
    monkeypatch.setattr(throughput, "open_engine", lambda name: Frozen())
    (row,) = engine_rows("three", crowded(3), [task], apart=False)
    assert row.status.startswith("invalid") and row.candidates_per_s is None

    def refuses(name):
        raise EngineError("no such device")

    monkeypatch.setattr(throughput, "open_engine", refuses)
    assert measure(crowded(3), task) == "skipped: no such device"


@pytest.mark.slow
def test_the_command_prints_rates_and_agreement(capfd):
    words = "bench run engines --scenes crowded:3 --population 48 --engine native --duration 0.5"
    with pytest.raises(SystemExit, match="0"):
        cli.main([*words.split(), "--json"])
    result = json.loads(capfd.readouterr().out)
    assert result["command"].startswith("neoworld bench run engines --scenes crowded:3")
    assert result["device"] == "cpu: cpu" and {"commit", "date", "machine"} <= set(result)
    assert result["n"] == 1
    (row,) = result["rows"]
    assert row["status"] == "ok" and row["candidates_per_s"] > 0 and row["compared"] == 48
    assert row["agreement"] >= 0.95 and 0 < row["stable_share"] < 1
