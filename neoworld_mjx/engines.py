"""The table of physics engines: the only list of their names. It imports no simulator.

To add an engine, write a module with a class that implements `physics.engine.Engine`, raises
EngineError from its constructor where it cannot run, and add its row here.
"""

import importlib.util
import os
from typing import TYPE_CHECKING, Literal, NamedTuple


class EngineEntry(NamedTuple):
    """A row of the table."""

    location: str
    """Location of the class: "module:Class", the module relative to this package."""
    purpose: str
    """Purpose of the engine, in words."""
    accelerator: bool
    """Whether `auto` takes the engine only where JAX has an accelerator."""
    agreement: float
    """Smallest share of verdicts on clear layouts that must equal MuJoCo's."""


ENGINES: dict[str, EngineEntry] = {
    "warp": EngineEntry(
        ".physics.warp_engine:WarpEngine", "NVIDIA GPUs, by MuJoCo Warp", False, 0.98
    ),
    "mjx": EngineEntry(
        ".physics.mjx_engine:MjxEngine", "accelerators of JAX, by MuJoCo MJX", True, 0.98
    ),
    "native": EngineEntry(
        ".physics.native:NativeEngine", "CPUs, by C MuJoCo on all cores", False, 0.99
    ),
}
"""Engines by name. `auto` takes, for each rollout, the one that costs least of those that can run
here."""

ENGINES_HELP = "Physics engine; auto takes the one that costs least here: " + "; ".join(
    f"{name}: {entry.purpose}" for name, entry in ENGINES.items()
)

if TYPE_CHECKING:
    EngineName = str
    EngineChoice = str
else:
    EngineName = Literal[tuple(ENGINES)]
    EngineChoice = Literal[("auto", *ENGINES)]


def share_gpu_memory() -> None:
    """Let JAX take a GPU's memory as it needs it, so that Warp finds some beside it.

    JAX takes three quarters when it starts by default. Nothing changes where the variable is set,
    where Warp is not installed, or once JAX has started.
    """
    if importlib.util.find_spec("mujoco_warp") is not None:
        os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
