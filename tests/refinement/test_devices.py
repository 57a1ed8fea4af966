"""Eight simulated devices give the winners of one, whether they share runs or candidates."""

import numpy as np
import pytest

from tests.support.simulated_devices import run_with_devices

SCRIPT = """
import sys

import jax
import numpy as np

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.refinement import batching, loop
from neoworld_mjx.refinement.compiling import compile_for_search
from neoworld_mjx.refinement.rounds import rank_candidates
from neoworld_mjx.refinement.search_run import SearchRun
from tests.support.scenes import stored_scene

used = set()
mapped = batching.shard


def split(tree, length):
    result = mapped(tree, length)
    for leaf in jax.tree.leaves(result):
        if isinstance(leaf, jax.Array) and not leaf.is_fully_replicated:
            used.add(len(leaf.sharding.device_set))
    return result


batching.shard = split
o = RefineOptions.model_validate({
    "cem": {"population": 16, "iterations": 2, "hold_resting": False, "stop_gain": 0.0},
    "settle": {"enabled": False},
    "rollout": {"engine": "native", "duration_s": 0.2, "samples_per_object": 32},
    "check_duration_s": 0.1,
})
model = compile_for_search(stored_scene("crowded_2"), o)
saved = {"devices": len(jax.local_devices())}
tiles = {"candidates": 1, "runs": 8}
for name, device, tile in (
    ("alone", jax.local_devices()[0], 1), ("shared", None, tiles[sys.argv[2]])
):
    used.clear()
    loop.tile_size = lambda runs, population: tile
    runs = [SearchRun(o, seed) for seed in range(8)]
    with jax.default_device(device):
        results = loop.search(model, runs, NativeEngine(threads=1))
    first = [rank_candidates(r.rounds)[0] for r in results]
    saved |= {
        f"{name}_index": [index for index, _ in first],
        f"{name}_reward": [value for _, value in first],
        f"{name}_xy": [np.asarray(r.rounds[1].layouts.xy) for r in results],
        f"{name}_used": sorted(used),
    }
np.savez(sys.argv[1], **saved)
"""


def search(shared, folder):
    """Search on one and on all devices of a process that has eight."""
    out = folder / "found.npz"
    run_with_devices(8, SCRIPT, str(out), shared)
    return np.load(out)


@pytest.mark.parametrize("shared", ["candidates", pytest.param("runs", marks=pytest.mark.slow)])
def test_eight_devices_give_the_winners_of_one(shared, tmp_path):
    found = search(shared, tmp_path)
    assert found["devices"] == 8
    assert not found["alone_used"].size and list(found["shared_used"]) == [8]
    np.testing.assert_array_equal(found["shared_index"], found["alone_index"])
    np.testing.assert_allclose(found["shared_reward"], found["alone_reward"], atol=1e-5)
    np.testing.assert_allclose(found["shared_xy"], found["alone_xy"], atol=1e-6)
