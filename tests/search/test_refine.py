"""Algorithm 1 end to end, on the native and MJX engines."""

import math

import equinox as eqx
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from neoworld_mjx.config import CEMOptions, RefineOptions, RolloutOptions, SettleOptions
from neoworld_mjx.errors import ConfigError
from neoworld_mjx.measure import measured
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.mjx_engine import MjxEngine
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.search import refine
from neoworld_mjx.spec import world_poses
from tests.support import scenes

UNSETTLED = SettleOptions(enabled=False)


def toppling():
    """A plate whose center is 1 cm beyond its support's edge, and a tower that stands."""
    on_low = {"parent": "low", "z": 0.06}
    return scenes.on_table(
        (scenes.block("low", (0.1, 0.1, 0.06)), (0, 0), 0.0, {}),
        (scenes.block("plate", (0.1, 0.06, 0.02)), (0.06, 0.0), 0.0, on_low),
        (scenes.block("base"), (0.0, -0.25), 0.2, {}),
        (scenes.block("top", (0.04, 0.04, 0.04)), (0.0, 0.0), 0.0, {"parent": "base", "z": 0.06}),
        name="toppling",
    )


def clashing():
    """Two boxes that interpenetrate, and one half over the edge of another."""
    return scenes.on_table(
        (scenes.block("low", (0.1, 0.1, 0.06)), (0, 0), 0.0, {}),
        (scenes.block("side", (0.08, 0.08, 0.08)), (0.0, 0.082), 0.1, {}),
        (scenes.block("high", (0.05, 0.05, 0.05)), (0.049, 0.0), 0.3, {"parent": "low", "z": 0.06}),
        name="clashing",
    )


def unreachable():
    """A picture that hangs in the air, and a box."""
    picture = {"relation": "attached", "z": 0.8}
    return scenes.on_table(
        (scenes.block("box"), (0.0, 0.1), 0.0, {}),
        (scenes.block("picture", (0.02, 0.2, 0.2)), (0.0, -0.2), 0.0, picture),
        name="unreachable",
    )


def options(population=32, iterations=6, steps=100, **cem):
    return RefineOptions(
        cem=CEMOptions(population=population, iterations=iterations, **cem),
        rollout=RolloutOptions(duration_s=steps * 0.004, samples_per_object=32),
        check_duration_s=0.5,
    )


def unsettled(*args, **cem):
    return options(*args, **cem).model_copy(update={"settle": UNSETTLED})


ENGINES = [
    pytest.param(NativeEngine(), id="native"),
    # tests/physics compares its validity with that of the native engine.
    pytest.param(MjxEngine(), id="mjx", marks=pytest.mark.slow),
]


@pytest.mark.parametrize("engine", ENGINES)
def test_an_object_that_topples_is_moved_onto_its_support(engine):
    result = refine(toppling(), options(), seed=1, engine=engine)
    assert result.engine == engine.name
    assert not result.before.s_stab or "plate" not in result.kept
    assert result.passed and result.measure.s_stab and result.measure.movable == 4
    assert result.winner[0] >= 0
    assert set(result.kept) == {"low", "base", "top"}
    # The stored scene measures the same when it is compiled at its own sizes, but for rounding.
    again = measured(result.scene, RefineOptions(check_duration_s=0.5))
    for name in ("max_depth_m", "settled_depth_m", "max_drift_m", "max_tilt_deg"):
        assert getattr(again, name) == pytest.approx(getattr(result.measure, name), abs=1e-9)
    assert max(result.measure.displacement.values()) <= 1.0
    poses = world_poses(result.scene)
    assert poses["plate"].pos[2] == pytest.approx(0.06, abs=1e-3)
    assert abs(poses["plate"].pos[0] - poses["low"].pos[0]) < 0.055


def test_overlapping_objects_come_apart_without_a_search():
    scene = clashing()
    assert measured(scene, RefineOptions(check_duration_s=0.1)).max_depth_m > 0.005
    result = refine(scene, options(), engine="native")
    assert result.passed and result.rollouts == 0 and result.winner == (-1, -1)
    assert result.measure.max_depth_m < 1e-3


@pytest.fixture
def compiled(monkeypatch):
    """The MuJoCo specifications that are compiled."""
    compiled, original = [], mujoco.MjSpec.compile
    monkeypatch.setattr(
        mujoco.MjSpec, "compile", lambda spec: compiled.append(spec) or original(spec)
    )
    return compiled


def test_a_scene_that_passes_is_compiled_once_and_not_scored(compiled):
    result = refine(scenes.blocks(), options(), engine="native")
    assert result.passed and len(compiled) == 1
    with pytest.raises(ConfigError, match=r"refine\.optimizer: 'cme' is unknown"):
        refine(scenes.blocks(), options().model_copy(update={"optimizer": "cme"}), engine="native")


def test_a_searched_scene_is_compiled_once_more_for_each_use(compiled):
    """Once for all final checks, once for the search, and once with the objects that are held."""
    searched = refine(unreachable(), options(32, 2), engine="native")
    assert searched.iterations == 2 and searched.finalists_tried == 4 and len(compiled) == 3
    assert searched.measure.held


@pytest.mark.parametrize("scene", [scenes.blocks(), scenes.furnished()], ids=["blocks", "cabinet"])
def test_a_scene_that_passes_needs_no_iteration(scene):
    lines = []
    o = options(32, 4).model_copy(update={"check_duration_s": 2.0})
    result = refine(scene, o, engine="native", progress=lines.append)
    assert result.passed and result.iterations == 0 and result.rollouts == 0 and not result.scores
    assert result.winner == (-1, -1) and result.finalists_tried == 0
    assert isinstance(result.layout, Layout)
    assert not any(np.asarray(leaf).any() for leaf in (result.layout.xy, result.layout.yaw))
    moving = [item.name for item in scene.objects if not item.environment]
    assert list(result.kept) == moving
    assert lines == [f"all {len(moving)} objects rest where they were placed"]
    assert math.isfinite(result.measure.max_drift_m)


def test_the_same_seed_gives_the_same_bits():
    first = refine(toppling(), options(32, 2), seed=5)
    second = refine(toppling(), options(32, 2), seed=5)
    other = refine(toppling(), options(32, 2), seed=6)
    assert first.scene.to_json() == second.scene.to_json()
    for name, values in first.history.items():
        same = np.array_equal(values, second.history[name], equal_nan=values.dtype.kind == "f")
        assert same, name
    assert not np.array_equal(first.history["xy"], other.history["xy"], equal_nan=True)


class Stubborn:
    """Reports every candidate as failed."""

    name = "stubborn"

    def rollout(self, scene, poses, **kwargs):
        found = NativeEngine().rollout(scene, poses, **kwargs)
        return eqx.tree_at(lambda r: r.status, found, jnp.full_like(found.status, 3))


def test_failure_of_every_candidate_is_reported():
    result = refine(toppling(), unsettled(32, 2), engine=Stubborn())
    assert not result.passed and result.winner == (-1, -1) and result.scores == {}
    assert result.fallbacks and result.mean_log_scale == 0.0
    result = refine(toppling(), options(32, 2), engine=Stubborn())
    assert not result.passed and result.winner == (-1, -1)
    (line,) = result.fallbacks
    assert line.startswith("no candidate passed the final check in 0 tries: ")
    assert "fixed in place, since it does not rest there" in line and "did not pass" in repr(result)


def test_an_object_that_rests_nowhere_is_searched_ever_farther_away():
    result = refine(unreachable(), options(32, 4), engine="native")
    assert not result.passed and result.iterations == 4
    k = result.history["object_names"].tolist().index("picture")
    spread = np.nanstd(result.history["xy"][:, :, k], axis=(1, 2))
    np.testing.assert_allclose(spread[1:] / spread[:-1], 2.0, rtol=0.25)


def test_the_winner_is_the_valid_candidate_of_largest_reward_that_passes():
    result = refine(toppling(), options(32, 3, stop_gain=0.0), seed=1, engine="native")
    history = result.history
    assert result.passed and history["valid"].sum() > 5
    ranked = np.argsort(-np.where(history["valid"], history["reward"], -np.inf), axis=None)
    place = np.ravel_multi_index(result.winner, history["valid"].shape)
    assert ranked[result.finalists_tried - 1] == place
    assert result.scores["reward"] == history["reward"][result.winner]
    assert result.scores.keys() == {"reward", "valid", "s_sem", "prior", "d_pen", "d_drift"}
