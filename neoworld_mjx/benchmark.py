"""The only module of the library that names the benchmark, a package of the same distribution.

The benchmark imports the library. It adds the command `neoworld bench`, and scenes with a ground
truth for sweeps: `bench:NAME` and `crowded:N`. Both are imported by name when a user
asks for them, so that nothing else of the library depends on the benchmark.
"""

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any

COMMAND = "neoworld_bench.bench_commands:BenchCommand"
"""Location of the class of the command `bench`; see `commands.COMMANDS`."""


def named_scenes() -> Mapping[str, Callable[[str], Any]]:
    """Return the functions from NAME to the `sweeps.Case` of the scene KIND:NAME, by KIND."""
    return import_module("neoworld_bench.named_scenes").SOURCES
