"""Tables of a sweep: each point over its scenes and seeds, with n and 95 % intervals, as Markdown,
CSV and LaTeX.
"""

import csv
import io
import math
import re
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from .plan import BASE
from .run_rows import TERM, Row, term_columns
from .stats import Estimate, mean, rate, rate_difference


class Shown(NamedTuple):
    """A column of the table."""

    name: str
    title: str
    factor: float = 1.0
    digits: int = 3


SHOWN = (
    Shown("passed", "passed", 100.0, 1),
    Shown("valid", "valid", 100.0, 1),
    Shown("reward", "reward"),
    Shown("d_pen_m", "D_pen, mm", 1e3),
    Shown("d_drift", "D_drift"),
    Shown("s_sem", "S_sem"),
    Shown("prior", "prior"),
    Shown("mean_log_scale", "mean log scale"),
    Shown("xy_error_m", "xy error, mm", 1e3, 1),
    Shown("yaw_error_deg", "yaw error, deg", 1.0, 2),
    Shown("scale_error", "log scale error"),
    Shown("box_iou", "box IoU"),
    Shown("iterations", "iterations", 1.0, 2),
    Shown("rollouts", "rollouts", 1.0, 1),
    Shown("to_valid_s", "time to valid, s"),
    Shown("seconds", "search, s"),
)
RATES = ("passed", "valid")


def shown_columns(rows: Sequence[Row]) -> list[Shown]:
    """Return the table's columns: SHOWN, and the reward terms that SHOWN does not list."""
    return [*SHOWN, *(Shown(name, name.removeprefix(TERM)) for name in term_columns(rows))]


def summary(rows: Sequence[Row], points: Sequence[str]) -> list[dict[str, Any]]:
    """Sum up each point over scenes and seeds: n, and mean, low and high of each column."""
    return [
        {"point": point, "n": len(own), **_estimates(rows, lambda n, own=own: _estimate(own, n))}
        for point in points
        for own in [[row for row in rows if row["point"] == point]]
    ]


def differences(rows: Sequence[Row], points: Sequence[str]) -> list[dict[str, Any]]:
    """Sum up each point's differences from the base, paired over scenes and seeds."""
    row_at = {(row["scene"], row["point"], row["seed"]): row for row in rows}
    differing = []
    for point in points:
        if point == BASE:
            continue
        pairs = [
            (row, row_at[scene, BASE, seed])
            for (scene, at, seed), row in row_at.items()
            if at == point and (scene, BASE, seed) in row_at
        ]
        estimates = _estimates(rows, lambda name, pairs=pairs: _difference(pairs, name))
        differing.append({"point": point, "n": len(pairs), **estimates})
    return differing


def _estimates(rows: Sequence[Row], estimate: Callable[[str], Estimate]) -> dict[str, Any]:
    estimates = {column.name: estimate(column.name) for column in shown_columns(rows)}
    return {name: e._asdict() for name, e in estimates.items() if e.n}


def _estimate(rows: Sequence[Row], name: str) -> Estimate:
    values = [row[name] for row in rows if _known(row.get(name))]
    return rate(values) if name in RATES else mean(values)


def _difference(pairs: Sequence[tuple[Row, Row]], name: str) -> Estimate:
    both = [(a[name], b[name]) for a, b in pairs if _known(a.get(name)) and _known(b.get(name))]
    if name in RATES:
        return rate_difference([a for a, _ in both], [b for _, b in both])
    return mean([a - b for a, b in both])


def _known(value: Any) -> bool:
    return value is not None and math.isfinite(value)


def markdown(
    title: str, summed: Sequence[dict[str, Any]], against: Sequence[dict[str, Any]], notes: str
) -> str:
    """Write tables as Markdown: points, and differences from the base where there are any."""
    text = f"# {title}\n\n{notes}\n\n{_table(summed, signed=False)}"
    if against:
        text += "\n## Differences from the base\n\n"
        text += "Paired over scenes and seeds; positive is more than the base.\n\n"
        text += _table(against, signed=True)
    return text


def flat(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return summaries with one value a column: the mean by its name, `_low`, `_high` and `_n`."""
    return [
        {"point": row["point"], "n": row["n"]}
        | {
            name if part == "mean" else f"{name}_{part}": value
            for name, estimate in row.items()
            if isinstance(estimate, dict)
            for part, value in estimate.items()
        }
        for row in rows
    ]


def comma_separated(summed: Sequence[dict[str, Any]]) -> str:
    """Write a summary as CSV, in the units of the columns of `run_rows.COLUMNS`."""
    rows = flat(summed)
    text = io.StringIO()
    writer = csv.DictWriter(text, list(dict.fromkeys(name for row in rows for name in row)))
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def latex(title: str, summed: Sequence[dict[str, Any]], *, signed: bool = False) -> str:
    """Write a summary as a LaTeX table for the package booktabs."""
    head, *lines = (list(map(_escaped, line)) for line in _lines(summed, signed=signed))
    body = "".join(f"{' & '.join(line)} \\\\\n" for line in lines)
    return (
        f"% {title}. Needs \\usepackage{{booktabs}}. Means with 95 % intervals.\n"
        f"\\begin{{tabular}}{{l{'r' * (len(head) - 1)}}}\n\\toprule\n"
        f"{' & '.join(head)} \\\\\n\\midrule\n{body}\\bottomrule\n\\end{{tabular}}\n"
    )


_SPECIAL = re.compile(r"[&%$#_{}~^\\]")
_WRITTEN = {"~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "\\": r"\textbackslash{}"}


def _escaped(cell: str) -> str:
    """Return a cell in which LaTeX finds no command."""
    return _SPECIAL.sub(lambda match: _WRITTEN.get(match[0], f"\\{match[0]}"), cell)


def _table(rows: Sequence[dict[str, Any]], *, signed: bool) -> str:
    lines = [[cell.replace("|", "\\|") for cell in line] for line in _lines(rows, signed=signed)]
    head = ["---"] + ["---:"] * (len(lines[0]) - 1)
    return "".join(f"| {' | '.join(line)} |\n" for line in [lines[0], head, *lines[1:]])


def _lines(rows: Sequence[dict[str, Any]], *, signed: bool) -> list[list[str]]:
    """Return the cells of a table, its head first."""
    used = [column for column in shown_columns(rows) if any(column.name in row for row in rows)]
    titles = [f"{column.title}, %" if column.name in RATES else column.title for column in used]
    lines = [["point", "n", *titles]]
    lines += [
        [row["point"], str(row["n"])]
        + [_cell(row.get(column.name), column, row["n"], signed) for column in used]
        for row in rows
    ]
    return lines


def _cell(estimate: dict[str, Any] | None, column: Shown, n: int, signed: bool) -> str:
    if estimate is None:
        return ""
    sign = "+" if signed else ""
    number = lambda x, s="": f"{x * column.factor:{s}.{column.digits}f}"
    text = number(estimate["mean"], sign)
    if math.isfinite(estimate["low"]):
        text += f" [{number(estimate['low'], sign)}, {number(estimate['high'], sign)}]"
    # Some runs lack this value, such as the time to valid of a run that never was valid.
    return text if estimate["n"] == n else f"{text} (n {estimate['n']})"
