"""Runs are tiled, padded, stacked and taken apart again, and each keeps its values."""

from types import SimpleNamespace

import jax
import numpy as np
import pytest

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.physics.engine import Rollout
from neoworld_mjx.physics.layout import Poses
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.physics.scene_arrays import Bucket, pad_objects, pad_scene
from neoworld_mjx.physics.sharding import REPLICATED, SHARDED
from neoworld_mjx.refinement import batching
from neoworld_mjx.refinement.batching import (
    MAX_BATCH_SIZES,
    concatenate_candidates,
    early_stop_rule,
    map_runs,
    pad_rollout,
    roll_out,
    settle_candidates,
    shard,
    stack,
    take,
    tile_size,
    with_replaced,
)
from tests.support import scenes
from tests.support.scenes import compile_scene

ENGINE = NativeEngine(threads=1)


@pytest.fixture(scope="module")
def model():
    return compile_scene(scenes.blocks(), samples=16)


def options(**rollout):
    given = {"duration_s": 0.1, "record_every_s": 0.05, **rollout}
    return RefineOptions.model_validate({"rollout": given, "settle": {"duration_s": 0.2}})


def placed(model, pop, seed=0):
    """Poses of random layouts, padded by two objects."""
    poses = jax.device_get(model.place(scenes.random_layout(model, pop, seed=seed)))
    return pad_objects(poses, model.count + 2)


def assert_equal(a, b):
    jax.tree.map(np.testing.assert_array_equal, a, b)


@pytest.mark.parametrize(
    "runs, population, count, tile",
    [
        (100, 1024, 1, 8),
        (5, 1024, 1, 5),
        (100, 3 * 8192, 1, 1),
        (100, 1024, 2, 16),
        (5, 1024, 2, 6),
        (6, 1024, 2, 6),
        (1, 8, 4, 1),
        (2, 8, 4, 4),
    ],
)
def test_a_tile_fills_every_device_evenly(monkeypatch, runs, population, count, tile):
    monkeypatch.setattr(batching, "devices", lambda: [None] * count)
    assert tile_size(runs, population) == 1, "on a CPU, runs are computed one by one"
    monkeypatch.setattr(batching, "computes_on_cpu", lambda: False)
    assert tile_size(runs, population) == tile


def test_work_stays_on_the_device_that_jax_is_told_to_use():
    assert batching.devices() == jax.local_devices()
    with jax.default_device(jax.local_devices()[0]):
        assert batching.devices() == jax.local_devices()[:1]


def test_arrays_of_the_split_length_are_divided_and_others_copied(monkeypatch):
    tree = {"part": np.zeros((4, 2)), "whole": np.zeros(3), "number": np.float32(1), "name": "x"}
    assert shard(tree, 4) is tree, "a single device keeps everything"
    monkeypatch.setattr(batching, "device_mesh", lambda devices: SimpleNamespace(size=2))
    monkeypatch.setattr(batching, "put", lambda array, mesh, spec: spec)
    divided = shard(tree, 4)
    assert divided == {"part": SHARDED, "whole": REPLICATED, "number": REPLICATED, "name": "x"}
    for length in (3, 5, 0, -2):
        assert shard(tree, length) is tree
    assert shard({"two": np.zeros(2)}, 2) == {"two": SHARDED}


@pytest.mark.parametrize("tile", [1, 2, 3, 5, 8])
@pytest.mark.parametrize("count", [1, 5])
def test_the_rows_of_runs_are_mapped_in_order_whatever_the_tile(model, tile, count):
    traced = []

    def weighted(scene, x, y):
        traced.append(x.shape)
        assert isinstance(x, jax.core.Tracer) == (tile > 1 and count > 1)
        return {"sum": scene.diagonal[1] * x + y}

    rows = [(np.arange(3.0) + k, np.full(3, 10.0 * k)) for k in range(count)]
    results = map_runs(weighted, model, rows, tile)
    assert len(results) == count
    for result, (x, y) in zip(results, rows, strict=True):
        np.testing.assert_allclose(result["sum"], model.diagonal[1] * x + y, rtol=1e-6)
    assert min(tile, count) == 1 or len(traced) == 1, "the last tile is padded, not compiled again"


def test_trees_are_stacked_on_a_leading_axis():
    rows = [{"x": np.arange(2.0) + k, "fn": np.sin} for k in range(3)]
    stacked = stack(rows)
    np.testing.assert_array_equal(stacked["x"], [[0, 1], [1, 2], [2, 3]])
    assert stacked["fn"] is np.sin
    for other in ({"y": np.zeros(2), "fn": np.sin}, {"x": np.zeros(2)}):
        with pytest.raises(ValueError, match="stack: the trees differ in structure"):
            stack([rows[0], other])
        with pytest.raises(ValueError, match="differ in structure"):
            stack([rows[0], rows[1], other])


def test_candidates_are_taken_joined_and_replaced():
    tree = {"x": np.arange(6).reshape(3, 2)}
    assert_equal(take(tree, slice(1, 3)), {"x": [[2, 3], [4, 5]]})
    assert_equal(take(tree, np.array([2, 0])), {"x": [[4, 5], [0, 1]]})
    assert_equal(
        concatenate_candidates([take(tree, slice(1)), take(tree, slice(2, 3))]),
        {"x": [[0, 1], [4, 5]]},
    )
    whole = np.zeros((2, 3))
    assert_equal(with_replaced(whole, np.ones((2, 2)), np.s_[:, :2]), [[1, 1, 0], [1, 1, 0]])
    assert not whole.any(), "the array that was given is unchanged"


@pytest.mark.parametrize(
    "counts, runs, rows",
    [
        ((4,), 1, 4),
        ((4, 3), 2, 8),
        ((4, 4, 4), 5, 12),
        ((4, 4), 5, 8),
        ((4,), 5, 4),
        ((4, 4), 64, 8 * 4),
    ],
)
def test_runs_are_concatenated_to_few_shapes(counts, runs, rows):
    assert MAX_BATCH_SIZES == 4
    poses = [
        Poses(*(np.full((n, 5, *last), k + 1.0) for last in ((3,), (4,), (), ())))
        for k, n in enumerate(counts)
    ]
    together, slices = batching._concatenate(poses, 3, runs)
    assert together.pos.shape == (rows, 3, 3) and together.scale.shape == (rows, 3)
    for k, index in enumerate(slices):
        assert index.stop - index.start == counts[k]
        for leaf in jax.tree.leaves(together):
            assert (leaf[index] == k + 1.0).all()
    for leaf in jax.tree.leaves(together):
        assert np.isnan(leaf[sum(counts) :]).all(), "no engine simulates what only fills up"


class Noted(NativeEngine):
    """Notes the arguments of each rollout."""

    def __init__(self):
        super().__init__(threads=1)
        self.calls = []

    def rollout(self, scene, poses, **given):
        self.calls.append((poses, given))
        return super().rollout(scene, poses, **given)


def test_a_rollout_of_several_runs_gives_each_its_own(model):
    runs, o = [placed(model, 3, 1), placed(model, 2, 2)], options(early_stop=False)
    engine = Noted()
    together = roll_out(model, runs, engine, o, 2)
    ((_, given),) = engine.calls
    assert given == {"duration": 0.1, "record_every": 0.05, "early_stop": None}
    for poses, rollout in zip(runs, together, strict=True):
        (alone,) = roll_out(model, [poses], ENGINE, o, 1)
        assert_equal(rollout, alone)
        assert rollout.pos.shape == (len(poses.scale), 2, model.count, 3)
        np.testing.assert_allclose(rollout.time, [0.048, 0.096])
    roll_out(model, runs, engine, options(early_stop=True), 2)
    assert engine.calls[-1][1]["early_stop"] == early_stop_rule(o)


def test_without_a_duration_nothing_moves_and_no_engine_is_called(model):
    poses, engine = placed(model, 2), Noted()
    (rollout,) = roll_out(model, [poses], engine, options(duration_s=0.0), 1)
    assert not engine.calls and not rollout.steps.any()
    np.testing.assert_array_equal(rollout.pos[:, 0], poses.pos[:, : model.count])


def test_settling_several_runs_gives_each_its_own_and_leaves_padding(model):
    runs, o = [placed(model, 3, 1), placed(model, 2, 2)], options()
    together = settle_candidates(model, runs, ENGINE, o, 2)
    for poses, rest in zip(runs, together, strict=True):
        (alone,) = settle_candidates(model, [poses], ENGINE, o, 1)
        assert_equal(rest, alone)
        padding = lambda x: x[:, model.count :]
        assert_equal(jax.tree.map(padding, rest), jax.tree.map(padding, poses))
        shift = np.abs(rest.pos - poses.pos)[:, : model.count].max(axis=(1, 2))
        assert (shift > 1e-6).all() and np.isfinite(rest.pos).all()


def test_objects_and_joints_that_pad_a_rollout_do_not_move():
    scene = compile_scene(scenes.furnished(), samples=16)
    wide = pad_scene(scene, Bucket(*(64,) * len(Bucket._fields)))
    poses = placed(scene, 2)
    (rollout,) = roll_out(scene, [poses], ENGINE, options(), 1)
    padded = pad_rollout(rollout, wide)
    joints = rollout.joint_shift.shape[2]
    assert padded.pos.shape == (2, 2, 64, 3) and padded.joint_shift.shape == (2, 2, 64)
    np.testing.assert_array_equal(padded.pos[:, :, : scene.count], rollout.pos)
    np.testing.assert_array_equal(padded.quat[:, :, : scene.count], rollout.quat)
    np.testing.assert_array_equal(padded.joint_shift[..., :joints], rollout.joint_shift)
    assert joints and not padded.joint_shift[..., joints:].any()
    for name in ("pos", "quat"):
        still = getattr(padded, name)[:, :, scene.count :]
        start = getattr(padded.start, name)[:, None, scene.count :]
        np.testing.assert_array_equal(still, np.broadcast_to(start, still.shape))
    same = lambda r: (r.time, r.status, r.steps)
    assert isinstance(padded, Rollout)
    assert_equal(same(padded), same(rollout))


def test_a_rollout_stops_where_the_penalty_of_drift_is_capped():
    reward = {"drift_scale_m": 0.02, "tilt_scale_deg": 9.0, "d_drift_cap": 4.0}
    rule = early_stop_rule(RefineOptions.model_validate({"reward": reward}))
    assert (rule.distance, rule.drift) == pytest.approx((0.02, 0.08))
    assert (rule.angle, rule.tilt) == pytest.approx((np.radians(9.0), np.radians(36.0)))
