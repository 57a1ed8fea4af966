"""Result of a sweep: means of each point over scenes and seeds, with n and 95 % intervals."""

import csv
import functools
import io
import math
import subprocess
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from .folder import row_key, term_columns
from .intervals import mean, rate, rate_difference
from .plan import BASE
from .runs import TERM, Row

NOTES = (
    "Means over scenes and seeds with 95 % intervals, clustered by scene: Korn and Graubard's "
    "intervals for rates, Student's t intervals for all other columns. n is the number of runs. If "
    "there is a single scene, intervals are over its runs and say nothing about other scenes. The "
    "reward of each point uses the weights of this point: if weights differ, compare the terms."
)
DIFFERENCE_NOTES = (
    "Differences are paired over scenes and seeds. If a difference is positive, the value of the "
    "variant is larger than that of the base. The intervals are not adjusted for the number of "
    "variants."
)


class TableColumn(NamedTuple):
    """Column of the table."""

    name: str
    """Name of the column in the rows."""
    title: str
    factor: float = 1.0
    """Factor from the unit of the rows to the unit of the table."""
    digits: int = 3
    """Number of decimal places."""


TABLE_COLUMNS = (
    TableColumn("passed", "passed, %", 100.0, 1),
    TableColumn("valid", "valid, %", 100.0, 1),
    TableColumn("reward", "reward"),
    TableColumn("d_pen_m", "D_pen, mm", 1e3),
    TableColumn("d_drift", "D_drift"),
    TableColumn("s_sem", "S_sem"),
    TableColumn("prior", "prior"),
    TableColumn("mean_log_scale", "mean log scale"),
    TableColumn("xy_error_m", "xy error, mm", 1e3, 1),
    TableColumn("yaw_error_deg", "yaw error, deg", 1.0, 2),
    TableColumn("scale_error", "log scale error"),
    TableColumn("box_iou", "box IoU"),
    TableColumn("iterations", "iterations", 1.0, 2),
    TableColumn("rollouts", "rollouts", 1.0, 1),
    TableColumn("iterations_to_valid", "iterations to valid", 1.0, 2),
    TableColumn("rollouts_to_valid", "rollouts to valid", 1.0, 1),
    TableColumn("to_valid_s", "time to valid, s"),
    TableColumn("seconds", "search, s"),
)
RATES = ("passed", "valid")
"""Columns whose means are rates."""


@dataclass(frozen=True)
class SweepResult:
    """Result of a sweep or an ablation."""

    rows: list[Row]
    """One row per scene, point and seed; see `runs.compute`."""
    points: list[dict[str, Any]]
    """Summary of each point over scenes and seeds: n, and an `Estimate` of each column as a
    dictionary."""
    differences: list[dict[str, Any]]
    """Differences of an ablation's variants from the base, paired over scenes and seeds; empty for
    a sweep."""
    table: str
    """Tables of the points and of the differences as Markdown."""
    about: dict[str, Any]
    """Content of sweep.json."""


def result_of(rows: Sequence[Row], about: Mapping[str, Any]) -> SweepResult:
    """Summarize the rows of a sweep or an ablation.

    Args:
        rows: the rows, in the order of the table.
        about: content of sweep.json.
    """
    points = [point["label"] for point in about["points"]]
    summaries = [
        _estimates(rows, point, [(row,) for row in rows if row["point"] == point], _of_values)
        for point in points
    ]
    summaries = [each for each in summaries if each["n"]]
    compared = _differences(rows, points) if about["kind"] == "ablation" else []
    notes = f"{NOTES} Commit {about['commit'] or 'unknown'}."
    markdown = f"# {about['kind'].capitalize()}\n\n{markdown_table(notes, summaries)}"
    if compared:
        table = markdown_table(DIFFERENCE_NOTES, compared, signed=True)
        markdown += f"\n## Differences from the base\n\n{table}"
    return SweepResult(list(rows), summaries, compared, markdown, dict(about))


def _differences(rows: Sequence[Row], points: Sequence[str]) -> list[dict[str, Any]]:
    base = {row_key(row): row for row in rows if row["point"] == BASE}
    compared = []
    for point in points:
        pairs = [
            (row, base[row["scene"], BASE, row["seed"]])
            for row in rows
            if row["point"] == point != BASE and (row["scene"], BASE, row["seed"]) in base
        ]
        if pairs:
            compared.append(_estimates(rows, point, pairs, _of_pairs))
    return compared


def _estimates(
    rows: Sequence[Row],
    point: str,
    groups: Sequence[tuple[Row, ...]],
    estimate: Callable[[str, Sequence[Any], Sequence[str]], dict[str, Any]],
) -> dict[str, Any]:
    scenes = [group[0]["scene"] for group in groups]
    result: dict[str, Any] = {"point": point, "n": len(groups), "scenes": len(set(scenes))}
    for column in _columns(rows):
        values = [tuple(row.get(column.name) for row in group) for group in groups]
        known = [k for k, group in enumerate(values) if all(map(_is_finite, group))]
        if known:
            known_scenes = [scenes[k] for k in known]
            result[column.name] = estimate(column.name, [values[k] for k in known], known_scenes)
    return result


def _is_finite(value: Any) -> bool:
    return value is not None and math.isfinite(value)


def _columns(rows: Sequence[Row]) -> list[TableColumn]:
    further = (TableColumn(name, name.removeprefix(TERM)) for name in term_columns(rows))
    return [*TABLE_COLUMNS, *further]


def _of_values(name: str, values: Sequence[tuple[Any]], scenes: Sequence[str]) -> dict[str, Any]:
    estimate = rate if name in RATES else mean
    return estimate([value for (value,) in values], scenes)._asdict()


def _of_pairs(name: str, pairs: Sequence[tuple[Any, Any]], scenes: Sequence[str]) -> dict[str, Any]:
    if name in RATES:
        return rate_difference([a for a, _ in pairs], [b for _, b in pairs], scenes)._asdict()
    return mean([float(a) - float(b) for a, b in pairs], scenes)._asdict()


def flat(summaries: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return summaries without nesting.

    The mean of a column has the name of the column. The other values have a suffix: `_low`,
    `_high` and `_n`.
    """
    return [
        {"point": row["point"], "n": row["n"], "scenes": row["scenes"]}
        | {
            name if part == "mean" else f"{name}_{part}": value
            for name, estimate in row.items()
            if isinstance(estimate, dict)
            for part, value in estimate.items()
            if part != "scenes"
        }
        for row in summaries
    ]


def comma_separated(summaries: Sequence[dict[str, Any]]) -> str:
    """Return summaries as CSV, in the units of `runs.COLUMNS`."""
    rows = flat(summaries)
    text = io.StringIO()
    writer = csv.DictWriter(text, list(dict.fromkeys(name for row in rows for name in row)))
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def markdown_table(note: str, summaries: Sequence[dict[str, Any]], *, signed: bool = False) -> str:
    """Return summaries as a Markdown table of formatted means with intervals.

    Args:
        note: text that explains the table.
        summaries: points or differences of a result.
        signed: if True, positive values get a plus sign.
    """
    columns = [column for column in _columns(summaries) if any(column.name in s for s in summaries)]
    head = ["point", "n", "scenes", *(column.title for column in columns)]
    rows = [
        [row["point"].replace("|", r"\|"), str(row["n"]), str(row["scenes"])]
        + [_cell(row.get(column.name), column, row["n"], signed) for column in columns]
        for row in summaries
    ]
    rule = ["---", *["---:"] * (len(head) - 1)]
    return f"{note}\n\n" + "".join(f"| {' | '.join(row)} |\n" for row in (head, rule, *rows))


def _cell(estimate: dict[str, Any] | None, column: TableColumn, n: int, signed: bool) -> str:
    if estimate is None:
        return ""
    middle, low, high = (
        f"{estimate[part] * column.factor:{'+' if signed else ''}.{column.digits}f}"
        for part in ("mean", "low", "high")
    )
    text = f"{middle} [{low}, {high}]" if math.isfinite(estimate["low"]) else middle
    # Some runs lack a value, such as the time to valid of a run that never became valid.
    return text if estimate["n"] == n else f"{text} (n {estimate['n']})"


@functools.cache
def commit() -> str | None:
    """Return the commit of the code, or None outside a repository.

    If tracked files differ from the commit, a "+" is appended.
    """
    here = Path(__file__).parent

    def git(*arguments: str) -> str:
        return subprocess.run(
            ["git", "-C", str(here), *arguments],
            capture_output=True,
            text=True,
            check=True,
            timeout=20,
        ).stdout.strip()

    try:
        git("ls-files", "--error-unmatch", Path(__file__).name)
        changed = git("status", "--porcelain", "--untracked-files=no")
        return git("rev-parse", "--short=10", "HEAD") + ("+" if changed else "")
    except (OSError, subprocess.SubprocessError):
        return None
