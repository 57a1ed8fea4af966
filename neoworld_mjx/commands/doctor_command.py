"""Command `doctor`: installed packages, available engines and missing components."""

import os
from dataclasses import dataclass
from importlib.util import find_spec
from typing import NamedTuple

from ..errors import NeoWorldError
from ..quantities import count
from .base_command import Command, CommandResult
from .result_lines import DETAILS

KEYS = ("ANTHROPIC_API_KEY", "OPENAI_API_KEY")
EXTRAS = {
    "warp": ("mujoco_warp", "no engine warp, the fastest on NVIDIA GPUs for large populations"),
    "openai": ("openai", "no provider openai, and no servers with its protocol"),
    "mcp": ("mcp", "coding agents cannot answer the requests of a run (neoworld mcp)"),
    "baselines": ("evosax", "no examples/search/evosax_optimizer.py"),
    "plot": ("matplotlib", "sweeps draw no figure"),
}
"""A package of each optional extra, and what is missing without the extra."""


class Missing(NamedTuple):
    """A component that is not installed, or not used."""

    name: str
    consequence: str
    """Features that are missing or slow without the component."""
    remedy: str
    """Command that installs the component."""


def missing_components() -> list[Missing]:
    """Return the optional components that this installation lacks."""
    from shutil import which

    import jax

    from ..program.blender.blender_process import blender_python

    install = "uv sync --inexact --extra"
    missing = []
    if not any(map(os.environ.get, KEYS)):
        consequence = "photographs other than the examples need responses by hand"
        remedy = "export ANTHROPIC_API_KEY=..., or OPENAI_API_KEY=... with the extra openai"
        missing.append(Missing("a model's key", f"{consequence} (--provider mailbox)", remedy))
    if which("nvidia-smi") and all(device.platform != "gpu" for device in jax.devices()):
        consequence = "the engine mjx runs on the CPU, many times slower"
        missing.append(Missing("JAX on the GPU", consequence, f"{install} cuda"))
    missing += [
        Missing(f"extra {extra}", consequence, f"{install} {extra}")
        for extra, (package, consequence) in EXTRAS.items()
        if find_spec(package) is None
    ]
    if not blender_python().exists():
        consequence = "no program.language blender, as in the paper; it takes 970 MB on disk"
        remedy = "the two uv commands in docs/how-to/blender-programs.md"
        missing.append(Missing("Blender (bpy)", consequence, remedy))
    return missing


@dataclass(frozen=True, kw_only=True)
class DoctorCommand(Command):
    """List installed components, available engines, and what missing components prevent."""

    def run(self) -> CommandResult:
        """Inspect this machine."""
        import platform

        import jax

        from ..cache import cache_folder, check_jax
        from ..engines import ENGINES
        from ..run_folder import versions

        check_jax()
        return {
            "system": platform.platform(),
            "cores": os.cpu_count(),
            "devices": [f"{device.platform}: {device.device_kind}" for device in jax.devices()],
            "engines": {name: _engine(name) for name in ENGINES},
            "cache": str(cache_folder()),
            "keys": {name: bool(os.environ.get(name)) for name in KEYS},
            "missing": [missing._asdict() for missing in missing_components()],
            "versions": versions(),
        }

    def lines(self, result: CommandResult) -> list[str]:
        """Return a short summary of the result."""
        versions, engines = result["versions"], result["engines"]
        packages = ", ".join(
            f"{name} {versions[name]}" for name in ("neoworld-mjx", "jax", "mujoco")
        )
        rows = [
            f"machine: {count(result['cores'], 'core')}, {', '.join(result['devices'])}; "
            f"Python {versions['python']}, {packages}",
            f"engines: {', '.join(name for name, state in engines.items() if state == 'ready')}",
        ]
        for part in result["missing"]:
            rows.append(f"missing: {part['name']}: {part['consequence']}")
            rows.append(f"  fix: {part['remedy']}")
        return [*rows, *([] if result["missing"] else ["nothing is missing"]), DETAILS]


def _engine(name: str) -> str:
    from ..physics.engine import open_engine

    try:
        open_engine(name)
    except (NeoWorldError, ImportError) as error:
        return f"unavailable: {error}"
    return "ready"
