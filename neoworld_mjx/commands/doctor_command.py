"""The command doctor: what is installed here and what can run."""

import os
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Literal, NamedTuple

from ..errors import NeoWorldError
from .base_command import Command, CommandResult
from .listing_lines import doctor_lines

_KEYS = ("ANTHROPIC_API_KEY", "OPENAI_API_KEY")


class Need(NamedTuple):
    """Something that a machine may lack."""

    what: str
    present: Callable[[], bool]
    costs: str
    """What cannot be done, or is slow, without it."""
    mend: str
    """Command that brings it."""


def _installed(package: str) -> Callable[[], bool]:
    return lambda: find_spec(package) is not None


def _key() -> bool:
    return any(os.environ.get(name) for name in _KEYS)


def _gpu_seen() -> bool:
    """Return whether JAX uses the NVIDIA GPU that the machine has, if it has one."""
    from shutil import which

    import jax

    return which("nvidia-smi") is None or any(d.platform == "gpu" for d in jax.devices())


def _cached() -> bool:
    from ..cache import cache_folder

    return cache_folder().is_dir()


def _blender() -> bool:
    from ..program.blender.blender_environment import blender_python

    return blender_python().exists()


NEEDS = (
    Need(
        *("a model's key", _key),
        "photographs of your own need answers by hand (--provider mailbox); the examples do not",
        "export ANTHROPIC_API_KEY=..., or OPENAI_API_KEY=... with the extra openai",
    ),
    Need(
        *("JAX on the GPU", _gpu_seen),
        "the engine mjx runs on the CPU, hundreds of times slower",
        "uv sync --inexact --extra cuda",
    ),
    Need(
        *("extra warp", lambda: _installed("warp")() and _installed("mujoco_warp")()),
        "no engine warp, the fastest on NVIDIA GPUs for large populations",
        "uv sync --inexact --extra warp",
    ),
    Need(
        *("extra openai", _installed("openai")),
        "no provider openai, nor servers that speak its protocol",
        "uv sync --inexact --extra openai",
    ),
    Need(
        *("extra baselines", _installed("evosax")),
        "no refine.optimizer cma_es",
        "uv sync --inexact --extra baselines",
    ),
    Need(
        *("extra metrics", _installed("onnxruntime")),
        "bench run pictures gives SSIM alone, no LPIPS, CLIP, DINOv2 or Uni3D",
        "uv sync --inexact --extra metrics",
    ),
    Need(
        *("extra plot", _installed("matplotlib")),
        "sweeps end without a figure",
        "uv sync --inexact --extra plot",
    ),
    Need(
        *("Blender (bpy)", _blender),
        "no program.language blender, the paper's own; it fetches 360 MB and takes 970 on disk",
        "neoworld doctor --install blender",
    ),
    Need(
        *("compilations of an earlier run", _cached),
        "the first run compiles for half a minute or more; later ones do not",
        "uv run neoworld reconstruct examples/coffee.png --out out",
    ),
)


@dataclass(frozen=True, kw_only=True)
class DoctorCommand(Command):
    """Say what is installed here, what can run, and what each missing thing costs."""

    install: Literal["blender"] | None = None
    """Install this first: blender, in an environment of its own in the cache's folder."""

    def run(self) -> CommandResult:
        """Look at this machine."""
        if self.install == "blender":
            from ..program.blender.blender_availability import install_blender

            return {"installed": "blender", "folder": str(install_blender())}
        import platform

        import jax

        from ..cache import cache_folder
        from ..engines import ENGINES
        from ..mllm.provider import bundled_tapes
        from ..run_folder import versions

        kept = cache_folder()
        tapes = sorted(path.name for path in bundled_tapes().glob("*") if path.is_file())
        return {
            "system": platform.platform(),
            "cores": os.cpu_count(),
            "devices": [f"{device.platform}: {device.device_kind}" for device in jax.devices()],
            "engines": {name: _engine(name) for name in ENGINES},
            "cache": {"folder": str(kept), "exists": kept.is_dir()},
            "keys": {name: bool(os.environ.get(name)) for name in _KEYS},
            "tapes": tapes,
            "missing": [
                {"what": need.what, "costs": need.costs, "mend": need.mend}
                for need in NEEDS
                if not need.present()
            ],
            "versions": versions(),
        }

    def lines(self, result: CommandResult) -> list[str]:
        """Return a short summary of the result."""
        return doctor_lines(result)


def _engine(name: str) -> str:
    from ..physics.simulate import open_engine

    try:
        open_engine(name)
    except (NeoWorldError, ImportError) as error:
        return f"not here: {error}"
    return "ready"
