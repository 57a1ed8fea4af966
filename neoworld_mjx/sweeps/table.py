"""Tables of a sweep: means of each point over scenes and seeds, with n and 95 % intervals."""

import csv
import io
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from ..io.text_tables import TextTable
from .intervals import Estimate, holm, mean, paired_test, rate, rate_difference
from .plan import BASE
from .run_rows import TERM, Row, row_key, term_columns


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
    TableColumn("merit", "merit"),
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
TESTED = ("passed", "reward", "merit", "d_pen_m", "d_drift", "s_sem", "xy_error_m")
"""Columns whose differences are tested, with p values that are adjusted for the number of variants.
"""


def summary(rows: Sequence[Row], points: Sequence[str]) -> list[dict[str, Any]]:
    """Return a summary of each point: n, and an `Estimate` of each column as a dictionary."""
    return [
        _estimates(rows, point, [(row,) for row in rows if row["point"] == point], _of_values)
        for point in points
    ]


def differences(rows: Sequence[Row], points: Sequence[str]) -> list[dict[str, Any]]:
    """Return the differences of each point from the base, paired over scenes and seeds.

    A difference is an `Estimate` as a dictionary. For the columns in TESTED, it also has the
    entries of `PairedTest`, and `holm_p`, the p value adjusted for the number of points.
    """
    base = {row_key(row): row for row in rows if row["point"] == BASE}
    compared = [
        _estimates(
            rows,
            point,
            [
                (row, base[row["scene"], BASE, row["seed"]])
                for row in rows
                if row["point"] == point and (row["scene"], BASE, row["seed"]) in base
            ],
            _of_pairs,
        )
        for point in points
        if point != BASE
    ]
    for name in TESTED:
        tested = [entry[name] for entry in compared if name in entry]
        for entry, p in zip(tested, holm([entry["sign_p"] for entry in tested]), strict=True):
            entry["holm_p"] = p
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
    custom = (TableColumn(name, name.removeprefix(TERM)) for name in term_columns(rows))
    return [*TABLE_COLUMNS, *custom]


def _of_values(name: str, values: Sequence[tuple[Any]], scenes: Sequence[str]) -> dict[str, Any]:
    estimate = rate if name in RATES else mean
    return estimate([value for (value,) in values], scenes)._asdict()


def _of_pairs(name: str, pairs: Sequence[tuple[Any, Any]], scenes: Sequence[str]) -> dict[str, Any]:
    differences = [float(a) - float(b) for a, b in pairs]
    estimate: Estimate = mean(differences, scenes)
    if name in RATES:
        estimate = rate_difference([a for a, _ in pairs], [b for _, b in pairs], scenes)
    tested = paired_test(differences, scenes)._asdict() if name in TESTED else {}
    return estimate._asdict() | tested


def flat(summaries: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return summaries without nesting.

    The mean of a column has the name of the column. The other values have a suffix: `_low`,
    `_high`, `_n` and the names of the entries of a test.
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
    """Return summaries as CSV, in the units of `run_rows.COLUMNS`."""
    rows = flat(summaries)
    text = io.StringIO()
    writer = csv.DictWriter(text, list(dict.fromkeys(name for row in rows for name in row)))
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def text_table(
    note: str, summaries: Sequence[dict[str, Any]], *, signed: bool = False
) -> TextTable:
    """Return summaries as a table of formatted means with intervals.

    Args:
        note: text that explains the table.
        summaries: result of `summary` or `differences`.
        signed: if True, positive values get a plus sign.
    """
    columns = [column for column in _columns(summaries) if any(column.name in s for s in summaries)]
    head = ["point", "n", "scenes", *(column.title for column in columns)]
    rows = [
        [row["point"], str(row["n"]), str(row["scenes"])]
        + [table_cell(row.get(column.name), column, row["n"], signed=signed) for column in columns]
        for row in summaries
    ]
    return TextTable(note, head, rows)


def table_cell(
    estimate: dict[str, Any] | None, column: TableColumn, n: int, *, signed: bool = False
) -> str:
    """Format a mean with its interval, and with its number of values if this differs from `n`."""
    if estimate is None:
        return ""
    mean, low, high = (
        f"{estimate[part] * column.factor:{'+' if signed else ''}.{column.digits}f}"
        for part in ("mean", "low", "high")
    )
    text = f"{mean} [{low}, {high}]" if math.isfinite(estimate["low"]) else mean
    # Some runs lack a value, such as the time to valid of a run that never became valid.
    return text if estimate["n"] == n else f"{text} (n {estimate['n']})"


def tests_table(note: str, compared: Sequence[dict[str, Any]]) -> TextTable:
    """Return the tests of `differences` as a table: scenes won and lost, p value, effect size."""
    columns = [c for c in TABLE_COLUMNS if c.name in TESTED and any(c.name in s for s in compared)]
    # Tests do not depend on the units that the titles contain.
    head = ["point", "scenes", *(column.title.partition(",")[0] for column in columns)]
    rows = [
        [row["point"], str(row["scenes"]), *(_tested(row.get(column.name)) for column in columns)]
        for row in compared
    ]
    return TextTable(note, head, rows)


def _tested(entry: dict[str, Any] | None) -> str:
    if entry is None:
        return ""
    effect = f", d {entry['effect']:+.2f}" if math.isfinite(entry["effect"]) else ""
    return f"{entry['wins']} : {entry['losses']}, p {entry['holm_p']:.3f}{effect}"
