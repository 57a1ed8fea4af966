"""Candidates that share devices are simulated as on one device, without communication."""

import re

import numpy as np
import pytest

from tests.support.simulated_devices import run_with_devices

SCRIPT = """
import sys

import equinox as eqx
import jax
import numpy as np

from neoworld_mjx.physics import mjx_engine
from neoworld_mjx.physics.engine import EarlyStop
from neoworld_mjx.physics.guidance import Guidance
from neoworld_mjx.physics.model import compile_scene
from neoworld_mjx.spec import Sphere
from neoworld_bench.engines.table_scenes import noisy_layouts
from tests.support import scenes

(out,) = sys.argv[1:]
ball = scenes.single("ball", (Sphere(radius=0.03), (0, 0, 0)))
scene = compile_scene(scenes.on_table((ball, (0, 0), 0.0, {})))
poses = scene.place(noisy_layouts(scene, 16))
# Those that fall stop early.
lifted = np.array(poses.pos)
lifted[3:, 1:, 2] += 0.05
poses = eqx.tree_at(lambda p: p.pos, poses, lifted)
jitted, programs = mjx_engine._advance, {}


def compiled(*args):
    size = len(jax.tree.leaves(args[1])[0])
    if size not in programs:
        programs[size] = jitted.lower(*args).compile()
    return programs[size](*(args[k] for k in (0, 1, 2, 5)))


options = {
    "record_every": 0.02,
    "early_stop": EarlyStop(distance=1e-3, angle=1e-2, drift=2e-3, tilt=2e-2),
    "guidance": Guidance(),
}
saved = {}
for count in (1, 4):
    if count == 4:
        mjx_engine._advance = compiled
        # On one device the stopped candidates stay until the end.
        mjx_engine.COMPACT_FROM = 16
    engine = mjx_engine.MjxEngine(jax.devices()[:count])
    rollout = engine.rollout(scene, poses, duration=0.2, **options)
    for field in ("pos", "status", "steps"):
        saved[f"{field}_{count}"] = np.asarray(getattr(rollout, field))
np.savez(out, programs=[program.as_text() for program in programs.values()], **saved)
"""


# The last test of this file measures candidates on two devices.
@pytest.mark.slow
def test_four_devices_simulate_what_one_does_without_communication(tmp_path):
    out = tmp_path / "rollouts.npz"
    run_with_devices(4, SCRIPT, str(out))
    result = np.load(out)
    np.testing.assert_array_equal(result["status_4"], result["status_1"])
    np.testing.assert_array_equal(result["steps_4"], result["steps_1"])
    np.testing.assert_allclose(result["pos_4"], result["pos_1"], atol=1e-5)
    assert len(np.unique(result["steps_1"])) > 1
    assert len(result["programs"]) == 2
    for program in result["programs"]:
        assert "num_partitions=4" in program
        assert not re.findall(r"= \S+ (all-\w+|collective-permute)", program)


SCORING = """
import sys

import jax
import numpy as np

from neoworld_mjx.physics import placed
from neoworld_mjx.spec import Sphere
from tests.support import scenes
from tests.support.scenes import compile_scene, random_layout

placed.computes_on_cpu = lambda: False
used, shared = set(), placed.over_devices


def noted(tree):
    tree = shared(tree)
    used.update(len(x.sharding.device_set) for x in jax.tree.leaves(tree) if hasattr(x, "sharding"))
    return tree


placed.over_devices = noted
ball = scenes.single("ball", (Sphere(radius=0.03), (0, 0, 0)))
scene, saved = compile_scene(scenes.on_table((ball, (0, 0), 0.0, {})), samples=16), {}
for name, device in (("alone", jax.local_devices()[0]), ("shared", None)):
    used.clear()
    with jax.default_device(device):
        start = jax.device_get(scene.place(random_layout(scene, 4, spread=0.1)))
        found = placed.measure_in_chunks(scene, start, start)
    saved |= {f"{name}_depth": found.depth, f"{name}_boxes": found.visible.boxes}
    saved[f"{name}_used"] = max(used, default=1)
np.savez(sys.argv[1], **saved)
"""


def test_candidates_are_measured_on_all_devices_as_on_one(tmp_path):
    out = tmp_path / "found.npz"
    run_with_devices(2, SCORING, str(out))
    with np.load(out) as file:
        found = dict(file)
    assert (int(found["alone_used"]), int(found["shared_used"])) == (1, 2)
    assert np.ptp(found["alone_boxes"]) > 1.0
    np.testing.assert_allclose(found["shared_depth"], found["alone_depth"], atol=1e-6)
    np.testing.assert_allclose(found["shared_boxes"], found["alone_boxes"], atol=1e-3)
