"""Eight simulated devices give the winners of one, whether they share runs or candidates."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
SCRIPT = """
import sys

import jax
import numpy as np

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.refinement import batching, loop
from neoworld_mjx.refinement.compiling import compile_for_search
from neoworld_mjx.refinement.rounds import ranked
from neoworld_mjx.refinement.search_run import SearchRun
from tests.support.scenes import stored_scene

tile, out = int(sys.argv[1]), sys.argv[2]
loop.tile_of = lambda runs, population: tile
used = set()
mapped = batching.split


def split(tree, length):
    result = mapped(tree, length)
    for leaf in jax.tree.leaves(result):
        if isinstance(leaf, jax.Array) and not leaf.is_fully_replicated:
            used.add(len(leaf.sharding.device_set))
    return result


batching.split = split
o = RefineOptions.model_validate({
    "cem": {"population": 16, "iterations": 2, "hold_resting": False, "stop_gain": 0.0},
    "settle": {"enabled": False},
    "rollout": {"engine": "native", "duration_s": 0.2, "samples_per_object": 32},
    "check_duration_s": 0.1,
})
model = compile_for_search(stored_scene("crowded_2"), o)
results = loop.search(model, [SearchRun(o, seed) for seed in range(8)], NativeEngine(threads=1))
first = [ranked(r.rounds)[0] for r in results]
np.savez(out, index=[index for index, _ in first], reward=[value for _, value in first],
         xy=[np.asarray(r.rounds[1].layouts.xy) for r in results],
         devices=len(jax.local_devices()), used=sorted(used))
"""


def searched(tmp_path, devices, tile):
    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count={devices}"
    out = tmp_path / f"{devices}_{tile}.npz"
    process = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(tile), str(out)],
        env=os.environ | {"XLA_FLAGS": flags.strip(), "JAX_PLATFORMS": "cpu"},
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode == 0, process.stderr[-2000:]
    return np.load(out)


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    found = searched(tmp_path_factory.mktemp("alone"), 1, 1)
    assert found["devices"] == 1 and not found["used"].size
    return found


@pytest.mark.parametrize("tile", [1, 8], ids=["candidates", "runs"])
def test_eight_devices_give_the_winners_of_one(alone, tmp_path, tile):
    found = searched(tmp_path, 8, tile)
    assert found["devices"] == 8 and list(found["used"]) == [8]
    np.testing.assert_array_equal(found["index"], alone["index"])
    np.testing.assert_allclose(found["reward"], alone["reward"], atol=1e-5)
    np.testing.assert_allclose(found["xy"], alone["xy"], atol=1e-6)
