"""run.json: what a run was made with, its steps, metrics and fallbacks."""

import contextlib
import json
import os
import platform
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

from ..config import Config
from ..errors import RunError

FORMAT = "neoworld-run/1"

_PACKAGES = (
    *("neoworld-mjx", "jax", "mujoco", "mujoco-mjx", "mujoco-warp", "warp-lang", "numpy", "scipy"),
    *("optax", "equinox", "trimesh", "usd-core", "yourdfpy", "anthropic", "pydantic"),
    *("pydantic-monty", "manifold3d", "pillow"),
)


def read_run(path: Path) -> dict[str, Any]:
    """Read a folder's run.json.

    Raises:
        RunError: the folder is missing or not a run folder of this version.
    """
    file = Path(path) / "run.json"
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise RunError(
            f"{path} is not a run folder: cannot read run.json: {error.strerror}"
        ) from None
    except ValueError:
        data = None
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise RunError(f"{file} is not a run of this version ({FORMAT}); name another folder")
    return data


def running(config: Config, earlier: dict[str, Any]) -> dict[str, Any]:
    """Return the run.json of a run that starts; steps, fallbacks and costs go on from `earlier`."""
    return {
        "format": FORMAT,
        "status": "running",
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "config": _without_keys(config),
        "fingerprint": config.fingerprint(),
        "seeds": {"run": config.seed},
        "versions": versions(),
        "device": {"machine": platform.machine(), "cores": os.cpu_count()},
        "metrics": {},
        **{key: earlier.get(key, {}) for key in ("mllm", "fallbacks", "steps")},
    }


def strict_json(values: dict[str, Any]) -> dict[str, Any]:
    """Return values as plain JSON: NumPy scalars become numbers, NaN and Infinity become null."""
    text = json.dumps(values, default=lambda value: value.item())
    return json.loads(text, parse_constant=lambda _: None)


def versions() -> dict[str, str]:
    """Return the versions of Python and of the installed packages that decide results."""
    installed = {"python": platform.python_version()}
    for name in _PACKAGES:
        with contextlib.suppress(metadata.PackageNotFoundError):
            installed[name] = metadata.version(name)
    return installed


def _without_keys(config: Config) -> dict[str, Any]:
    """Dump the options without header values, which may be keys under unforeseen names."""
    data = config.model_dump(mode="json")
    data["mllm"]["headers"] = {
        name: value if value.startswith("${") else "[hidden]"
        for name, value in data["mllm"]["headers"].items()
    }
    return data
