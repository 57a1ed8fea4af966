"""Compiled programs are dropped before the process runs out of memory maps."""

import inspect

import jax
import pytest

from neoworld_mjx.cache import free_memory_maps
from neoworld_mjx.physics.model import compile_scene
from tests.support import scenes


@pytest.fixture
def compiled():
    double = jax.jit(lambda x: 2 * x)
    double(1.0)
    assert double._cache_size() == 1
    return double


def test_programs_are_dropped_when_memory_maps_run_short(compiled):
    # By default it depends on what ran in this process before.
    assert not free_memory_maps(share=2.0)
    assert compiled._cache_size() == 1
    assert free_memory_maps(share=0.0)
    assert compiled._cache_size() == 0
    assert compiled(2.0) == 4.0


def test_a_new_scene_makes_room(compiled, monkeypatch):
    monkeypatch.setattr(inspect.unwrap(free_memory_maps), "__defaults__", (0.0,))
    compile_scene(scenes.blocks())
    assert compiled._cache_size() == 0
