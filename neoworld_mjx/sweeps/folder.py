"""The folder of a sweep, rewritten after every group: runs and their iterations as Parquet, tables,
a figure, and sweep.json.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..errors import RunError
from ..io import read_object
from ..io.files import write_atomic
from ..run_folder import refuse_links
from .figure import draw
from .histories import HISTORIES, with_histories, write_histories
from .run_rows import Row, key, read_parquet, write_parquet

RESULTS, TABLE, ABOUT = "results.parquet", "table.md", "sweep.json"
CSV, LATEX, FIGURE = "table.csv", "table.tex", "figure.svg"
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
        self.ledger: dict[str, Any] = {}
        """Calls and costs of the models that were asked for `rows`."""
        if self.path.exists() and not self.path.is_dir():
            raise RunError(f"{path} is a file; name a folder")
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            refuse_links(self.path)
            if any(self.path.iterdir()):
                self._enter(kind, resume, overwrite)
            if not self.rows:
                self.write_about({"format": FORMAT, "kind": kind, "finished": False})
        except OSError as error:
            raise RunError(f"cannot write {path}: {error.strerror}") from None

    def _enter(self, kind: str, resume: bool, overwrite: bool) -> None:
        try:
            about = read_object(self.path / ABOUT, RunError)
            is_sweep = about["format"] == FORMAT and isinstance(about["kind"], str)
        except (RunError, KeyError):
            is_sweep, about = False, {}
        if not is_sweep:
            raise RunError(f"{self.path} is not empty and holds no {kind}: name a new folder")
        existing_kind = about["kind"]
        if existing_kind != kind:
            raise RunError(
                f"{self.path} holds another kind of run, {existing_kind}: name a new folder"
            )
        if overwrite:
            for name in (RESULTS, HISTORIES, TABLE, CSV, LATEX, FIGURE):
                (self.path / name).unlink(missing_ok=True)
            return
        if not resume:
            raise RunError(
                f"{self.path} holds a {kind}: go on with --resume, begin anew with --overwrite, or "
                "name a new folder"
            )
        ledger = about.get("mllm")
        self.ledger = ledger if isinstance(ledger, dict) else {}
        if (self.path / RESULTS).exists():
            rows = read_parquet(self.path / RESULTS)
            self.rows = with_histories(self.path / HISTORIES, rows)
            self.groups = list(about.get("groups", []))

    def keep(self, expected: dict[tuple[str, str, int], str]) -> dict[tuple[str, str, int], Row]:
        """Return the rows that need not be computed again.

        Args:
            expected: fingerprint of every requested run, by scene, point and seed.

        Raises:
            RunError: the folder has rows of runs that are not requested, which would be lost.
        """
        existing = {key(row): row for row in self.rows}
        lost = [run for run in existing if run not in expected]
        if lost:
            scene, point, seed = lost[0]
            raise RunError(
                f"{self.path} has {len(lost)} rows that this plan does not contain, such as scene "
                f"{scene}, point {point}, seed {seed}: use --overwrite, or name a new folder"
            )
        return {run: row for run, row in existing.items() if row["fingerprint"] == expected[run]}

    def write(self, rows: Sequence[Row], values: Sequence[str], texts: Mapping[str, str]) -> None:
        """Write all rows so far, and their tables by the names of their files.

        Raises:
            RunError: a file cannot be written.
        """
        write_parquet(self.path / RESULTS, rows, values)
        write_histories(self.path / HISTORIES, rows)
        for name, text in texts.items():
            self._text(name, text)

    def write_figure(self, rows: Sequence[Row], axes: Sequence[str]) -> str | None:
        """Draw the sweep; return the figure's path, or None without matplotlib.

        Raises:
            RunError: the file cannot be written.
        """
        drawn = draw(rows, axes)
        if drawn is None:
            return None
        self._text(FIGURE, drawn)
        return str(self.path / FIGURE)

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
