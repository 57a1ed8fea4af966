"""run.json: options, versions, steps, metrics and fallbacks of a run; and the result of a run."""

import contextlib
import logging
import math
import os
import platform
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, Field, ValidationError

from ..config import Config, load_config, merged
from ..errors import ConfigError, RunError
from ..io import file_bounds, read_json
from ..io.files import stays_inside
from ..io.text_files import validation_message
from ..names import Step
from ..options import option_values
from .staging import step_of, writes

FORMAT = "neoworld-run/1"
MAX_STEPS = 2000
"""Largest number of recorded steps and parts of steps; most parts are objects."""

CAMERA_NOTE = "camera"
"""Title of the note on a camera that differs from the response's, which summaries show."""

_PACKAGES = (
    *("neoworld-mjx", "jax", "mujoco", "mujoco-mjx", "mujoco-warp", "warp-lang", "numpy", "scipy"),
    *("optax", "equinox", "trimesh", "usd-core", "yourdfpy", "anthropic", "pydantic"),
    *("pydantic-monty", "manifold3d", "pillow"),
)


def _check_inside(name: str) -> str:
    if not stays_inside(name):
        raise ValueError("this path leads out of the folder")
    return name


_InsidePath = Annotated[str, AfterValidator(_check_inside)]
_Seconds = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class _Step(BaseModel):
    inputs: dict[str, str]
    outputs: dict[_InsidePath, str]
    edited: list[_InsidePath] = []


def _check_outputs(steps: dict[str, _Step]) -> dict[str, _Step]:
    writers: dict[str, str] = {}
    for part, entry in steps.items():
        for name in entry.outputs:
            if not writes(part, name):
                raise ValueError(f"{part} does not write {name!r}")
            if name in writers:
                raise ValueError(f"both {writers[name]} and {part} list {name!r}")
            writers[name] = part
    return steps


class _Times(BaseModel):
    seconds: _Seconds
    waiting_s: _Seconds


class _Fallback(BaseModel):
    step: str
    what: str
    why: str


_Entries = Annotated[list[_Fallback], Field(max_length=MAX_STEPS)]


class _Photo(BaseModel):
    name: str = ""
    sha256: str = ""


class _Check(BaseModel):
    phrase: str
    passed: bool
    value: float | None = None
    threshold: float = 0.0
    failing: list[str] = []


class _Metrics(BaseModel):
    passed: bool | None = None
    checks: list[_Check] = []


class _Record(BaseModel):
    """Required structure of run.json, which is untrusted."""

    status: str
    error: str = ""
    started: str = ""
    fingerprint: str = ""
    steps: Annotated[dict[str, _Step], Field(max_length=MAX_STEPS), AfterValidator(_check_outputs)]
    times: dict[Step, _Times] = {}
    fallbacks: _Entries
    notes: _Entries = []
    config: dict[str, Any] = {}
    seeds: dict[str, Any] = {}
    versions: dict[str, str] = {}
    device: dict[str, Any] = {}
    metrics: _Metrics = _Metrics()
    mllm: dict[str, Any] = {}
    photo: _Photo = _Photo()


_EMPTY_SECTIONS: dict[str, Any] = {
    key: {} for key in ("config", "seeds", "versions", "device", "metrics", "mllm", "photo")
}


def read_run(path: Path) -> dict[str, Any]:
    """Read run.json of a run folder.

    Raises:
        RunError: the folder is missing or is not a run folder of this version.
    """
    file = Path(path) / "run.json"
    if not file.exists():
        raise RunError(f"{path} is not a run folder: it has no run.json; name another folder")
    data = read_json(file, RunError)
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise RunError(f"{file} is not a run of this version ({FORMAT}); name another folder")
    try:
        _Record.model_validate(data)
    except ValidationError as error:
        reason = validation_message(error, _Record)
        reason = reason if len(reason) <= 500 else reason[:500] + " ..."
        raise RunError(
            f"{file} is damaged: {reason}; repair it, or start a new run in another folder"
        ) from None
    return _EMPTY_SECTIONS | {"notes": []} | data


def step_times(run: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    """Return the wall time and the time of waiting for models of each step [s].

    They are those of the step's last execution.

    Args:
        run: the data of run.json.
    """
    done = set(map(step_of, run["steps"]))
    times = run.get("times", {}).items()
    return {step: (t["seconds"], t["waiting_s"]) for step, t in times if step in done}


MAX_STEPS_OF_SEARCH = 20_000_000
"""Largest number of simulated steps of all candidates that the options of a run folder request."""
_log = logging.getLogger(__name__)


def run_options(folder: Path, over: Mapping[str, Any]) -> Config:
    """Return the options of a run, which may come from an untrusted source.

    The limits of files are those that are active, never those of the folder. A warning lists the
    other options that are not the defaults.

    Args:
        folder: the run folder.
        over: options that override those of the folder.

    Raises:
        RunError: the folder is not a run folder.
        ConfigError: the options are invalid, or request a search of too many steps.
    """
    file = Path(folder) / "run.json"
    data = {key: value for key, value in read_run(folder)["config"].items() if key != "files"}
    try:
        config = load_config(None, merged(data, dict(over)))
    except ConfigError as error:
        raise ConfigError(f"{file}: {error}; give options by --config") from None
    config = config.model_copy(update={"files": file_bounds()})
    search, rollout = config.refine.cem, config.refine.rollout
    steps = (
        search.population * search.iterations * max(1.0, rollout.duration_s / rollout.timestep_s)
    )
    if steps > MAX_STEPS_OF_SEARCH:
        raise ConfigError(
            f"{file} requests a search of {steps:.3g} simulated steps ({search.iterations} "
            f"iterations of {search.population} candidates); the limit is "
            f"{MAX_STEPS_OF_SEARCH:.3g}: give options by --config or --set"
        )
    defaults = option_values(load_config(None, dict(over)))
    applied = [
        f"{path}={value}"
        for path, value in option_values(config).items()
        if value != defaults[path] and path.startswith(("refine.", "compose."))
    ]
    if applied:
        _log.warning("options of %s that apply: %s", file, ", ".join(applied))
    return config


def initial_record(config: Config, earlier: dict[str, Any]) -> dict[str, Any]:
    """Return the initial run.json of a run; steps, fallbacks and costs continue from `earlier`."""
    return {
        "format": FORMAT,
        "status": "running",
        "started": earlier.get("started") or datetime.now(UTC).isoformat(timespec="seconds"),
        "config": config.model_dump(mode="json"),
        "fingerprint": config.fingerprint(),
        "seeds": {"run": config.seed},
        "versions": versions(),
        "device": {"machine": platform.machine(), "cores": os.cpu_count()},
        "metrics": {},
        **{key: earlier.get(key, {}) for key in ("mllm", "fallbacks", "steps", "times")},
        **({"evidence": earlier["evidence"]} if "evidence" in earlier else {}),
        "notes": earlier.get("notes", []),
    }


def versions() -> dict[str, str]:
    """Return the versions of Python and of the installed packages that affect results."""
    installed = {"python": platform.python_version()}
    for name in _PACKAGES:
        with contextlib.suppress(metadata.PackageNotFoundError):
            installed[name] = metadata.version(name)
    return installed


@dataclass(frozen=True)
class Result:
    """Result of a run."""

    folder: Path
    until: str | None
    """Last requested step; None for a complete run."""
    metrics: dict[str, Any]
    seconds: dict[str, float]
    """Duration of each step [s]."""
    waiting: dict[str, float]
    """Time that each step waited for models [s]."""
    fallbacks: list[dict[str, str]]
    notes: list[dict[str, str]]
    """Noteworthy outcomes, such as large moves by the fit or the search."""
    objects: list[str]
    cost: dict[str, Any] = field(default_factory=dict)

    @property
    def passed(self) -> bool | None:
        """True if the refined scene passes all checks; None before refinement."""
        return self.metrics.get("passed")

    @property
    def verdict(self) -> str:
        """The verdict on the scene in one line; see `verdict_line`."""
        return verdict_line(self.metrics)

    def summary(self) -> dict[str, Any]:
        """Return the JSON object that `neoworld reconstruct --json` prints."""
        exported = self.passed is not None and self.until is None
        return {
            "scene": str(self.folder / "scene.xml") if exported else None,
            "folder": str(self.folder),
            "report": str(self.folder / "report.html"),
            "objects": self.objects,
            **{key: value for key, value in self.metrics.items() if key != "objects"},
            "passed": self.passed,
            "seconds": self.seconds,
            "waiting": self.waiting,
            "fallbacks": self.fallbacks,
            "notes": self.notes,
            "mllm": self.cost,
        }

    def __repr__(self) -> str:
        """Return folder, time and objects, and the verdict, on one line each."""
        computing = sum(self.seconds.values()) - sum(self.waiting.values())
        return (
            f"Result({str(self.folder)!r}: {computing:.1f} s of computing\n"
            f"  objects: {', '.join(self.objects)}\n"
            f"  {self.verdict}, {len(self.fallbacks)} fallbacks)"
        )


def verdict_line(metrics: Mapping[str, Any]) -> str:
    """Return the verdict on a scene in one line, with the reasons if it is not valid.

    Args:
        metrics: "passed", and "checks", a list of the JSON data of `measure.SceneCheck`.
    """
    passed, checks = metrics.get("passed"), metrics.get("checks", ())
    if passed is None:
        return "not refined yet"
    if not passed:
        failed = [str(check["phrase"]) for check in checks if not check["passed"]]
        return f"not valid: {'; '.join(failed)}"
    ratio = lambda check: check["value"] / (check["threshold"] or math.inf)
    closest = max(checks, key=ratio, default=None)
    line = f"valid: all {len(checks)} checks pass"
    if closest is None or not closest["value"]:
        return line
    return f"{line}; closest to its limit: {closest['phrase']}"
