"""Write the benchmark pages and tables from the figures in `benchmarks/figures`.

    uv run python -m benchmarks.page                             # all pages and tables
    uv run python -m benchmarks.page --record NAME RESULT.json   # first record a suite's output
    uv run python -m benchmarks.page --record NAME DIR           # or the folder of a sweep

`page.yaml` contains the pages of docs/benchmarks/ with their figures, the tables of the front page,
the sections of docs/results.md, and the texts between `<!-- NAME -->` and `<!-- end -->` in other
pages. These texts refer to values as {FIGURE/ROW/COLUMN}, so that no number is written twice.
"""

import json
import re
from pathlib import Path

import tyro
import yaml
from pydantic import BaseModel, ConfigDict

from .figure import FIGURES, ROOT, read_figure, recorded
from .figure_text import age, anchor, markdown, older, table
from .results import Results, results_page
from .sweep_figures import Swept, overview, sweep_figure

MARK = "<!-- Written by `uv run python -m benchmarks.page` from benchmarks/figures. -->"
REFERENCE = re.compile(r"\{([a-z0-9_]+)/([^{}/]+)/([^{}/]+)\}")


class Page(BaseModel):
    """A page of docs/benchmarks/."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    """File name without suffix."""
    title: str
    intro: str
    figures: list[str]
    """File names of figures, without suffix. Figures of `Contents.swept` may not exist yet."""
    overview: bool = False
    """If True, show a table of the options that the figures of the page compare."""


class Contents(BaseModel):
    """Contents of `figures/page.yaml`: the front page, its subpages, and tables of other pages."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    intro: str
    key: list[str]
    """Figures whose tables are on the front page."""
    pages: list[Page]
    swept: dict[str, Swept]
    """Figures that are measured by plans in `configs`, by file name without suffix."""
    results: Results
    tables: dict[str, dict[str, str]]
    """Markdown with references to values, by file and by the name of the mark in the file."""


def read_contents() -> Contents:
    """Read `figures/page.yaml`."""
    text = (FIGURES / "page.yaml").read_text(encoding="utf-8")
    return Contents.model_validate(yaml.safe_load(text))


def pages() -> dict[Path, str]:
    """Return the text of every page that contains figures, by its path in the repository.

    Raises:
        KeyError: a reference matches no value.
        ValueError: a page lacks the marks of a table.
    """
    contents = read_contents()
    written = {Path("docs/benchmarks.md"): _front_page(contents)}
    written[Path("docs/results.md")] = results_page(contents.results, MARK)
    for page in contents.pages:
        written[Path("docs/benchmarks") / f"{page.name}.md"] = _page(page, contents.swept)
    for path, tables in contents.tables.items():
        text = (ROOT / path).read_text(encoding="utf-8")
        for name, template in tables.items():
            text = _between_marks(text, name, filled(template.strip()), path)
        written[Path(path)] = text
    return written


def filled(template: str) -> str:
    """Return a template with values for its references, and with stars and a note at old values."""
    old: dict[str, str] = {}
    lines = []
    for line in template.splitlines():
        names = [match[1] for match in REFERENCE.finditer(line)]
        figures = {name: figure for name in names if (figure := read_figure(name)).changed}
        old |= {name: age(figure) for name, figure in figures.items()}
        text = REFERENCE.sub(lambda m: read_figure(m[1]).cell(m[2], m[3]), line)
        if figures:
            # The star follows the first cell of a table row, or the whole line.
            cell, bar, rest = text.removeprefix("| ").partition(" |")
            text = f"{'| ' if bar else ''}{cell}\\*{bar}{rest}"
        lines.append(text)
    notes = [f"{name} ({age})" for name, age in old.items()]
    if old:
        lines += ["", f"\\* Recorded with an older version: {', '.join(notes)}."]
    return "\n".join(lines)


def _between_marks(text: str, name: str, inner: str, path: str) -> str:
    begin, end = f"<!-- {name} -->\n", "<!-- end -->"
    before, found, rest = text.partition(begin)
    _, closed, after = rest.partition(end)
    if not found or not closed:
        raise ValueError(f"{path} lacks the marks {begin.strip()} and {end}")
    return f"{before}{begin}{inner}\n{end}{after}"


def _front_page(contents: Contents) -> str:
    parts = ["# Benchmarks", MARK, contents.intro.strip()]
    for name in contents.key:
        figure = read_figure(name)
        home = next(page.name for page in contents.pages if name in page.figures)
        parts += [
            f"## {figure.title}",
            f"{figure.device}. n: {figure.n}. "
            f"[Conditions and notes](benchmarks/{home}.md#{anchor(figure.title)}).",
            *older(figure),
            table(figure.columns, figure.rows),
        ]
    parts.append("## All figures")
    lines = []
    for page in contents.pages:
        titles = "; ".join(
            read_figure(name).title if measured(name) else contents.swept[name].title
            for name in page.figures
        )
        lines.append(f"- [{page.title}](benchmarks/{page.name}.md): {titles}.")
    parts.append("\n".join(lines))
    return "\n\n".join(parts) + "\n"


def measured(name: str) -> bool:
    """Return whether a figure exists in `benchmarks/figures`."""
    return (FIGURES / f"{name}.yaml").is_file()


def _page(page: Page, swept: dict[str, Swept]) -> str:
    parts = [f"# {page.title}", MARK, page.intro.strip()]
    if page.overview:
        parts.append(overview([read_figure(name) for name in page.figures if measured(name)]))
    for name in page.figures:
        found = measured(name)
        parts.append(markdown(read_figure(name)) if found else _unmeasured(name, swept[name]))
    return "\n\n".join(filter(None, parts)) + "\n"


def _unmeasured(name: str, swept: Swept) -> str:
    commands = (f"{swept.command} 8", f"uv run python -m benchmarks.page --record {name} DIR")
    lines = "\n".join(f"    {command}" for command in commands)
    return f"## {swept.title}\n\n**Not measured yet.**\n\n{lines}\n\n{swept.text.strip()}"


def write_figure(name: str, result: Path, code: tuple[str, ...]) -> None:
    """Write a figure from the JSON of a suite or from the folder of a sweep.

    If a suite's figure exists, its title, texts and columns are kept.

    Raises:
        ValueError: `page.yaml` contains no plan for the figure of a folder, or `recorded` or
            `sweep_figure` raises it.
    """
    file = FIGURES / f"{name}.yaml"
    if result.is_dir():
        swept = read_contents().swept
        if name not in swept:
            raise ValueError(f"no plan for {name}: page.yaml has {', '.join(swept)}")
        figure = sweep_figure(result, swept[name])
    else:
        known = read_figure(name) if file.exists() else None
        figure = recorded(json.loads(result.read_text(encoding="utf-8")), known, list(code))
    values = figure.model_dump(exclude_defaults=True)
    dump = {"sort_keys": False, "allow_unicode": True, "width": 160, "default_flow_style": None}
    file.write_text(yaml.dump(values, Dumper=_Dumper, **dump), encoding="utf-8")
    read_figure.cache_clear()


class _Dumper(yaml.SafeDumper):
    """Dumper that keeps the lines of a string with several lines."""


_Dumper.add_representer(
    str,
    lambda dumper, text: dumper.represent_scalar(
        "tag:yaml.org,2002:str", text, style="|" if "\n" in text else None
    ),
)


def main(*, record: tuple[str, Path] | None = None, code: tuple[str, ...] = ()) -> None:
    """Write all pages and tables.

    Args:
        record: name of a figure in benchmarks/figures, and its source: the JSON that a suite
            printed, or the folder of a sweep or ablation.
        code: folders and files that the values of a new figure depend on.
    """
    if record is not None:
        write_figure(*record, code)
    for path, text in pages().items():
        (ROOT / path).parent.mkdir(exist_ok=True)
        (ROOT / path).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    tyro.cli(main)
