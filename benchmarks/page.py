"""Write docs/benchmarks.md from the measured figures in `benchmarks/figures`.

    uv run python -m benchmarks.page

A figure is a YAML file with the fields of `Figure`, or the JSON that `neoworld bench run SUITE
--json` or `python -m benchmarks SUITE --json` printed. `page.yaml` gives the introduction and the
order.
"""

import json
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ConfigDict, Field

ROOT = Path(__file__).parents[1]
FIGURES = ROOT / "benchmarks" / "figures"
PAGE = ROOT / "docs" / "benchmarks.md"
HEAD = """# Benchmarks

<!-- Written by `uv run python -m benchmarks.page` from benchmarks/figures; edit those files. -->

    neoworld bench run physics --json > rows.json    # rollouts, beside the naive loop
    neoworld bench run agreement --json              # the same verdicts from every engine?
    neoworld bench run kernels --json                # the penetration term
    neoworld bench make --out data --json            # the data set: categories and thirty scenes
    neoworld bench run scenes --out results --json   # methods on thirty scenes, with a table
    neoworld bench run joints --made M --partnet P --json   # joints and surfaces of objects
    neoworld bench run pictures OUT --json           # made scenes against their photographs
    neoworld bench run judge OUT --json              # the same by a model, from 1 to 7
    neoworld bench run refine --json                 # refinement from noisy starts
    neoworld bench run photos --json                 # errors of each step, forty scenes with truth
    neoworld bench run photos --semantic --json      # how often S_sem prefers the truth
    neoworld bench chart rows.json --out growth.svg  # cost over the number of objects

In a clone, for developers of the package:

    uv run python -m benchmarks programs --json      # hostile programs, mutants, build time
    uv run python -m benchmarks inputs --json        # generated hostile inputs, each watched
    uv run python -m benchmarks faults --json        # kills, full disks, lost providers
    uv run python -m benchmarks composing --json     # composed scenes without refit or settling
    uv run python -m benchmarks verify --json        # injected faults: detected, named, repaired
    uv run python -m benchmarks battery --json       # simulations of many objects at once
    uv run python -m benchmarks scoring --json       # scores by a slow server
    uv run python -m benchmarks readers --json       # objects and a scene in foreign programs
    uv run python -m benchmarks round-trips --json   # objects in MJCF, URDF and USD, and back

`--seed` draws other scenes and layouts. Each figure below gives its command, device and
number of repetitions (n). `benchmarks/airspeed` measures rollouts and kernels with [airspeed velocity](https://asv.readthedocs.io).

## What is measured

"""


class Figure(BaseModel):
    """A table of measured values, and what it was measured on."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    title: str
    suite: str | None = None
    command: str
    device: str
    software: str = ""
    n: str
    """Sizes and repetitions."""
    date: str
    """Date on which the figures were written down."""
    commit: str = ""
    """Commit that was measured, as far as known."""
    text: str = ""
    """Markdown before the table."""
    columns: list[str] = Field(default_factory=list)
    rows: list[list[str]] = Field(default_factory=list)
    notes: str = ""
    """Markdown after the table."""


class Group(BaseModel):
    """A section of the page."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    title: str
    figures: list[str]
    """Names of files, without ending."""


def page() -> str:
    """Return the text of docs/benchmarks.md."""
    layout = yaml.safe_load((FIGURES / "page.yaml").read_text(encoding="utf-8"))
    parts = [HEAD + layout["intro"].strip()]
    for group in map(Group.model_validate, layout["groups"]):
        parts.append(f"## {group.title}")
        parts += [markdown(read_figure(name)) for name in group.figures]
    return "\n\n".join(parts) + "\n"


def read_figure(name: str) -> Figure:
    """Read a figure of `benchmarks/figures`, of either form."""
    if (FIGURES / f"{name}.json").exists():
        return from_answer(json.loads((FIGURES / f"{name}.json").read_text(encoding="utf-8")))
    text = (FIGURES / f"{name}.yaml").read_text(encoding="utf-8")
    return Figure.model_validate(yaml.safe_load(text))


def from_answer(answer: dict[str, Any]) -> Figure:
    """Turn what a suite printed with `--json` into a figure.

    The table is that of its `rows`, else of its first list of records, else of its single values.
    """
    machine = answer["machine"]
    tables = [v for v in answer.values() if isinstance(v, list) and v and isinstance(v[0], dict)]
    values = {key: value for key, value in answer.items() if isinstance(value, int | float)}
    rows = answer.get("rows") or next(iter(tables), [values])
    columns = [key for key, value in rows[0].items() if not isinstance(value, list | dict)]
    return Figure(
        title=f"{answer['suite']}, as printed",
        suite=answer["suite"],
        command=answer["command"],
        device=f"{machine['processor']}, {machine['cores']} cores; {', '.join(machine['devices'])}",
        software=", ".join(f"{k} {v}" for k, v in machine["versions"].items()),
        n=f"rows: {len(rows)}",
        date=answer["date"],
        columns=columns,
        rows=[[_cell(row.get(key)) for key in columns] for row in rows],
    )


def markdown(figure: Figure) -> str:
    """Return a figure as a section of the page."""
    date = figure.date + (f", commit {figure.commit} or before" if figure.commit else "")
    conditions = [
        f"`{figure.command}`",
        f"**Device:** {figure.device}" + (f"; {figure.software}" if figure.software else ""),
        f"**n:** {figure.n}",
        f"**Written down:** {date}",
    ]
    parts = [f"### {figure.title}", "  \n".join(conditions)]
    if figure.text:
        parts.append(figure.text.strip())
    if figure.columns:
        lines = [figure.columns, ["---"] * len(figure.columns), *figure.rows]
        parts.append("\n".join(f"| {' | '.join(line)} |" for line in lines))
    if figure.notes:
        parts.append(figure.notes.strip())
    return "\n\n".join(parts)


def _cell(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    return "" if value is None else str(value)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
