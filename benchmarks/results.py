"""The page docs/results.md, with this project's measurements and the results of others."""

from pydantic import BaseModel, ConfigDict

from .figure import read_figure
from .figure_text import conditions, older, table
from .published import PUBLISHED


class ResultSection(BaseModel):
    """A section of docs/results.md. All values come from figures; a section contains no numbers."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    title: str
    text: str
    """Markdown before the tables."""
    figures: list[str]
    """File names of figures without suffix."""
    columns: list[str] = []
    """Names of the columns to show; if empty, all. A figure may lack some of them."""
    rows: list[str] = []
    """First cells of the rows to show, such as `all`; if empty, all rows."""
    published: list[str]
    """Names of tables in PUBLISHED."""


class Results(BaseModel):
    """The page docs/results.md."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    intro: str
    sections: list[ResultSection]


def results_page(page: Results, mark: str) -> str:
    """Return the text of docs/results.md.

    Args:
        page: the introduction and the sections.
        mark: comment that states what generates the page.

    Raises:
        KeyError: a section names a published table that does not exist.
    """
    parts = ["# Results", mark, page.intro.strip()]
    for section in page.sections:
        parts += [f"## {section.title}", section.text.strip()]
        for name in section.figures:
            parts += _measured(name, section)
        for name in section.published:
            known = PUBLISHED[name]
            parts.append(
                f"**Published, not measured on the same data:** {known.source}; {known.data}."
            )
            parts.append(table(known.columns, known.rows))
    return "\n\n".join(parts) + "\n"


def _measured(name: str, section: ResultSection) -> list[str]:
    figure = read_figure(name)
    chosen = [
        k for k, column in enumerate(figure.columns) if column in (section.columns or [column])
    ]
    rows = [
        [row[k] for k in chosen]
        for row in figure.rows
        if not section.rows or row[0].strip("*`") in section.rows
    ]
    return [
        f"**{figure.title}** (`{name}`)",
        conditions(figure),
        *older(figure),
        table([figure.columns[k] for k in chosen], rows),
    ]
