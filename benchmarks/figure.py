"""Figures: measured values with their conditions, and a fingerprint of the code they depend on.

A figure is a YAML file of `benchmarks/figures` with the fields of `Figure`. The JSON that `neoworld
bench run SUITE --json` or `python -m benchmarks SUITE --json` prints is written as a figure by

    uv run python -m benchmarks.page --record NAME RESULT.json

A figure is marked as recorded with an older version if the code of a folder or file named in `code`
has changed since the measurement. Comments, docstrings and empty lines are ignored. The generated
pages show the mark automatically.
"""

import ast
import functools
import hashlib
import io
import tokenize
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ConfigDict, Field

ROOT = Path(__file__).parents[1]
FIGURES = ROOT / "benchmarks" / "figures"
SUFFIXES = {".py", ".pyi", ".md", ".yaml", ".json", ".js", ".css", ".html"}
"""Suffixes of the files that are part of a folder's fingerprint."""


class Figure(BaseModel):
    """A table of measured values with its conditions."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    title: str
    suite: str | None = None
    command: str
    device: str
    software: str = ""
    n: str
    """Sizes and repetitions."""
    date: str
    """Date of the measurement."""
    commit: str = ""
    """Commit that was measured, or the last commit before the measurement."""
    text: str = ""
    """Markdown before the table."""
    columns: list[str] = Field(default_factory=list)
    keys: list[str] = Field(default_factory=list)
    """Key of each column in the rows that the suite prints; empty if a person wrote the table."""
    rows: list[list[str]] = Field(default_factory=list)
    notes: str = ""
    """Markdown after the table."""
    code: dict[str, str] = Field(min_length=1)
    """Fingerprints of the folders and files that affect the values, when they were measured."""

    @property
    def changed(self) -> list[str]:
        """Folders and files whose code has changed since the measurement."""
        return [path for path, known in self.code.items() if fingerprint(ROOT / path) != known]

    def cell(self, row: str, column: str) -> str:
        """Return a cell of the table.

        Args:
            row: the first cells of the row, separated by ", "; as many as identify one row.
            column: the name of the column.

        Raises:
            KeyError: there is no such row or column, or several rows begin with these cells. The
                message lists the first cells of all rows, and all columns.
        """
        heads = [[cell.strip("`*") for cell in cells] for cells in self.rows]
        wanted = row.split(", ")
        chosen = [k for k, head in enumerate(heads) if head[: len(wanted)] == wanted]
        if len(chosen) != 1 or column not in self.columns:
            raise KeyError(
                f"{self.title}: {len(chosen)} rows for {row}/{column}; rows begin with "
                f"{', '.join(head[0] for head in heads)}; columns: {', '.join(self.columns)}"
            )
        return self.rows[chosen[0]][self.columns.index(column)]


@functools.cache
def read_figure(name: str) -> Figure:
    """Read a figure of `benchmarks/figures`."""
    text = (FIGURES / f"{name}.yaml").read_text(encoding="utf-8")
    return Figure.model_validate(yaml.safe_load(text))


def recorded(result: dict[str, Any], known: Figure | None, code: list[str]) -> Figure:
    """Return the figure of a suite's output.

    The table contains `table` of the output; if there is none, `rows`; if there are none, the first
    list of records; otherwise, the numeric values. Sizes are those of `n` in the output, or those
    of the known figure if the output contains no `n`.

    Args:
        result: the JSON that a suite prints.
        known: the figure whose title, texts and columns are kept; None for a new figure.
        code: folders and files that the values of a new figure depend on.

    Raises:
        ValueError: the table of the known figure was written by hand, or the suite does not print
            one of its columns.
    """
    if known is not None and not known.keys:
        raise ValueError(f"{known.title}: its table was written by hand; give it keys")
    machine = result.get("machine", {})
    tables = [v for v in result.values() if isinstance(v, list) and v and isinstance(v[0], dict)]
    values = {key: value for key, value in result.items() if isinstance(value, int | float)}
    rows = result.get("table") or result.get("rows") or next(iter(tables), [values])
    names = [key for key, value in rows[0].items() if not isinstance(value, list | dict)]
    keys = names if known is None else known.keys
    if missing := [key for key in keys if not any(key in row for row in rows)]:
        raise ValueError(f"{result['suite']} prints no {', '.join(missing)}: {', '.join(names)}")
    measured = {
        "suite": result["suite"],
        "command": result["command"],
        "date": result["date"],
        "commit": result.get("commit", ""),
        "rows": [[_cell(row.get(key)) for key in keys] for row in rows],
        "code": {path: fingerprint(ROOT / path) for path in (known.code if known else code)},
    }
    if isinstance(result.get("n"), str):
        measured["n"] = result["n"]
    if machine:
        devices = ", ".join(machine["devices"]).replace("cpu: cpu", "JAX on the CPU")
        cores = f"{machine['cores']} cores, load {machine['load'][0]:.1f}"
        measured["device"] = f"{machine['processor']}, {cores}; {devices}"
        measured["software"] = ", ".join(f"{k} {v}" for k, v in machine["versions"].items())
    if known is not None:
        return Figure.model_validate(known.model_dump() | measured)
    new = {"title": f"{result['suite']}, as printed", "device": "any", "n": f"rows: {len(rows)}"}
    return Figure.model_validate(new | measured | {"columns": keys, "keys": keys})


@functools.cache
def fingerprint(path: Path) -> str:
    """Return the digest of a file's code, or of all files in a folder with one of SUFFIXES."""
    files = sorted(path.rglob("*")) if path.is_dir() else [path]
    digest = hashlib.sha256()
    for file in files:
        if file.is_file() and (file == path or file.suffix in SUFFIXES):
            name = file.relative_to(path).as_posix()
            digest.update(f"{name}\0{code_of(file.name, file.read_bytes())}\0".encode())
    return digest.hexdigest()[:12]


def code_of(name: str, data: bytes) -> str:
    """Return the digest of a file, or for Python, its code without comments and docstrings."""
    if not name.endswith(".py"):
        return hashlib.sha256(data).hexdigest()
    text = data.decode()
    lines = text.splitlines()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            line, column = token.start
            lines[line - 1] = lines[line - 1][:column]
    for first, last in _docstrings(ast.parse(text)):
        lines[first - 1 : last] = [""] * (last - first + 1)
    return "\n".join(line.rstrip() for line in lines if line.strip())


def _docstrings(tree: ast.AST) -> Iterator[tuple[int, int]]:
    """Yield the first and last line of every statement that consists of a string."""
    for node in ast.walk(tree):
        value = node.value if isinstance(node, ast.Expr) else None
        if isinstance(value, ast.Constant) and isinstance(value.value, str):
            yield value.lineno, value.end_lineno or value.lineno


def _cell(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.3g}" if value == 0 or abs(value) >= 1e-3 else "under 0.001"
    if isinstance(value, int) and abs(value) > 9999:
        return f"{value:,}".replace(",", " ")
    return "" if value is None else str(value)
