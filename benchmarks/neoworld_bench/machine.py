"""Description of the code and the machine that results come from."""

import datetime
import os
import platform
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from neoworld_mjx.sweeps.result import commit

_PACKAGES = ("jax", "jaxlib", "mujoco", "mujoco-mjx", "mujoco-warp", "warp-lang", "numpy")


def provenance() -> dict[str, Any]:
    """Return commit, date, device and machine, which every result of a suite states."""
    import jax

    return {
        "commit": commit() or "",
        "date": datetime.date.today().isoformat(),
        "device": ", ".join(dict.fromkeys(f"{d.platform}: {d.device_kind}" for d in jax.devices())),
        "machine": {
            "processor": _processor(),
            "cores": len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count(),
            "devices": len(jax.devices()),
            "load": [round(x, 2) for x in os.getloadavg()],
            "python": platform.python_version(),
            "versions": {name: found for name in _PACKAGES if (found := _version(name))},
        },
    }


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
