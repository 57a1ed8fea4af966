"""Tables of texts in Markdown, CSV and LaTeX."""

import csv
import io
from collections.abc import Sequence
from typing import NamedTuple


class TextTable(NamedTuple):
    """A table whose cells are written already."""

    note: str
    """Line above it: what is counted, and what is not ours."""
    head: Sequence[str]
    rows: Sequence[Sequence[str]]

    def files(self, name: str) -> dict[str, str]:
        """Return the texts of NAME.md, NAME.csv and NAME.tex."""
        return {
            f"{name}.md": self.markdown(),
            f"{name}.csv": self.comma_separated(),
            f"{name}.tex": self.latex(),
        }

    def markdown(self) -> str:
        """Return the table as Markdown."""
        lines = [self.note, "", *map(_line, (self.head, ["---"] * len(self.head), *self.rows))]
        return "\n".join(lines) + "\n"

    def comma_separated(self) -> str:
        """Return the table as CSV."""
        stream = io.StringIO()
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(self.head)
        writer.writerows(self.rows)
        return stream.getvalue()

    def latex(self) -> str:
        """Return the table as LaTeX, for the package booktabs."""
        lines = [f"% {self.note}", rf"\begin{{tabular}}{{l{'r' * (len(self.head) - 1)}}}"]
        lines += [r"\toprule", _tex(self.head), r"\midrule", *map(_tex, self.rows)]
        return "\n".join([*lines, r"\bottomrule", r"\end{tabular}"]) + "\n"


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _tex(cells: Sequence[str]) -> str:
    marks = {"_": r"\_", "%": r"\%", "&": r"\&", "*": r"$^\ast$", "#": r"\#"}
    escaped = ("".join(marks.get(c, c) for c in cell) for cell in cells)
    return " & ".join(escaped) + r" \\"
