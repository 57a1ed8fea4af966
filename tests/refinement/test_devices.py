"""Eight simulated devices that share the candidates give the winner of one."""

import numpy as np

from tests.support.simulated_devices import run_with_devices

SCRIPT = """
import sys

import jax
import numpy as np

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.refinement import evaluation, loop
from neoworld_mjx.refinement.finishing import compile_for_search
from neoworld_mjx.refinement.choosing import rank_candidates
from tests.support.scenes import stored_scene

used = set()
mapped = evaluation.shard


def split(tree, length):
    result = mapped(tree, length)
    for leaf in jax.tree.leaves(result):
        if isinstance(leaf, jax.Array) and not leaf.is_fully_replicated:
            used.add(len(leaf.sharding.device_set))
    return result


evaluation.shard = split
o = RefineOptions.model_validate({
    "cem": {"population": 16, "iterations": 2, "hold_resting": False, "stop_gain": 0.0},
    "settle": {"enabled": False},
    "rollout": {"engine": "native", "duration_s": 0.2, "samples_per_object": 32},
    "check_duration_s": 0.1,
})
model = compile_for_search(stored_scene("crowded_2"), o)
saved = {"devices": len(jax.local_devices())}
for name, device in (("alone", jax.local_devices()[0]), ("shared", None)):
    used.clear()
    with jax.default_device(device):
        result = loop.search(model, o, NativeEngine(threads=1), seed=1)
    index, reward = rank_candidates(result.rounds)[0]
    saved |= {
        f"{name}_index": index,
        f"{name}_reward": reward,
        f"{name}_xy": np.asarray(result.rounds[1].layouts.xy),
        f"{name}_used": sorted(used),
    }
np.savez(sys.argv[1], **saved)
"""


def test_eight_devices_give_the_winner_of_one(tmp_path):
    out = tmp_path / "found.npz"
    run_with_devices(8, SCRIPT, str(out))
    found = np.load(out)
    assert found["devices"] == 8
    assert not found["alone_used"].size and list(found["shared_used"]) == [8]
    np.testing.assert_array_equal(found["shared_index"], found["alone_index"])
    np.testing.assert_allclose(found["shared_reward"], found["alone_reward"], atol=1e-5)
    np.testing.assert_allclose(found["shared_xy"], found["alone_xy"], atol=1e-6)
