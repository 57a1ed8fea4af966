"""Tables of text cells in Markdown, CSV and LaTeX."""

import csv
import io
import re
from collections.abc import Sequence
from typing import NamedTuple

_SPECIAL = re.compile(r"[&%$#_{}~^\\*]")
_COMMANDS = {
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "\\": r"\textbackslash{}",
    "*": r"$^\ast$",
}


class TextTable(NamedTuple):
    """Table of formatted cells."""

    note: str
    """Text above the table, possibly empty."""
    head: Sequence[str]
    rows: Sequence[Sequence[str]]

    def files(self, name: str) -> dict[str, str]:
        """Return the contents of the files NAME.md, NAME.csv and NAME.tex, by file name."""
        return {
            f"{name}.md": self.markdown(),
            f"{name}.csv": self.comma_separated(),
            f"{name}.tex": self.latex(),
        }

    def markdown(self) -> str:
        """Return the table as Markdown; all columns but the first are right-aligned."""
        rule = ["---", *["---:"] * (len(self.head) - 1)]
        lines = [f"| {' | '.join(map(_markdown_cell, row))} |" for row in (self.head, *self.rows)]
        lines.insert(1, f"| {' | '.join(rule)} |")
        return "\n".join(([self.note, ""] if self.note else []) + lines) + "\n"

    def comma_separated(self) -> str:
        """Return the table as CSV."""
        stream = io.StringIO()
        csv.writer(stream, lineterminator="\n").writerows([self.head, *self.rows])
        return stream.getvalue()

    def latex(self) -> str:
        """Return the table as LaTeX, which requires the package booktabs."""
        lines = (" & ".join(map(escape_latex, row)) for row in (self.head, *self.rows))
        # LaTeX would read a "[" after "\\" as an optional argument of "\\".
        head, *body = (f"{'{}' if line.startswith('[') else ''}{line} \\\\" for line in lines)
        columns = "l" + "r" * (len(self.head) - 1)
        lines = [f"% {self.note}", rf"\begin{{tabular}}{{{columns}}}", r"\toprule", head]
        return "\n".join([*lines, r"\midrule", *body, r"\bottomrule", r"\end{tabular}"]) + "\n"


def escape_latex(cell: str) -> str:
    """Escape the characters of a cell that LaTeX would interpret."""
    return _SPECIAL.sub(lambda match: _COMMANDS.get(match[0], f"\\{match[0]}"), cell)


def _markdown_cell(cell: str) -> str:
    return cell.replace("|", r"\|")
