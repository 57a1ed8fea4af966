"""Figures of sweeps and ablations, with one row for each value of an option.

`figures/page.yaml` describes each figure under `swept` and names its plan. A page can therefore
state how to measure a figure that has not been measured yet.
"""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal, NamedTuple

from pydantic import BaseModel, ConfigDict

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.sweeps.folder import ABOUT, RESULTS, sweep_of
from neoworld_mjx.sweeps.intervals import holm
from neoworld_mjx.sweeps.plan import (
    BASE,
    Ablation,
    Plan,
    plain_value,
    point_of,
    read_plan,
    shared_config,
    value_at,
)
from neoworld_mjx.sweeps.run_rows import Row, read_runs
from neoworld_mjx.sweeps.table import TABLE_COLUMNS, differences, summary, table_cell

from .figure import ROOT, Figure, fingerprint
from .figure_text import table

CODE = ("neoworld_mjx/refinement", "neoworld_mjx/physics", "neoworld_mjx/measure")
"""Packages that the values of every sweep depend on."""
COLUMNS = {column.name: column for column in TABLE_COLUMNS}
SHOWN = ("passed", "merit", "xy_error_m", "yaw_error_deg", "rollouts_to_valid")
"""Columns of the table. The merit depends on options and is shown only if it is compared."""
SOFTWARE = ("python", "jax", "mujoco")
MINUS = "minus base: "
ABOVE = "scenes above:below the base"
NOISE = "noise"
"""Name of the option if the scenes of a sweep are named bench:NAME@LEVEL."""


class Swept(BaseModel):
    """A figure that is measured by a plan in `configs`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    title: str
    plan: str
    """File of the plan, relative to the repository."""
    text: str
    compared: Literal["merit", "xy_error_m"] = "xy_error_m"
    """Column that is compared with the base and tested."""

    @property
    def command(self) -> str:
        """The command that measures the figure, without the number of processes at the end."""
        verb = "ablate" if Path(self.plan).parent.name == "ablations" else "sweep"
        return f"neoworld {verb} {self.plan} --out DIR --workers"


class Factor(NamedTuple):
    """An option of the plan, or several options whose values change together."""

    name: str
    base: str
    """Value with which the other values are compared."""
    values: list[str]
    """Value of the option in each row."""


def sweep_figure(folder: Path, swept: Swept) -> Figure:
    """Return the figure of a finished sweep or ablation.

    Each value of an option is compared with the base's value over runs that agree in all other
    options. `passed` is the result of the final check at the bounds of the base. Intervals are
    clustered by scene, as in `neoworld_mjx.sweeps.intervals`. p values are corrected by Holm's
    method for all comparisons of the figure.

    Args:
        folder: the results folder of the sweep or ablation.
        swept: the entry of `figures/page.yaml` for the figure.

    Raises:
        ValueError: the folder contains no finished sweep of the figure's plan, or the plan does not
            include the base's value of an option.
    """
    about = sweep_of(folder)
    if about is None or not about.get("finished"):
        raise ValueError(f"{folder} holds no finished sweep")
    file = ROOT / swept.plan
    plan = read_plan(file, Ablation) if about["kind"] == "ablation" else read_plan(file, Plan)
    if about["plan"] != plan.model_dump(mode="json"):
        raise ValueError(f"{folder} holds a sweep of another plan than {swept.plan}")
    base = shared_config(plan).refine
    rows = [row | {"passed": _passes(row, base)} for row in read_runs(folder / RESULTS)]
    factors = _factors(plan, rows)
    summaries, compared = [], []
    for factor in factors:
        others = [each.values for each in factors if each is not factor]
        numbers: dict[tuple[Any, ...], int] = {}  # numbers of runs that differ only in this factor
        relabeled = [
            row
            | {
                "scene": row["scene"].partition("#")[0].partition("@")[0],
                "point": BASE if value == factor.base else value,
                "seed": numbers.setdefault(
                    (row["seed"], row["scene"].partition("#")[2], *rest), len(numbers)
                ),
            }
            for row, value, *rest in zip(rows, factor.values, *others, strict=True)
        ]
        labels = list(dict.fromkeys(row["point"] for row in relabeled))
        if BASE not in labels:
            raise ValueError(f"{swept.plan}: {factor.name} lacks {factor.base}, the base's value")
        summaries += [(factor, each) for each in summary(relabeled, labels)]
        compared += [(factor.name, each) for each in differences(relabeled, labels)]
    tested = [each[swept.compared] for _, each in compared]
    for entry, p in zip(tested, holm([entry["sign_p"] for entry in tested]), strict=True):
        entry["holm_p"] = p
    by_value = {(name, each["point"]): each for name, each in compared}
    column = COLUMNS[swept.compared]
    shown = [name for name in SHOWN if name != "merit" or swept.compared == "merit"]
    columns = ["option", "value", "n", *(COLUMNS[name].title for name in shown)]
    columns += [MINUS + COLUMNS["passed"].title, MINUS + column.title, ABOVE, "p"]
    cells = [_cells(factor, each, by_value, shown, swept.compared) for factor, each in summaries]
    if isinstance(plan, Ablation):
        order = sorted(range(len(cells)), key=lambda k: -summaries[k][1][swept.compared]["mean"])
        cells = [cells[k] for k in order]
    machine = about["machine"]
    scenes = len({row["scene"] for row in rows})
    apart = sum("**" in cell for line in cells for cell in line)
    low = sum(entry["holm_p"] < 0.05 for entry in tested)
    return Figure(
        title=swept.title,
        command=f"{swept.command} {machine['processes']}",
        device=f"{machine['cores']} cores, {machine['processes']} processes; "
        f"{', '.join(machine['devices'])}",
        software=", ".join(
            f"{name} {about['versions'][name]}" for name in SOFTWARE if name in about["versions"]
        ),
        n=f"{len(about['points'])} points x {len(plan.seeds)} seeds x {scenes} initial scenes: "
        f"{len(rows)} runs",
        date=datetime.fromtimestamp((folder / ABOUT).stat().st_mtime, UTC).date().isoformat(),
        commit=(about["commit"] or "")[:7],
        text=swept.text,
        columns=columns,
        keys=columns,
        rows=cells,
        notes=f"{len(tested)} values are compared with the base. Bold marks differences whose 95 % "
        f"interval excludes zero ({apart} of {2 * len(tested)}). p is that of a sign test of "
        f"{column.title.partition(',')[0]} over scenes, corrected by Holm's method for "
        f"{len(tested)} comparisons. p values below .05: {low}.",
        code={path: fingerprint(ROOT / path) for path in (*CODE, swept.plan)},
    )


def overview(figures: Sequence[Figure]) -> str:
    """Return a table of the figures' options, with the ranges of the results.

    The last column lists the values that differ from the base. Without figures, the table is an
    empty string.
    """
    titles = [COLUMNS[name].title for name in ("passed", "xy_error_m")]
    lines = []
    for figure in figures:
        rows = [dict(zip(figure.columns, row, strict=True)) for row in figure.rows]
        for option in dict.fromkeys(row["option"] for row in rows):
            own = [row for row in rows if row["option"] == option]
            ranges = []
            for title in titles:
                means = [row[title].partition(" ")[0] for row in own if row[title]]
                ends = sorted(means, key=float)
                ranges.append(f"{ends[0]} to {ends[-1]}" if ends else "")
            apart = [
                f"{row['value']} ({title.removeprefix(MINUS).partition(',')[0]})"
                for row in own
                for title, cell in row.items()
                if cell.startswith("**")
            ]
            values = "; ".join(row["value"] for row in own)
            lines.append([option, values, *ranges, "; ".join(apart) or "none"])
    head = ["option", "values", *titles, "differ from the base (interval excludes zero)"]
    return table(head, lines) if lines else ""


def _passes(row: Row, o: RefineOptions) -> bool:
    """Return whether a row passes the final check at the bounds of the base.

    If the row used other bounds, the measures in the row are compared with the bounds of the base.
    The motion of joints, which rows do not contain, is then not checked.
    """
    bounds = {name: getattr(o, name) for name in ("max_depth_m", "max_drift_m", "max_tilt_deg")}
    if all(row.get(f"refine.{name}", bound) == bound for name, bound in bounds.items()):
        return row["passed"]
    depth = row["max_depth_m"] <= bounds.pop("max_depth_m")
    return depth and all(row[name] < bound for name, bound in bounds.items())


def _factors(plan: Plan | Ablation, rows: Sequence[Row]) -> list[Factor]:
    if isinstance(plan, Ablation):
        return [Factor("variant", BASE, [row["variant"] for row in rows])]
    zipped = {path for group in plan.zip for path in group}
    groups = [*plan.zip, *((path,) for path in plan.axes if path not in zipped)]
    config = shared_config(plan)
    complete, refine = config.model_dump(mode="json"), {"refine": config.refine.model_dump()}
    factors = []
    for group in groups:
        values = {path: value_at(refine, path) for path in group}
        base = point_of(complete, values).values
        name = ", ".join(f"`{path.removeprefix('refine.')}`" for path in group)
        factors.append(Factor(name, _label(base, group), [_label(row, group) for row in rows]))
    levels = [row["scene"].partition("#")[0].partition("@")[2] for row in rows]
    if any(levels):
        factors.append(Factor(NOISE, "all", [level or "all" for level in levels]))
    return factors


def _cells(
    factor: Factor,
    summed: Mapping[str, Any],
    compared: Mapping[tuple[str, str], Mapping[str, Any]],
    shown: Sequence[str],
    tested: str,
) -> list[str]:
    n, point = summed["n"], summed["point"]
    value = f"{factor.base} (base)" if point == BASE and factor.base != BASE else point
    cells = [factor.name, value, str(n)]
    cells += [table_cell(summed.get(name), COLUMNS[name], n) for name in shown]
    difference = compared.get((factor.name, point))
    if difference is None:
        return [*cells, "", "", "", ""]
    for name in ("passed", tested):
        estimate = difference[name]
        text = table_cell(estimate, COLUMNS[name], difference["n"], signed=True)
        cells.append(f"**{text}**" if estimate["low"] > 0 or estimate["high"] < 0 else text)
    entry = difference[tested]
    p = entry["holm_p"]
    return [*cells, f"{entry['wins']}:{entry['losses']}", f"{p:.3f}" if p >= 0.001 else "< 0.001"]


def _label(values: Mapping[str, Any], group: Sequence[str]) -> str:
    return ", ".join(
        f"{value:g}" if isinstance(value, float) else str(plain_value(value))
        for value in (values[path] for path in group)
    )
