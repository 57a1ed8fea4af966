"""Table of physics engines; importing it loads no simulator.

To add an engine, write a class that implements `physics.engine.Engine` and raises EngineError from
its constructor where it cannot run, and add its row here.
"""

import importlib.util
import os
from typing import TYPE_CHECKING, Literal, NamedTuple


class EngineEntry(NamedTuple):
    """Row of the table."""

    location: str
    """Location of the class: "module:Class", the module relative to this package."""
    purpose: str
    """Hardware and simulator of the engine, in words."""
    accelerator: bool
    """True if `auto` uses the engine only where JAX has an accelerator."""
    agreement: float
    """Minimum fraction of verdicts that equal MuJoCo's, on layouts away from the thresholds."""


ENGINES: dict[str, EngineEntry] = {
    "warp": EngineEntry(
        ".physics.warp_engine:WarpEngine", "NVIDIA GPUs, by MuJoCo Warp", False, 0.98
    ),
    "mjx": EngineEntry(
        ".physics.mjx_engine:MjxEngine", "JAX accelerators, by MuJoCo MJX", True, 0.98
    ),
    "native": EngineEntry(
        ".physics.native:NativeEngine", "CPUs, by C MuJoCo on all cores", False, 0.99
    ),
}
"""Engines by name. `auto` chooses the fastest available one for each rollout."""

ENGINES_HELP = "Physics engine; auto chooses the fastest available one: " + "; ".join(
    f"{name}: {entry.purpose}" for name, entry in ENGINES.items()
)

if TYPE_CHECKING:
    EngineName = str
    EngineChoice = str
else:
    EngineName = Literal[tuple(ENGINES)]
    EngineChoice = Literal[("auto", *ENGINES)]


def share_gpu_memory() -> None:
    """Let JAX allocate GPU memory on demand, so that some remains for Warp.

    By default JAX preallocates three quarters. Has no effect if the environment variable is set,
    Warp is not installed, or JAX has started.
    """
    if importlib.util.find_spec("mujoco_warp") is not None:
        os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
