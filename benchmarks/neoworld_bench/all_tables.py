"""All tables of docs/results.md: one command each, one file each, compared with earlier files."""

import json
import logging
import math
import shlex
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import tyro

from neoworld_mjx.errors import ConfigError, RunError, choices
from neoworld_mjx.io.files import write_output
from neoworld_mjx.io.text_files import read_untrusted_text
from neoworld_mjx.sweeps.result import commit

from .bench_commands import SuiteChoice

log = logging.getLogger(__name__)

TABLES = {
    "examples": "examples",
    "scenes": "scenes --starts 2 --method ours aligned guided gravity open_loop",
    "arrangements": (
        "scenes --scenes arrangements --starts 4 --method ours aligned gravity --noise layout"
    ),
    "arrangements_all": "scenes --scenes arrangements --starts 4 --method ours aligned gravity",
    "searches": "scenes --starts 2 --method ours random algorithm1_aligned",
    "evidence": (
        "scenes --starts 2 --method aligned --evidence none exif fov fov+affine fov+pose fov+depth "
        "fov+pose+depth fov+masks fov+depth+masks second stereo"
    ),
    "tasks": "tasks --starts 2 --method ours --evidence none fov+pose fov+depth",
    "ablations": "tasks --starts 1 --method open_loop no_simulation without_s_sem",
    "predicted": "tasks --starts 1 --method ours --samples 24",
    "predicted_depth": "tasks --starts 1 --method ours --samples 24 --evidence fov+depth",
    "photos": "photos",
    "real": (
        "real-poses examples/posecnn/data --runs examples/posecnn/runs "
        "--place-with photo camera depth"
    ),
    "rescue": "rescue",
    "rescue_photo": "rescue --photo",
    "engines": "engines",
}
"""Words after `neoworld bench run` for each file."""
_PANDA = (
    "policies --robot panda --engine warp --worlds 1024 --each 2 --trained-in plan scene "
    "--minutes 6 --samples 32"
)
GPU_TABLES = {
    "policies": _PANDA,
    "policies_depth": f"{_PANDA} --evidence fov+depth",
    "policies_no_simulation": f"{_PANDA} --method no_simulation",
}
"""Tables that need an NVIDIA GPU; they are made only if they are named."""


def run_tables(
    out: Path, names: tuple[str, ...], workers: int, against: Path | None
) -> dict[str, Any]:
    """Run the commands of tables whose files are missing or of other code.

    Args:
        out: folder of the files NAME.json.
        names: names of tables; those of TABLES if empty.
        workers: processes of the suites that take a number of them.
        against: folder of earlier files to compare with.

    Raises:
        ConfigError: there is no such table.
        RunError: a file cannot be read or written.
    """
    tables = {**TABLES, **GPU_TABLES}
    for name in names:
        if name not in tables:
            raise ConfigError(f"tables: {choices(name, tables)}")
    changes = []
    for name in names or TABLES:
        file = out / f"{name}.json"
        result = _of_this_code(file, tables[name])
        if result is None:
            command: Any = tyro.cli(SuiteChoice, args=[*shlex.split(tables[name]), "--json"])
            if hasattr(command, "workers"):
                object.__setattr__(command, "workers", workers)
            result = {"table": tables[name], **command.run()}
            write_output(file, json.dumps(result, indent=1) + "\n", RunError)
            log.info(f"wrote {file}")
        if against is not None and (against / file.name).exists():
            changes += [
                f"{name}: {line}" for line in differences(_read(against / file.name), result)
            ]
    return {"files": [f"{name}.json" for name in names or TABLES], "changes": changes}


def _of_this_code(file: Path, words: str) -> dict[str, Any] | None:
    """Return the stored result of a table if it was made by this code and command."""
    if not file.exists():
        return None
    result = _read(file)
    same = result.get("table") == words and result.get("commit") == (commit() or "")
    return result if same else None


def _read(file: Path) -> dict[str, Any]:
    try:
        result = json.loads(read_untrusted_text(file, RunError, "results"))
    except ValueError:
        result = None
    if not isinstance(result, dict):
        raise RunError(f"{file} is no JSON object of results")
    return result


def differences(before: Mapping[str, Any], after: Mapping[str, Any]) -> Iterator[str]:
    """Yield a line for each figure whose intervals before and after do not overlap.

    Figures are numbers NAME with an interval NAME_interval, at any depth of both results.
    """
    for key, value in after.items():
        earlier = before.get(key)
        if isinstance(value, Mapping) and isinstance(earlier, Mapping):
            yield from (f"{key}: {line}" for line in differences(earlier, value))
        old, new = (_interval(result.get(f"{key}_interval")) for result in (before, after))
        if old and new and (old[1] < new[0] or new[1] < old[0]):
            yield f"{key} {earlier:.4g} -> {value:.4g}"


def _interval(ends: Any) -> tuple[float, float] | None:
    if not (isinstance(ends, list) and len(ends) == 2):
        return None
    if not all(isinstance(end, int | float) and math.isfinite(end) for end in ends):
        return None
    return float(ends[0]), float(ends[1])
