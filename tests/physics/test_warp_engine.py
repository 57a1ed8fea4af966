"""The host's half of the warp engine, with C MuJoCo in the place of the worlds on a GPU."""

import sys
from types import ModuleType, SimpleNamespace
from typing import NamedTuple

import jax
import mujoco
import numpy as np
import pytest

from neoworld_mjx.cache import compiled
from neoworld_mjx.physics import warp_engine
from neoworld_mjx.physics.engine import EarlyStop, RolloutStatus
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.native import NativeEngine
from tests.support import scenes
from tests.support.scenes import compile_scene, random_layout


class Room(NamedTuple):
    worlds: int = 0
    contacts: int = 8


class Worlds:
    """As `warp_worlds.Worlds`, one MjData a world; candidates keep the composed sizes."""

    SHARED, PER_WORLD = 1, 2
    overflows: dict[int, int]

    def __init__(self, static, capacity, device):
        self.mjm, self.static, self.capacity = static.mjm, static, capacity
        self.compactions = 0

    def fitting_worlds(self):
        return 1 << 16

    def with_doubled_pool(self):
        Worlds.overflows = {}
        return Worlds(self.static, self.capacity._replace(contacts=16), None)

    def load(self, fields, qpos):
        rows, words = fields["body_pos"].shape
        assert rows >= len(qpos) and words == 3 * self.mjm.nbody
        assert np.isfinite(qpos).all()
        still = np.zeros((len(qpos), self.mjm.nv))
        self._fill(np.arange(len(qpos)), qpos, still, still)

    def compact(self, rows, qpos, qvel, qacc, *, scrub=False):
        self.compactions += 1
        self._fill(self.rows[rows], qpos, qvel, qacc)

    def _fill(self, rows, qpos, qvel, qacc):
        self.rows, self.data = rows, [mujoco.MjData(self.mjm) for _ in rows]
        for data, *state in zip(self.data, qpos, qvel, qacc, strict=True):
            data.qpos[:], data.qvel[:], data.qacc_warmstart[:] = state

    def step(self, steps):
        for data in self.data:
            mujoco.mj_step(self.mjm, data, steps)

    def read(self, *, moving=True):
        take = lambda name: np.array([getattr(d, name) for d in self.data], np.float32)
        overflow = np.array([Worlds.overflows.get(int(row), 0) for row in self.rows])
        if not moving:
            return take("qpos"), None, None, overflow
        return take("qpos"), take("qvel"), take("qacc"), overflow


@pytest.fixture
def engine(monkeypatch):
    module = ModuleType("warp_worlds")
    module.Worlds, module.probe = Worlds, lambda scene, poses: Room()
    Worlds.overflows = {}
    monkeypatch.setitem(sys.modules, "neoworld_mjx.physics.warp_worlds", module)
    monkeypatch.setattr(warp_engine, "warp_device", lambda: SimpleNamespace(is_cuda=False))
    return warp_engine.WarpEngine()


@pytest.fixture(scope="module")
def blocks():
    scene = compile_scene(scenes.blocks(), samples=16)
    layouts = random_layout(scene, 24, seed=3, spread=0.0)
    xy = layouts.xy * 3
    xy[5, 1] = np.nan
    return scene, scene.place(Layout(xy, layouts.yaw, layouts.log_scale))


@pytest.mark.parametrize("rule", [None, EarlyStop()])
def test_candidates_end_as_in_native(engine, blocks, rule):
    scene, poses = blocks
    ours = engine.rollout(scene, poses, duration=0.8, early_stop=rule)
    theirs = NativeEngine().rollout(scene, poses, duration=0.8, early_stop=rule)
    assert int(ours.status[5]) == RolloutStatus.FAILED
    assert np.array_equal(ours.status, theirs.status)
    if rule is None:
        assert np.array_equal(ours.steps, theirs.steps)
    else:
        # States come back at records alone, so rest is seen later than in native.
        assert np.all(ours.steps >= theirs.steps)
        assert np.array_equal(ours.steps < 200, theirs.steps < 200)
        assert np.mean(ours.steps < 200) > 0.9
    finite = np.arange(24) != 5
    gap = np.abs(np.asarray(ours.pos - theirs.pos))[finite].max(axis=(1, 2, 3))
    assert np.median(gap) < 1e-4
    assert ours.joint_shift.shape == (24, 8, 0)
    worlds = engine.worlds(scene, 1, poses)
    assert worlds.compactions > 0 or rule is None


def test_a_candidate_whose_constraints_do_not_fit_is_rolled_out_by_native(engine, blocks):
    scene, poses = blocks
    Worlds.overflows = {3: Worlds.PER_WORLD}
    ours = engine.rollout(scene, poses, duration=0.2)
    theirs = NativeEngine().rollout(scene, poses, duration=0.2)
    assert engine.counts == (24, 1, 0)
    assert np.array_equal(ours.pos[3], theirs.pos[3])
    assert int(ours.status[3]) == RolloutStatus.OK


def test_populations_of_few_sizes_compile_few_programs(engine, blocks):
    scene, poses = blocks
    host = jax.tree.map(np.asarray, poses)
    engine.rollout(scene, host, duration=0.1)
    before = compiled().programs
    for count in (18, 20, 23):
        Worlds.overflows = {count - 1: Worlds.PER_WORLD}
        rollout = engine.rollout(scene, host[:count], duration=0.1)
        assert rollout.pos.shape[0] == count
    assert compiled().programs == before


def test_a_full_pool_of_contacts_is_doubled(engine, blocks):
    scene, poses = blocks
    Worlds.overflows = {0: Worlds.SHARED}
    ours = engine.rollout(scene, poses, duration=0.2)
    assert engine.counts == (24, 0, 1)
    assert engine.worlds(scene, 1, poses).capacity.contacts == 16
    assert int(ours.status[0]) == RolloutStatus.OK
