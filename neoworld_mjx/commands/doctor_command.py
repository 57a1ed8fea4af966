"""Command `doctor`: installed packages, available engines and missing components."""

import os
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from typing import NamedTuple

from ..errors import NeoWorldError
from ..quantities import count
from .base_command import Command, CommandResult
from .result_lines import DETAILS

_KEYS = ("ANTHROPIC_API_KEY", "OPENAI_API_KEY")


class Component(NamedTuple):
    """Optional component of an installation."""

    name: str
    present: Callable[[], bool]
    consequence: str
    """Features that are missing or slow without the component."""
    remedy: str
    """Command that installs the component."""


def _installed(package: str) -> Callable[[], bool]:
    return lambda: find_spec(package) is not None


def _key() -> bool:
    return any(os.environ.get(name) for name in _KEYS)


def _gpu_in_use() -> bool:
    """Return True if JAX uses the NVIDIA GPU, or if the machine has none."""
    from shutil import which

    import jax

    return which("nvidia-smi") is None or any(d.platform == "gpu" for d in jax.devices())


def _blender() -> bool:
    from ..program.blender.blender_process import blender_python

    return blender_python().exists()


COMPONENTS = (
    Component(
        *("a model's key", _key),
        "photographs other than the examples need responses by hand (--provider mailbox)",
        "export ANTHROPIC_API_KEY=..., or OPENAI_API_KEY=... with the extra openai",
    ),
    Component(
        *("JAX on the GPU", _gpu_in_use),
        "the engine mjx runs on the CPU, many times slower",
        "uv sync --inexact --extra cuda",
    ),
    Component(
        *("extra warp", lambda: _installed("warp")() and _installed("mujoco_warp")()),
        "no engine warp, the fastest on NVIDIA GPUs for large populations",
        "uv sync --inexact --extra warp",
    ),
    Component(
        *("extra openai", _installed("openai")),
        "no provider openai, and no servers with its protocol",
        "uv sync --inexact --extra openai",
    ),
    Component(
        *("extra mcp", _installed("mcp")),
        "coding agents cannot answer the requests of a run (neoworld mcp)",
        "uv sync --inexact --extra mcp",
    ),
    Component(
        *("extra baselines", _installed("evosax")),
        "no refine.optimizer evosax:STRATEGY",
        "uv sync --inexact --extra baselines",
    ),
    Component(
        *("extra plot", _installed("matplotlib")),
        "sweeps draw no figure",
        "uv sync --inexact --extra plot",
    ),
    Component(
        *("Blender (bpy)", _blender),
        "no program.language blender, as in the paper; 360 MB to download, 970 MB on disk",
        "the two uv commands in docs/how-to/blender-programs.md",
    ),
)


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
        cache = cache_folder()
        return {
            "system": platform.platform(),
            "cores": os.cpu_count(),
            "devices": [f"{device.platform}: {device.device_kind}" for device in jax.devices()],
            "engines": {name: _engine(name) for name in ENGINES},
            "cache": {"folder": str(cache), "exists": cache.is_dir()},
            "keys": {name: bool(os.environ.get(name)) for name in _KEYS},
            "missing": [
                {"name": part.name, "consequence": part.consequence, "remedy": part.remedy}
                for part in COMPONENTS
                if not part.present()
            ],
            "versions": versions(),
        }

    def lines(self, result: CommandResult) -> list[str]:
        """Return a short summary of the result."""
        versions, engines = result["versions"], result["engines"]
        unavailable = [name for name, state in engines.items() if state != "ready"]
        packages = ", ".join(
            f"{name} {versions[name]}" for name in ("neoworld-mjx", "jax", "mujoco")
        )
        others = f"; unavailable: {', '.join(unavailable)}" if unavailable else ""
        rows = [
            f"machine: {count(result['cores'], 'core')}, {', '.join(result['devices'])}; "
            f"Python {versions['python']}, {packages}",
            f"engines: {', '.join(name for name in engines if name not in unavailable)}{others}",
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
