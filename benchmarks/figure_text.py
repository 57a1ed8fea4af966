"""Figures as Markdown: table, conditions, and the mark of figures of an older version."""

import re
from collections.abc import Sequence

from .figure import Figure


def anchor(title: str) -> str:
    """Return the anchor that MkDocs gives a heading."""
    return re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", title).strip().lower())


def markdown(figure: Figure) -> str:
    """Return a figure as a section of a page."""
    parts = [f"## {figure.title}", conditions(figure), *older(figure)]
    if figure.text:
        parts.append(figure.text.strip())
    if figure.columns:
        parts.append(table(figure.columns, figure.rows))
    if figure.notes:
        parts.append(figure.notes.strip())
    return "\n\n".join(parts)


def conditions(figure: Figure) -> str:
    """Return the command, the device, the sizes and the date, one per line."""
    date = figure.date + (f", at commit {figure.commit} or an earlier one" if figure.commit else "")
    lines = [
        f"`{figure.command}`",
        f"**Device:** {figure.device}" + (f"; {figure.software}" if figure.software else ""),
        f"**n:** {figure.n}",
        f"**Recorded:** {date}",
    ]
    return "  \n".join(lines)


def older(figure: Figure) -> list[str]:
    """Return the mark of a figure of an older version; empty for a figure of this version."""
    if not figure.changed:
        return []
    folders = ", ".join(f"`{path}`" for path in figure.changed)
    mark = f"**Recorded with an older version** ({age(figure)})"
    return [f"{mark}: the code of {folders} has since changed."]


def age(figure: Figure) -> str:
    """Return the commit of a figure, or its date if it states no commit."""
    return f"commit {figure.commit}" if figure.commit else figure.date


def table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table."""
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
