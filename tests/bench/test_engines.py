"""Rates of engines, and agreement of their verdicts with MuJoCo on recompiled scenes."""

import json
import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from neoworld_bench.engines import throughput
from neoworld_bench.engines.table_scenes import Noise, crowded, noisy_layouts
from neoworld_bench.engines.throughput import EngineTask, engine_rows, measure
from neoworld_bench.engines.verdicts import compare, motion, naive_loop

from neoworld_mjx import cli
from neoworld_mjx.errors import EngineError
from neoworld_mjx.physics.engine import RolloutStatus
from neoworld_mjx.physics.native import NativeEngine
from tests.support.scenes import compile_scene


@pytest.fixture(scope="module")
def three():
    scene = compile_scene(crowded(3))
    return scene, noisy_layouts(scene, 48)


def test_scenes_and_layouts_are_deterministic(three):
    assert crowded(6).to_json() == crowded(6).to_json() != crowded(6, seed=1).to_json()
    assert len(crowded(40).objects) == 41 and crowded(40).objects[0].environment
    scene, layouts = three
    subset = noisy_layouts(scene, 5)
    assert np.array_equal(subset.xy, layouts.xy[:5])
    assert not subset.xy[:, 0].any(), "the table stays"
    bounded = noisy_layouts(scene, 50, noise=Noise(scales=(0.7, 1.4)))
    assert math.log(0.7) <= bounded.log_scale.min() < bounded.log_scale.max() <= math.log(1.4)


def test_a_share_of_noisy_layouts_fails_and_none_without_noise(three):
    scene, layouts = three
    stable = np.mean(motion(scene, NativeEngine().rollout(scene, scene.place(layouts))) < 1)
    assert 0.2 <= stable <= 0.6
    ten = compile_scene(crowded(10))
    still = ten.place(noisy_layouts(ten, 1, noise=Noise(0, 0, 0)))
    assert motion(ten, NativeEngine().rollout(ten, still)) < 0.1


def test_the_loop_agrees_with_the_native_engine(three):
    scene, layouts = three
    poses = scene.place_exactly(layouts)
    loop = naive_loop(scene, layouts[:12], poses[:12])
    ours = motion(scene, NativeEngine().rollout(scene, poses[:12]))
    assert np.median(np.abs(loop.motion - ours)) < 1e-3
    # Rounding decides one of these layouts: nudged by 1e-13, the loop gives either verdict.
    assert compare(loop.motion, ours).share(near=False) >= 0.8
    assert len(naive_loop(scene, layouts, poses, budget=0.0).motion) == 1


def test_borderline_verdicts_are_determined_by_the_reference():
    compared = compare(np.array([0.1, 0.6, 1.9, 5.0]), np.array([0.1, 1.2, 1.8, 0.9]))
    assert compared.near.tolist() == [False, True, True, False]
    assert (compared.share(near=False), compared.share(near=True)) == (0.5, 0.5)


def test_motion_of_a_failed_candidate_is_infinite(three):
    scene, _ = three
    broken = noisy_layouts(scene, 2)
    broken.xy[1, 1] = np.nan
    rollout = NativeEngine().rollout(scene, scene.place(broken), duration=0.1)
    assert motion(scene, rollout)[1] == np.inf and rollout.status[1] == RolloutStatus.FAILED


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
