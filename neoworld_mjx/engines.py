"""The table of physics engines: the only list of their names. It imports no simulator.

To add an engine, write a module with a class that implements `physics.engine.Engine`, raises
EngineError from its constructor where it cannot run, and add its row here.
"""

from typing import TYPE_CHECKING, Literal, NamedTuple


class EngineEntry(NamedTuple):
    """A row of the table."""

    location: str
    """Where the class is: "module:Class", the module relative to this package."""
    purpose: str
    """What the engine is for."""
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
"""Engines by name. `auto` opens the first that can run here."""

ENGINES_HELP = "Physics engine; auto takes the first that can run here: " + "; ".join(
    f"{name}: {entry.purpose}" for name, entry in ENGINES.items()
)

if TYPE_CHECKING:
    EngineName = str
    EngineChoice = str
else:
    EngineName = Literal[tuple(ENGINES)]
    EngineChoice = Literal[("auto", *ENGINES)]
