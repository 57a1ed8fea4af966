"""Table of task success, alongside the paper's."""

from collections.abc import Sequence

from neoworld_mjx.io.text_tables import TextTable

from ..tasks.success_runs import SuccessRow
from ..tasks.success_summary import OF_THE_PAPER, PAPER, SHARES, success_interval

NOTE = (
    "Shares of tasks and starts in per cent, with 95% intervals, clustered by task; on_truth is "
    f"task success. Rows marked * are {OF_THE_PAPER}."
)


def success_table(rows: Sequence[SuccessRow]) -> TextTable:
    """Return a row for each method, over all initial scenes and over the evaluation half, and those
    of the paper.

    The paper's success is in the column with the closest definition.
    """
    names = [name.removeprefix("success_") for name in SHARES]
    lines = []
    for starts, subset_rows in (
        ("all", rows),
        ("evaluation", [row for row in rows if row.evaluation]),
    ):
        for method in dict.fromkeys(row.method for row in subset_rows):
            method_rows = [row for row in subset_rows if row.method == method]
            lines.append(
                [
                    method,
                    starts,
                    str(len(method_rows)),
                    *(_cell(method_rows, share) for share in SHARES),
                ]
            )
    for name, success in PAPER.items():
        cells = [f"{100 * success:.2f}" if n == "success_in_scene" else "" for n in SHARES]
        lines.append([f"{name}*", "", "", *cells])
    return TextTable(NOTE, ["method", "starts", "n", *names], lines)


def _cell(rows: Sequence[SuccessRow], share: str) -> str:
    value, low, high = success_interval(rows, share)
    text = f"{100 * (value or 0.0):.1f}"
    return text if low is None or high is None else f"{text} ({100 * low:.1f} to {100 * high:.1f})"
