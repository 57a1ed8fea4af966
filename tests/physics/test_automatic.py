"""`auto`: which engine rolls out, what it learns, and what it keeps on the machine."""

import json

import pytest

from neoworld_mjx import cache
from neoworld_mjx.config import RefineOptions
from neoworld_mjx.engines import share_gpu_memory
from neoworld_mjx.errors import EngineError
from neoworld_mjx.physics import automatic, engine_costs
from neoworld_mjx.physics.automatic import AutomaticEngine
from neoworld_mjx.physics.engine import zero_duration_rollout
from neoworld_mjx.physics.engine_costs import EngineCost, prior_costs, read_costs, write_costs
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.settling import with_damped_joints
from neoworld_mjx.refinement import scene_refinement
from neoworld_mjx.refinement.scene_refinement import refine
from tests.support import scenes
from tests.support.scenes import compile_scene


@pytest.fixture(autouse=True)
def _own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv(cache.VARIABLE, str(tmp_path))


class Timed:
    """An engine whose rollouts take as long as they say, by a clock of its own."""

    def __init__(self, name, clock, fixed, each):
        self.name, self.clock, self.fixed, self.each = name, clock, fixed, each
        self.sizes = []

    def rollout(self, scene, poses, **options):
        pop = poses.scale.shape[0]
        self.sizes.append(pop)
        self.clock[0] += self.fixed + self.each * pop
        return zero_duration_rollout(scene, poses)


def test_a_scene_with_damped_joints_counts_as_started_with_its_scene(clock):
    scene = compile_scene(scenes.furnished(), samples=16)
    assert with_damped_joints(scene).static is not scene.static
    warp, mjx = Timed("warp", clock, 20.0, 0.001), Timed("mjx", clock, 0.0, 0.001)
    engine = AutomaticEngine({"warp": warp, "mjx": mjx})
    engine.rollout(scene, place(scene, 8))
    engine.rollout(with_damped_joints(scene), place(scene, 8))
    assert (len(warp.sizes), len(mjx.sizes)) == (2, 0)


class Refusing(Timed):
    def rollout(self, scene, poses, **options):
        raise EngineError("no such collision")


@pytest.fixture
def clock(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(automatic.time, "perf_counter", lambda: now[0])
    return now


def place(scene, pop):
    return scene.place(Layout.zero(pop, len(scene.names)))


def test_small_populations_run_on_the_cpu_and_large_ones_on_the_accelerator(blocks_model, clock):
    native, warp = Timed("native", clock, 0.0, 0.01), Timed("warp", clock, 1.0, 0.0001)
    engine = AutomaticEngine({"warp": warp, "native": native})
    assert engine.name == "auto"
    engine.rollout(blocks_model, place(blocks_model, 4))
    assert (native.sizes, warp.sizes) == ([4], [])
    for _ in range(3):
        engine.rollout(blocks_model, place(blocks_model, 5000))
    assert warp.sizes, "what was measured says that warp is faster there"
    assert engine.name == "native+warp"
    before = list(native.sizes)
    engine.rollout(blocks_model, place(blocks_model, 4))
    assert native.sizes == [*before, 4]


def test_measured_costs_are_stored(blocks_model, clock):
    slow = Timed("native", clock, 0.0, 5.0)
    fast = Timed("warp", clock, 0.001, 0.0)
    engine = AutomaticEngine({"warp": fast, "native": slow})
    for _ in range(30):
        engine.rollout(blocks_model, place(blocks_model, 4))
    assert fast.sizes, "starting warp costs less than going on"
    another = AutomaticEngine({"warp": fast, "native": slow})
    number = len(slow.sizes)
    another.rollout(blocks_model, place(blocks_model, 4))
    assert len(slow.sizes) == number


def test_an_engine_that_refuses_a_scene_is_reported_and_not_tried_again(blocks_model, clock):
    refusing = Refusing("warp", clock, 0.0, 0.0)
    native = Timed("native", clock, 100.0, 0.0)
    engine = AutomaticEngine({"warp": refusing, "native": native})
    engine._costs["warp"] = EngineCost(0.0, ((1, 1e-6),))
    for _ in range(2):
        engine.rollout(blocks_model, place(blocks_model, 2))
    assert engine.refusals == ["warp cannot simulate this scene: no such collision"]
    assert native.sizes == [2, 2]
    with pytest.raises(EngineError, match="no such collision"):
        AutomaticEngine({"warp": refusing}).rollout(blocks_model, place(blocks_model, 2))


def test_costs_are_interpolated_and_extrapolated():
    cost = EngineCost(3.0, ((1, 1.0), (100, 2.0)))
    assert cost.predict("any", 1, 250, started=True) == 1.0
    assert cost.predict("any", 200, 250, started=True) == 4.0
    assert cost.predict("any", 100, 500, started=False) == 7.0
    cost.add("any", 10, 125, 0.25, started=True)
    assert cost.predict("any", 10, 250, started=True) == 0.5
    cost.add("any", 10, 250, 9.5, started=False)
    assert cost.start_s == pytest.approx(3.0 + 0.3 * (9.0 - 3.0))


def test_cached_compilation_is_not_a_starting_cost():
    cost = EngineCost(3.0, ((1, 1.0), (100, 1.0)))
    cost.add("new", 10, 250, 200.0, started=False)
    assert cost.start_s == 3.0
    cost.add("new", 10, 250, 2.0, started=False)
    assert cost.start_s == pytest.approx(3.0 + 0.3 * (1.0 - 3.0))


@pytest.mark.parametrize(
    "text",
    ["", "[1]", '{"m": 3}', '{"m": {"warp": {"start_s": "x", "tables": {}}}}', "[" * 100_000]
    + ['{"m": {"warp": {"start_s": -1, "tables": {}}}}']
    + ['{"m": {"warp": {"start_s": 1, "tables": {"a": {"-4": 1}}}}}']
    + ['{"m": {"warp": {"start_s": 1, "tables": {"a": {"4": NaN}}}}}']
    + ['{"m": {"who": {"start_s": 1, "tables": {}}}}'],
)
def test_an_invalid_cost_file_is_ignored(tmp_path, text):
    (tmp_path / engine_costs.COST_FILE).write_text(text)
    assert read_costs("m", 2) == prior_costs(2)


def test_costs_are_stored_by_machine(tmp_path):
    costs = prior_costs(2)
    costs["warp"].add("a", 8, 250, 0.125, started=True)
    write_costs("one", costs)
    write_costs("two", prior_costs(2))
    assert read_costs("one", 2) == costs
    assert read_costs("two", 2) == prior_costs(2)
    assert set(json.loads((tmp_path / engine_costs.COST_FILE).read_text())) == {"one", "two"}


def test_an_unwritable_folder_is_no_error(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv(cache.VARIABLE, str(tmp_path / "file" / "below"))
    write_costs("one", prior_costs(2))
    assert read_costs("one", 2) == prior_costs(2)


@pytest.mark.parametrize(("installed", "expected"), [(True, "false"), (False, None)])
def test_jax_leaves_memory_to_warp(monkeypatch, installed, expected):
    import importlib.util
    import os

    variable = "XLA_PYTHON_CLIENT_PREALLOCATE"
    monkeypatch.delenv(variable, raising=False)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: installed or None)
    share_gpu_memory()
    assert os.environ.get(variable) == expected
    monkeypatch.setenv(variable, "true")
    share_gpu_memory()
    assert os.environ[variable] == "true"


@pytest.mark.parametrize(
    ("cem", "opened"),
    [
        ({}, "native"),
        ({"population": 4096}, "auto"),
        ({"population": 256}, "native"),
        ({"population": 257}, "auto"),
    ],
)
def test_a_refinement_of_few_candidates_runs_on_the_cpu(monkeypatch, cem, opened):
    names = []

    def refuse(name):
        names.append(name)
        raise EngineError("seen")

    monkeypatch.setattr(scene_refinement, "open_engine", refuse)
    options = RefineOptions.model_validate({"cem": cem})
    with pytest.raises(EngineError, match="seen"):
        refine("never read", options, engine="auto")
    assert names == [opened]
