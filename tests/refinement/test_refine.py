"""Algorithm 1 end to end, on the native and MJX engines."""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from neoworld_mjx.config import CEMOptions, DescentOptions, RefineOptions, RolloutOptions
from neoworld_mjx.measure import scene_measure
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.mjx_engine import MjxEngine
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.refinement import loop, refine
from neoworld_mjx.spec import Box
from neoworld_mjx.spec.pose import from_axis_angle
from tests.support import scenes


def clashing():
    """Three boxes, two of them interpenetrating and one half over the edge of another."""
    low = scenes.single("low", (Box(size=(0.1, 0.1, 0.06)), (0, 0, 0)))
    side = scenes.single("side", (Box(size=(0.08, 0.08, 0.08)), (0, 0, 0)))
    high = scenes.single("high", (Box(size=(0.05, 0.05, 0.05)), (0, 0, 0)))
    return scenes.on_table(
        (low, (0, 0), 0.0, {}),
        (side, (0.0, 0.082), 0.1, {}),
        (high, (0.049, 0.0), 0.3, {"parent": "low", "z": 0.06}),
        name="clashing",
    )


def options(population=32, iterations=6, steps=50):
    return RefineOptions(
        cem=CEMOptions(population=population, iterations=iterations),
        rollout=RolloutOptions(duration_s=steps * 0.004, samples_per_object=64),
    )


@pytest.mark.parametrize(
    "engine",
    [
        pytest.param(NativeEngine(), id="native"),
        # tests/physics compares its validity with that of the native engine.
        pytest.param(MjxEngine(), id="mjx", marks=pytest.mark.slow),
    ],
)
def test_an_invalid_scene_becomes_valid(engine):
    result = refine(clashing(), options(), seed=1, engine=engine)
    assert result.engine == engine.name
    before, after = result.before, result.measure
    assert before.s_pen == 1
    assert before.max_depth_m > 0.005
    assert result.passed
    assert after.s_pen == 0
    assert after.s_stab is True
    assert after.movable == 3
    assert after.max_depth_m < 1e-3
    plain = options().model_copy(update={"descent": DescentOptions(warm_steps=0)})
    tried = refine(clashing(), plain, seed=1, engine=engine).history
    assert not tried["xy"][0, 0].any()  # without a warm start the zero layout comes first
    assert tried["absolute"].max() > tried["absolute"][0, 0] + 0.2
    assert result.history["absolute"][0].max() > tried["absolute"][0].max()
    again = scene_measure(result.scene)
    assert again == after


def test_a_smaller_first_population_does_not_update_the_optimizer():
    means = {}
    for first in (8, 32):
        o = options(32, 2)
        cem = o.cem.model_copy(update={"first": first})
        tried = refine(clashing(), o.model_copy(update={"cem": cem}), seed=1).history
        assert np.sum(tried["status"][0] >= 0) == first
        means[first] = [tried["xy"][t, 0] for t in (0, 1)]  # The mean is the first candidate.
    np.testing.assert_array_equal(*means[8])
    assert np.abs(np.subtract(*means[32])).max() > 1e-4


def test_the_same_seed_gives_the_same_bits():
    first = refine(clashing(), options(32, 3), seed=5)
    second = refine(clashing(), options(32, 3), seed=5)
    other = refine(clashing(), options(32, 3), seed=6)
    assert first.scene.to_json() == second.scene.to_json()
    for name, values in first.history.items():
        same = np.array_equal(values, second.history[name], equal_nan=values.dtype.kind == "f")
        assert same, name
    assert not np.array_equal(first.history["xy"], other.history["xy"])


class Stubborn:
    """Reports every candidate as failed."""

    name = "stubborn"

    def rollout(self, scene, poses, **kwargs):
        found = NativeEngine().rollout(scene, poses, **kwargs)
        return eqx.tree_at(lambda r: r.status, found, jnp.full_like(found.status, 3))


def test_failure_of_every_candidate_is_reported():
    never = options(32, 2).model_copy(update={"settle": "never"})
    result = refine(clashing(), never, engine=Stubborn())
    assert not result.passed
    assert result.winner == (-1, -1)
    assert result.fallbacks
    assert result.mean_log_scale == 0.0


def test_a_valid_scene_keeps_its_layout():
    result = refine(scenes.blocks(), options(32, 4))
    assert result.passed
    assert math.isfinite(result.measure.max_drift_m)
    assert isinstance(result.layout, Layout)
    assert result.history["valid"][0, 0]


def tipping():
    """A plate that overhangs too far: it does not penetrate, but tips over in a rollout."""
    low = scenes.single("low", (Box(size=(0.1, 0.1, 0.06)), (0, 0, 0)))
    plate = scenes.single("plate", (Box(size=(0.1, 0.06, 0.02)), (0, 0, 0)))
    on_low = {"parent": "low", "z": 0.06}
    return scenes.on_table((low, (0, 0), 0.0, {}), (plate, (0.06, 0.0), 0.0, on_low), name="tips")


def test_without_simulation_only_the_final_check_detects_a_fall():
    scene = tipping()
    options = RefineOptions(
        cem=CEMOptions(population=32, iterations=2, sigma_xy=1e-4, sigma_yaw_deg=0.1),
        rollout=RolloutOptions(duration_s=0.0, samples_per_object=64),
        descent=DescentOptions(warm_steps=0),
    )
    result = refine(scene, options, seed=0)
    assert not result.passed and not result.measure.s_stab
    assert np.nanmax(result.history["d_drift"]) < 1e-6
    simulated = options.model_copy(
        update={"rollout": RolloutOptions(duration_s=0.5, samples_per_object=64)}
    )
    assert np.nanmin(refine(scene, simulated, seed=0).history["d_drift"]) > 1.0


def leaning():
    """A slab that hangs in the air by one edge, at a tilt that no layout can change."""
    slab = scenes.single("slab", (Box(size=(0.1, 0.1, 0.02)), (0, 0, 0)))
    block = scenes.single("block", (Box(size=(0.04, 0.04, 0.06)), (0, 0, 0)))
    scene = scenes.on_table((slab, (0, 0), 0.0, {}), (block, (0.0, 0.2), 0.0, {}), name="leaning")
    tilt = tuple(from_axis_angle([1, 0, 0], math.radians(8)).tolist())
    objects = [
        item.model_copy(update={"base_tilt": tilt}) if item.name == "slab" else item
        for item in scene.objects
    ]
    return scene.model_copy(update={"objects": tuple(objects)})


def test_an_unsupported_object_settles_unless_disabled():
    unsettled = refine(
        leaning(), options(32, 3, 125).model_copy(update={"settle": "never"}), seed=1
    )
    assert not unsettled.passed
    assert unsettled.measure.max_tilt_deg > 5
    settled = refine(leaning(), options(32, 3, 125), seed=1)
    assert settled.passed
    assert settled.scene.object("slab").base_tilt == (1.0, 0.0, 0.0, 0.0)
    assert "block" in settled.kept
    assert any("were settled" in line for line in settled.fallbacks)
    assert not any("were settled" in line for line in unsettled.fallbacks)
    # Settling counts as drift: 8 of 15 degrees.
    drift = settled.history["d_drift"][settled.winner]
    assert drift == pytest.approx(8 / 15, rel=0.1)


def test_if_no_candidate_passes_the_initial_layout_is_settled_unless_disabled():
    settled = refine(leaning(), options(32, 2), engine=Stubborn())
    assert settled.passed and settled.winner == (-1, -1)
    assert settled.scene.object("slab").base_tilt == (1.0, 0.0, 0.0, 0.0)
    assert any("initial scene was settled" in line for line in settled.fallbacks)
    never = options(32, 2).model_copy(update={"settle": "never"})
    assert not refine(leaning(), never, engine=Stubborn()).passed
    # A plate that topples ends up stable, but too far from its composed pose.
    assert not refine(tipping(), options(32, 2), engine=Stubborn()).passed


def test_batches_settle_until_one_candidate_is_valid_with_and_without_pruning(monkeypatch):
    monkeypatch.setattr(loop, "SETTLE_BATCH", 8)
    o = options(32, 3, 125).model_copy(update={"settle": "always"})
    runs = {}
    for prune in (True, False):
        cem = o.cem.model_copy(update={"prune": prune, "stop_gain": 0.0, "patience": 9})
        runs[prune] = refine(leaning(), o.model_copy(update={"cem": cem}), seed=1)
    scored = {k: np.isfinite(r.history["absolute"]).sum(axis=1) for k, r in runs.items()}
    assert scored[False].tolist() == [8, 8, 8]
    assert (scored[True] <= scored[False]).all() and runs[True].passed
    assert runs[True].winner == runs[False].winner
    assert (runs[True].history["xy"] == runs[False].history["xy"]).all()
