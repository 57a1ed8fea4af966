"""Scripts that run with several simulated devices."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def run_with_devices(count: int, script: str, *words: str) -> None:
    """Run a script in a process in which JAX has several devices, all of them on the CPU.

    Args:
        count: number of devices.
        script: text of the script.
        words: arguments of the script.
    """
    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count={count}"
    process = subprocess.run(
        [sys.executable, "-c", script, *words],
        env=os.environ | {"XLA_FLAGS": flags.strip(), "JAX_PLATFORMS": "cpu"},
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode == 0, process.stderr[-2000:]
