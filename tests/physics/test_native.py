"""The native engine: broken candidates are statuses, and models are written over."""

import jax
import numpy as np
import pytest
from neoworld_bench.engines.table_scenes import noisy_layouts

from neoworld_mjx.physics import model, native
from neoworld_mjx.physics.engine import EarlyStop, RolloutStatus
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.spec import Box
from tests.support import scenes
from tests.support.scenes import compile_scene, stored_scene


@pytest.fixture(scope="module", params=["primitives", "meshes"])
def scene(request):
    primitives = request.param == "primitives"
    return compile_scene(scenes.blocks() if primitives else stored_scene("crowded_6"))


@pytest.mark.parametrize(
    ("field", "value"),
    [("xy", np.nan), ("yaw", np.nan), ("log_scale", np.nan), ("log_scale", -np.inf)]
    + [("log_scale", np.inf), ("log_scale", -20.0), ("xy", 1e30)],
)
def test_an_invalid_candidate_fails_without_affecting_others(scene, field, value):
    layouts = noisy_layouts(scene, 4)
    fields = {name: getattr(layouts, name).copy() for name in ("xy", "yaw", "log_scale")}
    fields[field][2, 1] = value
    rule = EarlyStop()
    broken = NativeEngine().rollout(
        scene, scene.place(Layout(**fields)), duration=0.2, early_stop=rule
    )
    clean = NativeEngine().rollout(scene, scene.place(layouts), duration=0.2, early_stop=rule)
    assert int(broken.status[2]) == RolloutStatus.FAILED
    for k in (0, 1, 3):
        assert int(broken.status[k]) == int(clean.status[k])
        assert np.array_equal(broken.pos[k], clean.pos[k])


def test_a_sleeping_object_settles_and_wakes_on_contact():
    """In the second candidate a ball falls on a block's edge when that has long come to rest."""
    scene = compile_scene(scenes.blocks())
    still = jax.tree.map(np.array, scene.place(Layout.zero(2, len(scene.names))))
    block, ball = scene.names.index("high"), scene.names.index("ball")
    still.pos[1, ball] = still.pos[1, block] + np.float32([0.03, 0.0, 0.8])
    rule = EarlyStop(drift=1e3, tilt=1e3, linger=1e3)
    early = NativeEngine().rollout(scene, still, early_stop=rule)
    full = NativeEngine().rollout(scene, still)
    assert int(early.status[0]) == RolloutStatus.SETTLED and int(early.steps[0]) < 100
    np.testing.assert_allclose(early.pos[0, -1], full.pos[0, -1], atol=1e-3)
    for rollout in (early, full):
        aside = np.abs(np.asarray(rollout.pos)[1, :, block] - still.pos[1, block])[:, :2]
        assert aside[1].max() < 1e-5 and aside.max() > 5e-4


def test_overwritten_models_equal_fresh_copies(monkeypatch):
    scene = compile_scene(stored_scene("crowded_6"))
    first, second = noisy_layouts(scene, 6, seed=1), noisy_layouts(scene, 4, seed=2)
    NativeEngine().rollout(scene, scene.place(first), duration=0.1)
    again = NativeEngine().rollout(scene, scene.place(second), duration=0.1)
    # Another compilation of the scene has no copies yet; chunks of 3 overwrite them once.
    monkeypatch.setattr(native, "NATIVE_CHUNK", 3)
    other = model.compile_scene(stored_scene("crowded_6"))
    fresh = NativeEngine().rollout(other, other.place(second), duration=0.1)
    for a, b in zip(jax.tree.leaves(again), jax.tree.leaves(fresh), strict=True):
        assert np.array_equal(a, b)


@pytest.mark.parametrize("sleeps", [True, False])
@pytest.mark.parametrize("meshes", [True, False])
@pytest.mark.parametrize("fixed", [True, False])
def test_an_object_stands_at_the_height_of_a_support_of_another_size(sleeps, meshes, fixed):
    """Fixed bodies sleep from the start, so MuJoCo would leave their geoms where they were."""
    boards = [(Box(size=(0.3, 0.3, 0.02)), (0.0, 0.0, z)) for z in (0.01, 0.41)]
    posts = [
        (Box(size=(0.02, 0.02, 0.4)), (x, y, 0.21)) for x in (-0.14, 0.14) for y in (-0.14, 0.14)
    ]
    shelf, cube = scenes.single("shelf", *boards, *posts), scenes.single("cube", *boards[:1])
    world = scenes.on_table((shelf, (0.0, 0.0), 0.0, {"fixed_base": fixed}))
    top = scenes.SceneObject(name="cube", spec=cube, parent="shelf", z=0.4201)
    if meshes:
        extra = scenes.SceneObject(name="cup", spec=scenes.cup(), parent="table", xy=(0.0, 0.3))
        world = world.model_copy(update={"objects": (*world.objects, extra)})
    scene = compile_scene(world.model_copy(update={"objects": (*world.objects, top)}))
    assert native.has_meshes(scene) == meshes
    k = [scene.names.index(name) for name in ("shelf", "cube")]
    layouts = jax.tree.map(np.array, Layout.zero(3, len(scene.names)))
    layouts.log_scale[:, k[0]] = -0.05, 0.0, 0.05
    start = scene.place(layouts)
    rollout = NativeEngine().rollout(
        scene, start, duration=0.5, early_stop=EarlyStop(after=0.4) if sleeps else None
    )
    np.testing.assert_allclose(rollout.pos[:, -1, k], start.pos[:, k], atol=1e-3)
