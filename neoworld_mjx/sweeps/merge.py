"""Merging of the folders of a sweep's shards into one folder."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..errors import RunError
from .folder import HISTORIES, RESULTS, SweepFolder, sweep_of
from .result import SweepResult, stored_result
from .run_rows import Key, Row, add_iterations, read_runs, row_key

SHARED_ENTRIES = ("kind", "plan", "points", "scenes", "versions", "commit")
"""Entries of sweep.json that must be equal in all shards of a sweep."""


def merge(
    folders: Sequence[Path | str], out: Path | str, *, overwrite: bool = False
) -> SweepResult:
    """Join the rows of shards, and write the tables and figures of the whole sweep or ablation.

    Unfinished shards can be merged, too. The number of runs that no shard contains is written into
    sweep.json as "missing". To compute these runs, sweep or ablate into the merged folder with
    `resume`.

    Args:
        folders: folders of the shards, or of several parts of a sweep that have the same plan.
        out: folder for the merged files, which must be new or empty.
        overwrite: replace an earlier sweep in `out`.

    Raises:
        RunError: a folder contains no sweep; shards differ in plan, scenes, versions or commit;
            two shards have rows with different fingerprints for the same run; or `out` cannot be
            written.
    """
    paths = [Path(folder) for folder in folders]
    if not paths:
        raise RunError("merge: name the folders of the shards")
    if len({path.resolve() for path in [*paths, Path(out)]}) < len(paths) + 1:
        raise RunError("merge: a folder appears twice")
    abouts = [_read_about(path) for path in paths]
    for path, about in zip(paths[1:], abouts[1:], strict=True):
        for name in SHARED_ENTRIES:
            if about.get(name) != abouts[0].get(name):
                difference = _difference(abouts[0].get(name), about.get(name))
                raise RunError(f"merge: {paths[0]} and {path} differ in {name}: {difference}")
    rows = _rows(paths)
    first = abouts[0]
    order = [
        (scene, point["label"], seed)
        for scene in first["scenes"]
        for point in first["points"]
        for seed in first["plan"]["seeds"]
    ]
    ordered = [rows[key] for key in order if key in rows]
    missing = len(order) - len(ordered)
    shared = ("machine", "shard", "finished", "mllm")
    shards = [
        {"folder": str(path), **{name: about[name] for name in shared if name in about}}
        for path, about in zip(paths, abouts, strict=True)
    ]
    merged = {name: value for name, value in first.items() if name not in ("figure", "mllm")}
    merged |= {"shard": [1, 1], "shards": shards, "missing": missing}
    merged["groups"] = [group for about in abouts for group in about.get("groups", [])]
    with SweepFolder(Path(out), first["kind"], resume=False, overwrite=overwrite) as folder:
        return stored_result(ordered, merged, folder, finished=not missing)


def _read_about(path: Path) -> dict[str, Any]:
    about = sweep_of(path)
    if about is None or not all(name in about for name in SHARED_ENTRIES):
        raise RunError(f"merge: {path} holds no sweep or ablation of this version")
    return about


def _rows(paths: Sequence[Path]) -> dict[Key, Row]:
    rows: dict[Key, Row] = {}
    for path in paths:
        if not (path / RESULTS).exists():
            continue  # Killed before its first runs were complete.
        for row in add_iterations(path / HISTORIES, read_runs(path / RESULTS)):
            known = rows.setdefault(row_key(row), row)
            if known["fingerprint"] != row["fingerprint"]:
                scene, point, seed = row_key(row)
                raise RunError(
                    f"merge: {path} and another folder have different inputs for scene {scene}, "
                    f"point {point}, seed {seed}"
                )
    return rows


def _difference(first: Any, second: Any) -> str:
    """Describe the first difference between two entries."""
    if isinstance(first, dict) and isinstance(second, dict):
        for name in dict.fromkeys([*first, *second]):
            if first.get(name) != second.get(name):
                return f"{name}: {_difference(first.get(name), second.get(name))}"
    one, other = (str(value)[:60] for value in (first, second))
    return f"{one} and {other}"
