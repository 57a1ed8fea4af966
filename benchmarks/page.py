"""Write docs/benchmarks.md and the pages of docs/benchmarks/ from `benchmarks/figures`.

    uv run python -m benchmarks.page

A figure is a YAML file with the fields of `Figure`, or the JSON printed by `neoworld bench run
SUITE --json` or `python -m benchmarks SUITE --json`. `page.yaml` lists the pages, the figures of
each, and the tables of the front page.
"""

import json
import re
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ConfigDict, Field

ROOT = Path(__file__).parents[1]
FIGURES = ROOT / "benchmarks" / "figures"
DOCS = ROOT / "docs"
MARK = "<!-- Written by `uv run python -m benchmarks.page` from benchmarks/figures. -->"


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
    """Date on which the figures were recorded."""
    commit: str = ""
    """Commit that was measured, or the last one before the measurement."""
    text: str = ""
    """Markdown before the table."""
    columns: list[str] = Field(default_factory=list)
    rows: list[list[str]] = Field(default_factory=list)
    notes: str = ""
    """Markdown after the table."""
    superseded: str = ""
    """Change since the measurement, if it has not been repeated; empty otherwise."""


class Page(BaseModel):
    """A page of docs/benchmarks/."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    """File name without suffix."""
    title: str
    intro: str
    figures: list[str]
    """File names of figures without suffix."""


class Contents(BaseModel):
    """Contents of `figures/page.yaml`: the front page and its subpages."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    intro: str
    key: list[str]
    """Figures whose tables are on the front page."""
    pages: list[Page]


def pages() -> dict[Path, str]:
    """Return the text of every page by its path in docs/."""
    text = (FIGURES / "page.yaml").read_text(encoding="utf-8")
    contents = Contents.model_validate(yaml.safe_load(text))
    return {Path("benchmarks.md"): _front_page(contents)} | {
        Path("benchmarks") / f"{page.name}.md": _page(page) for page in contents.pages
    }


def _front_page(contents: Contents) -> str:
    parts = ["# Benchmarks", MARK, contents.intro.strip()]
    for name in contents.key:
        figure = read_figure(name)
        home = next(page.name for page in contents.pages if name in page.figures)
        parts += [
            f"## {figure.title}",
            f"{figure.device}. n: {figure.n}. "
            f"[Conditions and notes](benchmarks/{home}.md#{anchor(figure.title)}).",
            *_superseded(figure),
            _table(figure),
        ]
    parts.append("## All figures")
    lines = []
    for page in contents.pages:
        titles = "; ".join(read_figure(name).title for name in page.figures)
        lines.append(f"- [{page.title}](benchmarks/{page.name}.md): {titles}.")
    parts.append("\n".join(lines))
    return "\n\n".join(parts) + "\n"


def _page(page: Page) -> str:
    parts = [f"# {page.title}", MARK, page.intro.strip()]
    parts += [markdown(read_figure(name)) for name in page.figures]
    return "\n\n".join(parts) + "\n"


def anchor(title: str) -> str:
    """Return the anchor that MkDocs gives a heading."""
    return re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", title).strip().lower())


def read_figure(name: str) -> Figure:
    """Read a YAML or JSON figure of `benchmarks/figures`."""
    if (FIGURES / f"{name}.json").exists():
        return from_result(json.loads((FIGURES / f"{name}.json").read_text(encoding="utf-8")))
    text = (FIGURES / f"{name}.yaml").read_text(encoding="utf-8")
    return Figure.model_validate(yaml.safe_load(text))


def from_result(result: dict[str, Any]) -> Figure:
    """Convert the JSON that a suite prints into a figure.

    The table holds `rows`, otherwise the first list of records, otherwise the numeric values.
    """
    machine = result["machine"]
    tables = [v for v in result.values() if isinstance(v, list) and v and isinstance(v[0], dict)]
    values = {key: value for key, value in result.items() if isinstance(value, int | float)}
    rows = result.get("rows") or next(iter(tables), [values])
    columns = [key for key, value in rows[0].items() if not isinstance(value, list | dict)]
    return Figure(
        title=f"{result['suite']}, as printed",
        suite=result["suite"],
        command=result["command"],
        device=f"{machine['processor']}, {machine['cores']} cores; {', '.join(machine['devices'])}",
        software=", ".join(f"{k} {v}" for k, v in machine["versions"].items()),
        n=f"rows: {len(rows)}",
        date=result["date"],
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
        f"**Recorded:** {date}",
    ]
    parts = [f"## {figure.title}", "  \n".join(conditions), *_superseded(figure)]
    if figure.text:
        parts.append(figure.text.strip())
    if figure.columns:
        parts.append(_table(figure))
    if figure.notes:
        parts.append(figure.notes.strip())
    return "\n\n".join(parts)


def _superseded(figure: Figure) -> list[str]:
    return [f"**Superseded:** {figure.superseded}"] if figure.superseded else []


def _table(figure: Figure) -> str:
    lines = [figure.columns, ["---"] * len(figure.columns), *figure.rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _cell(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    return "" if value is None else str(value)


if __name__ == "__main__":
    for path, text in pages().items():
        (DOCS / path).parent.mkdir(exist_ok=True)
        (DOCS / path).write_text(text, encoding="utf-8")
