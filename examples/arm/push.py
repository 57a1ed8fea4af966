"""An arm next to a scene, by MuJoCo alone: it pushes a drawer closed, in MuJoCo and in MJX.

In a folder with copies of arm.xml and world.xml:

    neoworld export chest.py --for mjx --out files    # only colliders that MJX supports
    python push.py                                    # with --mjx also in MJX

`world.xml` attaches both models and repeats the settings that attached files do not keep. All names
have prefixes: `scene-chest-slide`, `scene-chest-drawer_handle`, `arm-lift`, `arm-tip`.
"""

import sys

import mujoco
import numpy as np

model = mujoco.MjModel.from_xml_path("world.xml")
data = mujoco.MjData(model)
slide = model.joint("scene-chest-slide").qposadr[0]
arm = [model.joint(f"arm-{name}").qposadr[0] for name in ("pan", "lift", "elbow", "bend")]


def reach(x, z):
    """Return pan, lift, elbow, bend, roll and fingers with the tip at x, z and a level hand."""
    r, h = 0.75 - x - 0.17, z - 0.20
    length = np.hypot(r, h)
    inner = np.arccos((length**2 + 0.32**2 - 0.28**2) / (2 * length * 0.32))
    outer = np.arccos((length**2 - 0.32**2 - 0.28**2) / (2 * 0.32 * 0.28))
    lift = np.arctan2(r, h) - inner
    return np.array([0, lift, outer, np.pi / 2 - lift - outer, 0, 0, 0])


data.qpos[slide] = 0.12
mujoco.mj_forward(model, data)
x, _, z = data.site("scene-chest-drawer_handle").xpos
ready, pushed = reach(x + 0.06, z), reach(x - 0.12, z)
data.qpos[arm] = ready[:4]
mujoco.mj_forward(model, data)
before = data.site("arm-tip").xpos.copy()
data.ctrl[:] = ready
start = mujoco.MjData(model)
mujoco.mj_copyData(start, model, data)
while data.time < 2.5:
    data.ctrl[:] = ready + min(data.time / 2, 1) * (pushed - ready)
    mujoco.mj_step(model, data)
print(
    f"the drawer stood {1e3 * start.qpos[slide]:.0f} mm open, now {1e3 * data.qpos[slide]:.0f} mm"
)

if "--mjx" in sys.argv:
    # Collision functions are unrolled over all pairs of geoms: a scene of boxes compiles in half a
    # minute, one of many convex pieces in minutes. Use `jax.vmap` to simulate many worlds.
    import jax
    from mujoco import mjx

    world = mjx.put_model(model)
    step = jax.jit(mjx.step)
    there = mjx.put_data(model, start)
    mujoco.mj_copyData(data, model, start)
    for k in range(50):
        target = ready + k / 50 * (pushed - ready)
        data.ctrl[:] = target
        mujoco.mj_step(model, data)
        there = step(world, there.replace(ctrl=jax.numpy.array(target)))
    apart = np.abs(np.array(there.qpos) - data.qpos).max()
    print(f"after 50 steps MJX differs from MuJoCo by {apart:.1e}")
