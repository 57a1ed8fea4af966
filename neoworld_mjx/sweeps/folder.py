"""The folder of a sweep: results.parquet, table.md and sweep.json, rewritten after every group."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..errors import RunError
from ..files import write_atomic
from .run_rows import Row, key, read_parquet, write_parquet

RESULTS, TABLE, ABOUT = "results.parquet", "table.md", "sweep.json"
FORMAT = "neoworld-sweep/1"


class SweepFolder:
    """The output folder of a sweep; `rows` holds the rows of an earlier part of it."""

    def __init__(self, path: Path, kind: str, *, resume: bool, overwrite: bool) -> None:
        """Create the folder, or continue in an existing one.

        Args:
            path: the folder.
            kind: sweep or ablation.
            resume: keep existing rows that the plan asks for again.
            overwrite: delete the files of an earlier sweep, and no others.

        Raises:
            RunError: the path is a file, cannot be written, or holds files that must stay.
        """
        self.path = Path(path)
        self.rows: list[Row] = []
        self.groups: list[dict[str, Any]] = []
        """The computations that made `rows`, as sweep.json lists them."""
        if self.path.exists() and not self.path.is_dir():
            raise RunError(f"{path} is a file; name a folder")
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            if any(self.path.iterdir()):
                self._enter(kind, resume, overwrite)
            if not self.rows:
                self.write_about({"format": FORMAT, "kind": kind, "finished": False})
        except OSError as error:
            raise RunError(f"cannot write {path}: {error.strerror}") from None

    def _enter(self, kind: str, resume: bool, overwrite: bool) -> None:
        try:
            about = json.loads((self.path / ABOUT).read_text(encoding="utf-8"))
            is_sweep = about["format"] == FORMAT and isinstance(about["kind"], str)
        except (OSError, ValueError, KeyError, TypeError):
            is_sweep, about = False, {}
        if not is_sweep:
            raise RunError(f"{self.path} is not empty and holds no {kind}: name a new folder")
        existing_kind = about["kind"]
        if existing_kind != kind:
            raise RunError(
                f"{self.path} holds another kind of run, {existing_kind}: name a new folder"
            )
        if overwrite:
            for name in (RESULTS, TABLE):
                (self.path / name).unlink(missing_ok=True)
            return
        if not resume:
            raise RunError(
                f"{self.path} holds a {kind}: go on with --resume, begin anew with --overwrite, or "
                "name a new folder"
            )
        if (self.path / RESULTS).exists():
            self.rows = read_parquet(self.path / RESULTS)
            self.groups = list(about.get("groups", []))

    def keep(self, wanted: dict[tuple[str, str, int], str]) -> dict[tuple[str, str, int], Row]:
        """Return the rows that need not be computed again.

        Args:
            wanted: fingerprint of every run asked for, by scene, point and seed.

        Raises:
            RunError: there are rows that are not asked for, which would be lost.
        """
        existing = {key(row): row for row in self.rows}
        lost = [at for at in existing if at not in wanted]
        if lost:
            scene, point, seed = lost[0]
            raise RunError(
                f"{self.path} has {len(lost)} rows that are not asked for now, such as scene "
                f"{scene}, point {point}, seed {seed}: use --overwrite, or name a new folder"
            )
        return {at: row for at, row in existing.items() if row["fingerprint"] == wanted[at]}

    def write(self, rows: Sequence[Row], values: Sequence[str], table: str) -> None:
        """Write all rows so far and their table.

        Raises:
            RunError: a file cannot be written.
        """
        write_parquet(self.path / RESULTS, rows, values)
        self._text(TABLE, table)

    def write_about(self, about: dict[str, Any]) -> None:
        """Write sweep.json.

        Raises:
            RunError: it cannot be written.
        """
        self._text(ABOUT, json.dumps(about, indent=1) + "\n")

    def _text(self, name: str, text: str) -> None:
        try:
            write_atomic(self.path / name, text)
        except OSError as error:
            raise RunError(f"cannot write {self.path / name}: {error.strerror}") from None
