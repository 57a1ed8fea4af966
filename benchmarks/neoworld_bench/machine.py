"""Description of the machine, its load and the peak memory."""

import os
import platform
import resource
import sys
import time
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

_PACKAGES = ("jax", "jaxlib", "mujoco", "mujoco-mjx", "mujoco-warp", "warp-lang", "numpy")


def machine() -> dict[str, Any]:
    """Describe processor, accelerator, load and versions."""
    import jax

    return {
        "processor": _processor(),
        "cores": len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count(),
        "load": [round(x, 2) for x in os.getloadavg()],
        "devices": [f"{d.platform}: {d.device_kind}" for d in jax.devices()],
        "python": platform.python_version(),
        "versions": {name: version for name in _PACKAGES if (version := _version(name))},
    }


def peak_mib() -> tuple[float, float | None]:
    """Return the peak memory of this process and of JAX's first device [MiB], None on a CPU."""
    import jax

    # Linux counts in KiB, macOS in bytes.
    unit = 2**20 if sys.platform == "darwin" else 2**10
    host = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit
    stats = jax.devices()[0].memory_stats() or {}
    device = stats.get("peak_bytes_in_use")
    return host, None if device is None else device / 2**20


def peak_device_mib() -> list[float]:
    """Return the peak memory of each of JAX's devices [MiB]; empty on a CPU."""
    import jax

    peaks = [(d.memory_stats() or {}).get("peak_bytes_in_use") for d in jax.local_devices()]
    return [peak / 2**20 for peak in peaks if peak is not None]


class Others:
    """Mean number of cores that other processes keep busy, from its creation on."""

    def __init__(self) -> None:
        """Start measuring."""
        self._began = self._now()

    def cores(self) -> float | None:
        """Return the mean so far; None if the system does not report it."""
        if self._began is None or (now := self._now()) is None:
            return None
        wall, busy, this_process = (b - a for a, b in zip(self._began, now, strict=True))
        return max(busy - this_process, 0.0) / max(wall, 1e-9)

    @staticmethod
    def _now() -> tuple[float, float, float] | None:
        try:
            total = Path("/proc/stat").read_text(encoding="utf-8").split("\n", 1)[0].split()[1:9]
        except OSError:
            return None
        ticks = [int(value) for value in total]
        # The fourth and fifth count idle time and waiting for disks.
        busy = (sum(ticks) - ticks[3] - ticks[4]) / os.sysconf("SC_CLK_TCK")
        return time.perf_counter(), busy, time.process_time()


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
