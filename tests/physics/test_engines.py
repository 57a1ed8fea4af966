import copy
import dataclasses

import jax
import mujoco
import numpy as np
import pytest

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.physics.derived import invweights
from neoworld_mjx.physics.engine import EarlyStop, RolloutStatus
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.mjx_engine import MjxEngine
from neoworld_mjx.physics.native import NativeEngine, open_batch
from neoworld_mjx.search.rewards import drifts
from tests.support import scenes
from tests.support.scenes import compile_scene, random_layout


@pytest.fixture(scope="module")
def blocks():
    return compile_scene(scenes.blocks())


def test_native_is_bit_equal_to_mj_step_on_each_candidates_model():
    for make in (scenes.blocks, scenes.coffee):
        scene = compile_scene(make())
        layouts = random_layout(scene, 3, spread=0.2)
        poses = scene.place_exactly(layouts)
        rollout = NativeEngine().rollout(scene, poses, duration=0.2)
        batch = open_batch(scene, poses)
        for k in range(3):
            model = batch.get_model(k)
            data = mujoco.MjData(model)
            data.qpos[:] = batch.bind("qpos")[k]
            for _ in range(50):
                mujoco.mj_step(model, data)
            for o, body in enumerate(scene.static.root):
                if scene.movable[o]:
                    adr = model.jnt_qposadr[model.body_jntadr[body]]
                    expected = data.qpos[adr : adr + 7]
                    assert np.array_equal(rollout.pos[k, -1, o], expected[:3])
                    assert np.array_equal(rollout.quat[k, -1, o], expected[3:])


def test_native_does_not_depend_on_threads_or_chunks(blocks, monkeypatch):
    layouts = random_layout(blocks, 7, spread=0.2)
    one = NativeEngine(threads=1).rollout(blocks, blocks.place(layouts), duration=0.2)
    monkeypatch.setattr("neoworld_mjx.physics.native.NATIVE_CHUNK", 3)
    two = NativeEngine(threads=2).rollout(blocks, blocks.place(layouts), duration=0.2)
    assert all(
        np.array_equal(a, b)
        for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(two), strict=True)
    )


def with_pyramids(scene):
    """The scene with the friction cones of the mjx engine."""
    model = copy.copy(scene.static.mjm)
    model.opt.cone, model.opt.impratio = mujoco.mjtCone.mjCONE_PYRAMIDAL, 1.0
    return dataclasses.replace(scene, static=dataclasses.replace(scene.static, mjm=model))


def test_mjx_agrees_with_native(blocks):
    layouts = random_layout(blocks, 8, spread=0.2)
    ours = MjxEngine().rollout(blocks, blocks.place(layouts), duration=0.2)
    theirs = NativeEngine().rollout(with_pyramids(blocks), blocks.place(layouts), duration=0.2)
    # 50 steps of contact in single precision; sliding blocks may part by micrometres.
    assert np.median(np.abs(ours.pos - theirs.pos).max(axis=(1, 2, 3))) < 2e-5
    # Cones and pyramids sink by different fractions of a millimetre, with the same verdicts.
    theirs = NativeEngine().rollout(blocks, blocks.place(layouts), duration=0.2)
    assert np.median(np.abs(ours.pos - theirs.pos).max(axis=(1, 2, 3))) < 1e-4
    far, _ = drifts(blocks, ours)
    far_native, _ = drifts(blocks, theirs)
    assert np.array_equal(far > 0.01, far_native > 0.01)
    assert ours.time == pytest.approx(theirs.time)
    assert ours.joint_shift.shape == theirs.joint_shift.shape == (8, 2, 0)


def test_mjx_inverse_weights_follow_mujocos(blocks):
    for scene in (blocks, compile_scene(scenes.furnished())):
        layouts = random_layout(scene, 3)
        poses = scene.place_exactly(layouts)
        found = jax.jit(invweights)(scene, poses)
        batch = open_batch(scene, poses)
        for k in range(3):
            exact = batch.get_model(k)
            for name, values in found.items():
                assert np.allclose(values[k], getattr(exact, name), rtol=2e-5), name


def stable(scene, rollout):
    bounds = RefineOptions()
    distance, angle = (np.asarray(x) for x in drifts(scene, rollout))
    still = (distance < bounds.max_drift_m) & (angle < np.radians(bounds.max_tilt_deg))
    return np.all(still | ~np.asarray(scene.movable), axis=1)


def test_early_stop_keeps_the_verdicts():
    scene = compile_scene(scenes.blocks())
    layouts = random_layout(scene, 64, seed=3, spread=0.2)
    layouts = Layout(layouts.xy * 3, layouts.yaw, layouts.log_scale)
    full = NativeEngine().rollout(scene, scene.place(layouts))
    early = NativeEngine().rollout(scene, scene.place(layouts), early_stop=EarlyStop())
    verdicts = [stable(scene, r) for r in (full, early)]
    assert 0.1 < verdicts[0].mean() < 0.95
    assert np.mean(verdicts[0] == verdicts[1]) >= 0.98
    assert early.steps.mean() < 0.3 * full.steps.mean()
    assert set(np.unique(early.status)) >= {int(RolloutStatus.SETTLED), int(RolloutStatus.DRIFTED)}


def test_joint_shifts_are_angles_and_distances_from_each_candidates_start():
    scene = compile_scene(scenes.furnished())
    static = scene.static
    assert static.joint_names == ("cabinet-slide", "cabinet-hinge", "cabinet-turn")
    assert static.joint_object.tolist() == [1, 1, 1]
    assert static.joint_slides.tolist() == [True, False, False]
    poses = scene.place_exactly(random_layout(scene, 2, spread=0.2))
    rollout = NativeEngine().rollout(scene, poses, duration=0.1, record_every=0.1)
    batch = open_batch(scene, poses)
    start = batch.bind("qpos").copy()
    batch.step(nstep=25)
    moved = np.abs(batch.bind("qpos") - start)[:, static.mjm.jnt_qposadr[static.joints]]
    assert np.allclose(rollout.joint_shift[:, 0], moved, atol=1e-7)
    assert moved.max() > 1e-4
