"""Tables of a sweep: each point over its scenes and seeds, with n and 95 % intervals."""

import csv
import io
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from ..io.text_tables import TextTable
from .intervals import Estimate, mean, rate, rate_difference
from .plan import BASE
from .run_rows import TERM, Row, row_key, term_columns


class TableColumn(NamedTuple):
    """Column of the table: a column of the rows, its title and its format."""

    name: str
    title: str
    factor: float = 1.0
    digits: int = 3


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
    TableColumn("to_valid_s", "time to valid, s"),
    TableColumn("seconds", "search, s"),
)
RATES = ("passed", "valid")


def summary(rows: Sequence[Row], points: Sequence[str]) -> list[dict[str, Any]]:
    """Return n and the mean, low and high of each column, for each point."""
    return [
        _estimates(rows, point, [(row,) for row in rows if row["point"] == point], _values_estimate)
        for point in points
    ]


def differences(rows: Sequence[Row], points: Sequence[str]) -> list[dict[str, Any]]:
    """Return each point's differences from the base, paired over scenes and seeds."""
    base = {row_key(row): row for row in rows if row["point"] == BASE}
    return [
        _estimates(
            rows,
            point,
            [
                (row, base[row["scene"], BASE, row["seed"]])
                for row in rows
                if row["point"] == point and (row["scene"], BASE, row["seed"]) in base
            ],
            _pairs_estimate,
        )
        for point in points
        if point != BASE
    ]


def _estimates(
    rows: Sequence[Row],
    point: str,
    groups: Sequence[tuple[Row, ...]],
    estimate: Callable[[str, Sequence[Any]], Estimate],
) -> dict[str, Any]:
    result: dict[str, Any] = {"point": point, "n": len(groups)}
    for column in _columns(rows):
        values = [tuple(row.get(column.name) for row in group) for group in groups]
        known = [group for group in values if all(map(_known, group))]
        if known:
            result[column.name] = estimate(column.name, known)._asdict()
    return result


def _known(value: Any) -> bool:
    return value is not None and math.isfinite(value)


def _columns(rows: Sequence[Row]) -> list[TableColumn]:
    custom = (TableColumn(name, name.removeprefix(TERM)) for name in term_columns(rows))
    return [*TABLE_COLUMNS, *custom]


def _values_estimate(name: str, values: Sequence[tuple[Any]]) -> Estimate:
    return (rate if name in RATES else mean)([value for (value,) in values])


def _pairs_estimate(name: str, pairs: Sequence[tuple[Any, Any]]) -> Estimate:
    if name in RATES:
        return rate_difference([a for a, _ in pairs], [b for _, b in pairs])
    return mean([a - b for a, b in pairs])


def flat(summaries: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return summaries with one value per key: the mean by its name, `_low`, `_high` and `_n`."""
    return [
        {"point": row["point"], "n": row["n"]}
        | {
            name if part == "mean" else f"{name}_{part}": value
            for name, estimate in row.items()
            if isinstance(estimate, dict)
            for part, value in estimate.items()
        }
        for row in summaries
    ]


def comma_separated(summaries: Sequence[dict[str, Any]]) -> str:
    """Return summaries as CSV, in the units of the columns of `run_rows.COLUMNS`."""
    rows = flat(summaries)
    text = io.StringIO()
    writer = csv.DictWriter(text, list(dict.fromkeys(name for row in rows for name in row)))
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def text_table(
    note: str, summaries: Sequence[dict[str, Any]], *, signed: bool = False
) -> TextTable:
    """Return summaries as a table of formatted means with intervals."""
    columns = [column for column in _columns(summaries) if any(column.name in s for s in summaries)]
    head = ["point", "n", *(column.title for column in columns)]
    rows = [
        [row["point"], str(row["n"])]
        + [_cell(row.get(column.name), column, row["n"], signed) for column in columns]
        for row in summaries
    ]
    return TextTable(note, head, rows)


def _cell(estimate: dict[str, Any] | None, column: TableColumn, n: int, signed: bool) -> str:
    if estimate is None:
        return ""
    mean, low, high = (
        f"{estimate[part] * column.factor:{'+' if signed else ''}.{column.digits}f}"
        for part in ("mean", "low", "high")
    )
    text = f"{mean} [{low}, {high}]" if math.isfinite(estimate["low"]) else mean
    # Some runs lack a value, such as the time to valid of a run that never became valid.
    return text if estimate["n"] == n else f"{text} (n {estimate['n']})"
