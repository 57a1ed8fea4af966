"""Compiled programs are dropped before the process runs out of memory maps."""

import subprocess
import sys

DROPPED = """
import jax
from neoworld_mjx.cache import free_memory_maps

double = jax.jit(lambda x: 2 * x)
double(1.0)
assert not free_memory_maps(share=2.0) and double._cache_size() == 1
assert free_memory_maps(share=0.0) and double._cache_size() == 0
assert double(2.0) == 4.0
"""


def test_programs_are_dropped_when_memory_maps_run_short():
    """In a process of its own: those of other tests stay compiled."""
    subprocess.run([sys.executable, "-c", DROPPED], check=True)
