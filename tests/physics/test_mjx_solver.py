"""Newton's method and its exact line search, against C MuJoCo's solver and a fine grid."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from neoworld_mjx.physics.mjcf import to_mjspec
from neoworld_mjx.physics.mjx_model import Rows, newton, put_model
from tests.support import scenes

XML = """
<mujoco>
  <option timestep="0.004" cone="pyramidal" jacobian="dense"/>
  <worldbody>
    <geom type="plane" size="2 2 0.1"/>
    <body pos="0 0 0.048"><freejoint/><geom type="box" size="0.05 0.05 0.05"/></body>
    <body pos="0.02 0.01 0.145"><freejoint/><geom type="box" size="0.04 0.05 0.05"/></body>
    <body pos="1 0 0.5">
      <joint name="hinge" axis="0 1 0" range="-0.1 0.1" limited="true" frictionloss="0.3"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/>
      <body pos="0.3 0 0">
        <joint name="arm" axis="0 1 0" frictionloss="0.1"/>
        <geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.02"/>
      </body>
    </body>
  </worldbody>
  <equality><joint joint1="arm" joint2="hinge" polycoef="0 1 0 0 0"/></equality>
</mujoco>
"""


@pytest.fixture(scope="module", params=[0.0, 0.15, -0.3])
def stepped(request):
    """State with equality, dry friction, a limit and many contacts, some of them deep."""
    model = mujoco.MjModel.from_xml_string(XML)
    model.opt.iterations, model.opt.tolerance = 200, 1e-12
    data = mujoco.MjData(model)
    data.joint("hinge").qpos = request.param
    data.qvel[:] = np.random.default_rng(3).normal(0, 0.3, model.nv)
    mujoco.mj_forward(model, data)
    assert data.ne == 1 and data.nf == 2 and data.nefc > 30
    return model, data


def test_accelerations_are_those_of_mujoco(stepped):
    model, data = stepped
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    k, split = np.arange(data.nefc), data.ne + data.nf
    loss = np.where(k < split, data.efc_frictionloss, 0.0)
    rows = Rows(
        data.efc_J.reshape(-1, model.nv),
        data.efc_aref,
        data.efc_D,
        np.where((k >= data.ne) & (k < split), -loss, -np.inf),
        np.where(k < data.ne, np.inf, loss),
    )
    single = lambda tree: jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), tree)
    with jax.default_matmul_precision("highest"):
        solved = jax.jit(newton, static_argnames="iterations")(
            *single((rows, inertia, data.qfrc_smooth, np.zeros(model.nv))), iterations=12
        )
    qacc, force = map(np.asarray, solved)
    assert np.allclose(qacc, data.qacc, rtol=1e-3, atol=2e-3 * np.abs(data.qacc).max())
    assert np.allclose(force, data.efc_force, atol=2e-3 * np.abs(data.efc_force).max())


def test_a_scenes_elliptic_cones_become_pyramids_of_equal_impedances():
    model = to_mjspec(scenes.blocks()).compile()
    assert model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC and model.opt.impratio == 10
    lowered = put_model(model, model.key("start").qpos).mjx.opt
    assert lowered.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL
    assert float(lowered.impratio) == 1
    # The scene's own model, which other engines simulate, stays as it was.
    assert model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC and model.opt.impratio == 10


def test_environments_import_no_mjx_and_mjx_without_warp_prints_nothing():
    code = (
        "import sys, neoworld_mjx as nw; sys.modules['warp'] = None; nw.gym_env, nw.mjx_env\n"
        "print('mujoco.mjx' in sys.modules); import neoworld_mjx.physics.mjx_engine"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout == "False\n" and "warp" not in ran.stderr
