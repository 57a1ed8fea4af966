"""Candidates that share devices are simulated as on one device, without communication."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
SCRIPT = """
import sys

import equinox as eqx
import jax
import numpy as np
from neoworld_bench.engines.table_scenes import crowded, noisy_layouts

from neoworld_mjx.physics import mjx_engine
from neoworld_mjx.physics.engine import EarlyStop
from neoworld_mjx.physics.guidance import Guidance
from neoworld_mjx.physics.model import compile_scene

mjx_engine.COMPACT_FROM = 16
scene = compile_scene(crowded(1))
poses = scene.place(noisy_layouts(scene, 16))
# Those that fall stop early.
lifted = np.array(poses.pos)
lifted[3:, 1:, 2] += 0.05
poses = eqx.tree_at(lambda p: p.pos, poses, lifted)
texts = []
scan = mjx_engine.bare_scan


def compiled(model, fields, start, records, every, guidance, springs, mesh):
    lowered = scan.lower(model, fields, start, records, every, guidance, springs, mesh)
    program = lowered.compile()
    texts.append(program.as_text())
    return program(model, fields, start, springs)


mjx_engine.bare_scan = compiled
saved = {}
for count in (1, 4):
    engine = mjx_engine.MjxEngine(jax.devices()[:count])
    whole = engine.rollout(scene, poses, duration=0.2, guidance=Guidance())
    stopped = engine.rollout(
        scene, poses, duration=0.2, record_every=0.02,
        early_stop=EarlyStop(distance=1e-3, angle=1e-2, drift=2e-3, tilt=2e-2),
    )
    for name, rollout in (("whole", whole), ("stopped", stopped)):
        for field in ("pos", "status", "steps"):
            saved[f"{name}_{field}_{count}"] = np.asarray(getattr(rollout, field))
np.savez(sys.argv[1], one=texts[0], several=texts[1], **saved)
"""


@pytest.fixture(scope="module")
def rollouts(tmp_path_factory):
    out = tmp_path_factory.mktemp("sharding") / "rollouts.npz"
    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count=4"
    process = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(out)],
        env=os.environ | {"XLA_FLAGS": flags.strip(), "JAX_PLATFORMS": "cpu"},
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode == 0, process.stderr[-2000:]
    return np.load(out)


@pytest.mark.parametrize("kind", ["whole", "stopped"])
def test_four_devices_simulate_what_one_does(rollouts, kind):
    np.testing.assert_array_equal(rollouts[f"{kind}_status_4"], rollouts[f"{kind}_status_1"])
    np.testing.assert_array_equal(rollouts[f"{kind}_steps_4"], rollouts[f"{kind}_steps_1"])
    np.testing.assert_allclose(rollouts[f"{kind}_pos_4"], rollouts[f"{kind}_pos_1"], atol=1e-5)
    if kind == "stopped":
        assert len(np.unique(rollouts["stopped_steps_1"])) > 1


def test_devices_do_not_communicate_while_they_simulate(rollouts):
    assert "num_partitions=4" in str(rollouts["several"])
    assert not re.findall(r"= \S+ (all-\w+|collective-permute)", str(rollouts["several"]))
