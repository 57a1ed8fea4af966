"""The command doctor: what is installed here and what can run."""

import os
from dataclasses import dataclass

from ..errors import NeoWorldError
from .base_command import Answer, Command

_KEYS = ("ANTHROPIC_API_KEY", "OPENAI_API_KEY")


@dataclass(frozen=True, kw_only=True)
class DoctorCommand(Command):
    """Say what is installed here and what can run."""

    def run(self) -> Answer:
        """Look at this machine."""
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
            "versions": versions(),
        }


def _engine(name: str) -> str:
    from ..physics.simulate import open_engine

    try:
        open_engine(name)
    except (NeoWorldError, ImportError) as error:
        return f"not here: {error}"
    return "ready"
