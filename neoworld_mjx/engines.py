"""Table of the physics engines. Importing this module loads no simulator.

To add an engine, write a class that implements `physics.engine.Engine`, and add an entry to
`ENGINES`. The constructor must raise EngineError if the engine cannot run on the machine.
"""

import importlib.util
import os
from typing import TYPE_CHECKING, Literal, NamedTuple


class EngineEntry(NamedTuple):
    """One engine of the table."""

    location: str
    """The engine's class as "module:Class". The module name is relative to this package."""
    purpose: str
    """Hardware and simulator that the engine uses, for help texts."""


ENGINES: dict[str, EngineEntry] = {
    "warp": EngineEntry(".physics.warp_engine:WarpEngine", "MuJoCo Warp on NVIDIA GPUs"),
    "mjx": EngineEntry(".physics.mjx_engine:MjxEngine", "MuJoCo MJX on JAX accelerators"),
    "native": EngineEntry(".physics.native:NativeEngine", "C MuJoCo on all CPU cores"),
}
"""Engines by name; `physics.engine.open_engine` chooses one of them for `auto`."""

ENGINES_HELP = (
    "Physics engine: "
    + ", ".join(f"{name} ({entry.purpose})" for name, entry in ENGINES.items())
    + "; auto chooses native without an accelerator, else warp if it is installed, else mjx"
)

if TYPE_CHECKING:
    EngineName = str
    EngineChoice = str
else:
    EngineName = Literal[tuple(ENGINES)]
    EngineChoice = Literal[("auto", *ENGINES)]


def share_gpu_memory() -> None:
    """Let JAX allocate GPU memory on demand, so that some remains for Warp.

    By default, JAX preallocates three quarters of the memory. This function has no effect if
    XLA_PYTHON_CLIENT_PREALLOCATE is already set, if MuJoCo Warp is not installed, or if JAX has
    already initialized the GPU.
    """
    if importlib.util.find_spec("mujoco_warp") is not None:
        os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
