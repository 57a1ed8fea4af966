"""Output folder of a sweep, whose files are rewritten after every group of runs."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..errors import RunError
from ..io import read_object
from ..io.files import write_output
from ..run_folder import LOCK, lock_folder, refuse_links
from .figure import draw
from .rank_figure import draw_ranks, ranks
from .run_rows import Key, Row, add_iterations, read_runs, row_key, write_iterations, write_runs

RESULTS, HISTORIES, ABOUT = "results.parquet", "histories.parquet", "sweep.json"
TABLE, CSV, LATEX = "table.md", "table.csv", "table.tex"
FIGURE, RANKS = "figure.svg", "ranks.svg"
"""Names of the figures. Each figure is also written as a PDF of the same name."""
FORMAT = "neoworld-sweep/1"


class SweepFolder:
    """Output folder of a sweep, which is locked until it is closed.

    Use it in a `with` statement. If the sweep is resumed, `rows` contains the completed runs.
    """

    def __init__(self, path: Path, kind: str, *, resume: bool, overwrite: bool) -> None:
        """Create the folder, or continue in an existing one.

        Args:
            path: the folder.
            kind: "sweep" or "ablation".
            resume: keep the existing rows.
            overwrite: delete the files of an earlier sweep, but no other files.

        Raises:
            RunError: the path is a file, cannot be written, is in use, or contains files that must
                not be replaced.
        """
        self.path = Path(path)
        self.rows: list[Row] = []
        self.groups: list[dict[str, Any]] = []
        """Computations that produced `rows`, as in sweep.json."""
        self.ledger: dict[str, Any] = {}
        """Calls and costs of the models that scored the runs in `rows`."""
        if self.path.exists() and not self.path.is_dir():
            raise RunError(f"{path} is a file; name a folder")
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            refuse_links(self.path)
            existing = any(entry.name != LOCK for entry in self.path.iterdir())
            if existing:
                self._refuse_foreign(kind)
            self._lock = lock_folder(self.path)
            try:
                if existing:
                    self._open_existing(kind, resume, overwrite)
                if not self.rows:
                    self.write_about({"format": FORMAT, "kind": kind, "finished": False})
            except BaseException:
                self._lock.close()
                raise
        except OSError as error:
            raise RunError(f"cannot write {path}: {error.strerror}") from None

    def __enter__(self) -> "SweepFolder":
        """Return this folder."""
        return self

    def __exit__(self, *error: object) -> None:
        """Unlock the folder."""
        self._lock.close()

    def _refuse_foreign(self, kind: str) -> dict[str, Any]:
        about = sweep_of(self.path)
        if about is None:
            raise RunError(f"{self.path} is not empty and holds no {kind}: name a new folder")
        if about["kind"] != kind:
            raise RunError(
                f"{self.path} holds another kind of run, {about['kind']}: name a new folder"
            )
        return about

    def _open_existing(self, kind: str, resume: bool, overwrite: bool) -> None:
        about = self._refuse_foreign(kind)
        if overwrite:
            for name in (RESULTS, HISTORIES, TABLE, CSV, LATEX, FIGURE, RANKS):
                (self.path / name).unlink(missing_ok=True)
                (self.path / name).with_suffix(".pdf").unlink(missing_ok=True)
        elif not resume:
            raise RunError(
                f"{self.path} holds a {kind}: continue with --resume, start over with --overwrite, "
                "or name a new folder"
            )
        else:
            ledger = about.get("mllm")
            self.ledger = ledger if isinstance(ledger, dict) else {}
            if (self.path / RESULTS).exists():
                self.rows = add_iterations(self.path / HISTORIES, read_runs(self.path / RESULTS))
                self.groups = list(about.get("groups", []))

    def completed(self, expected: Mapping[Key, str]) -> dict[Key, Row]:
        """Return the rows that need not be computed again.

        Rows are found by their fingerprints, so the labels of their points may have changed.

        Args:
            expected: fingerprint of every requested run, by scene, point and seed.

        Raises:
            RunError: the folder contains rows of runs that are not requested. These rows would be
                lost.
        """
        rows = {row["fingerprint"]: row for row in self.rows}
        known = set(expected.values())
        lost = [
            row_key(row)
            for row in self.rows
            if row["fingerprint"] not in known and row_key(row) not in expected
        ]
        if lost:
            scene, point, seed = lost[0]
            raise RunError(
                f"{self.path} has {len(lost)} rows that this plan does not contain, such as scene "
                f"{scene}, point {point}, seed {seed}: use --overwrite, or name a new folder"
            )
        return {
            run: rows[fingerprint] for run, fingerprint in expected.items() if fingerprint in rows
        }

    def write(self, rows: Sequence[Row], values: Sequence[str], texts: Mapping[str, str]) -> None:
        """Write all rows so far, and further text files.

        Args:
            rows: the runs, each with its iterations under "history".
            values: columns that distinguish points.
            texts: content of the further files, by name.

        Raises:
            RunError: a file cannot be written.
        """
        write_runs(self.path / RESULTS, rows, values)
        write_iterations(self.path / HISTORIES, rows)
        for name, text in texts.items():
            write_output(self.path / name, text, RunError)

    def write_figure(
        self, rows: Sequence[Row], axes: Sequence[str], *, ranked: bool = False
    ) -> str | None:
        """Draw the sweep, and return the path of the figure, or None if matplotlib is missing.

        Args:
            rows: the runs, each with its iterations under "history".
            axes: columns that distinguish points.
            ranked: if True, also draw the critical-difference diagram.

        Raises:
            RunError: a file cannot be written.
        """
        found = ranks(rows, list(dict.fromkeys(row["point"] for row in rows)))
        for form in ("svg", "pdf"):
            drawings = {FIGURE: draw(rows, axes, form)}
            if ranked and found is not None:
                drawings[RANKS] = draw_ranks(found, form)
            for name, drawing in drawings.items():
                if drawing is None:
                    return None
                write_output((self.path / name).with_suffix(f".{form}"), drawing, RunError)
        return str(self.path / FIGURE)

    def write_about(self, about: dict[str, Any]) -> None:
        """Write sweep.json.

        Raises:
            RunError: the file cannot be written.
        """
        write_output(self.path / ABOUT, json.dumps(about, indent=1) + "\n", RunError)


def sweep_of(path: Path) -> dict[str, Any] | None:
    """Return the content of a folder's sweep.json; None if the folder contains no sweep."""
    try:
        about = read_object(path / ABOUT, RunError)
    except RunError:
        return None
    known = about.get("format") == FORMAT and isinstance(about.get("kind"), str)
    return about if known else None
