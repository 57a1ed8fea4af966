"""Result of a sweep or an ablation: rows, summaries and tables."""

import functools
import math
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .folder import CSV, LATEX, TABLE, SweepFolder
from .run_rows import Row
from .table import comma_separated, differences, summary, tests_table, text_table

NOTES = (
    "Means over scenes and seeds with 95 % intervals, clustered by scene: Korn and Graubard's "
    "intervals for rates, Student's t intervals for all other columns. n is the number of runs. If "
    "there is a single scene, intervals are over its runs and say nothing about other scenes. The "
    "reward of each point uses the weights of this point: if weights differ, compare the terms."
)
DIFFERENCE_NOTES = (
    "Differences are paired over scenes and seeds. If a difference is positive, the value of the "
    "variant is larger than that of the base."
)
TEST_NOTES = (
    "Number of scenes in which a variant is above : below the base, two-sided p value of the sign "
    "test over scenes adjusted by Holm's method, and Cohen's d of the differences."
)


@dataclass(frozen=True)
class SweepResult:
    """Result of a sweep or an ablation."""

    rows: list[Row]
    """One row per scene, point and seed.

    A row has the columns `run_rows.COLUMNS`. Under "history" it has the iterations of the run, with
    the columns `run_rows.ITERATION_COLUMNS`.
    """
    points: list[dict[str, Any]]
    """Summary of each point over scenes and seeds; see `table.summary`."""
    differences: list[dict[str, Any]]
    """Differences of an ablation's variants from the base (see `table.differences`); empty for a
    sweep."""
    table: str
    """Tables of the points, the differences and their tests as Markdown."""
    about: dict[str, Any] = field(default_factory=dict)
    """Content of sweep.json."""


def stored_result(
    rows: Sequence[Row], about: dict[str, Any], folder: SweepFolder | None, *, finished: bool
) -> SweepResult:
    """Summarize rows, and write the rows and their tables into a folder.

    Args:
        rows: rows so far, in the order of the table.
        about: content of sweep.json, to which "finished" and the sums of the times and compilations
            of "groups" are added.
        folder: folder of the sweep. If None, nothing is written.
        finished: if True, there are no further rows, and the figure is drawn.

    Raises:
        RunError: a file cannot be written.
    """
    about = {**about, "finished": finished}
    for name in ("seconds", "compilations", "compile_s"):
        about[name] = sum(group.get(name, 0) for group in about["groups"])
    present = {row["point"] for row in rows}
    labels = [point["label"] for point in about["points"] if point["label"] in present]
    summaries = summary(rows, labels)
    compared = differences(rows, labels) if about["kind"] == "ablation" else []
    if about["plan"]["fold"] and "mllm" not in about:
        for entry in (*summaries, *compared):
            # The times of runs in one computation are equal shares, so an interval is meaningless.
            if "seconds" in entry:
                entry["seconds"] |= {"low": math.nan, "high": math.nan}
    title, commit = about["kind"].capitalize(), f"Commit {about['commit'] or 'unknown'}."
    notes = f"{NOTES} {commit}"
    markdown = f"# {title}\n\n{text_table(notes, summaries).markdown()}"
    tex = text_table(f"{title}. {notes}", summaries).latex()
    if compared:
        number = f" {len(compared)} comparisons with the base. {commit}"
        tables = (
            ("Differences from the base", text_table(DIFFERENCE_NOTES, compared, signed=True)),
            ("Tests of the differences", tests_table(TEST_NOTES + number, compared)),
        )
        for head, table in tables:
            markdown += f"\n## {head}\n\n{table.markdown()}"
            tex += "\n" + table.latex()
    if folder is not None:
        axes = [name for name in about["points"][0] if name != "label"]
        texts = {TABLE: markdown, CSV: comma_separated(summaries), LATEX: tex}
        folder.write(rows, axes, texts)
        folder.write_about(about)
        if finished:
            about["figure"] = folder.write_figure(rows, axes, ranked=about["kind"] == "ablation")
    return SweepResult(list(rows), summaries, compared, markdown, about)


@functools.cache
def commit() -> str | None:
    """Return the commit of the code, or None outside a repository.

    If tracked files differ from the commit, a "+" is appended.
    """
    here = Path(__file__).parent

    def git(*arguments: str) -> str:
        return subprocess.run(
            ["git", "-C", str(here), *arguments],
            capture_output=True,
            text=True,
            check=True,
            timeout=20,
        ).stdout.strip()

    try:
        git("ls-files", "--error-unmatch", Path(__file__).name)
        changed = git("status", "--porcelain", "--untracked-files=no")
        return git("rev-parse", "--short=10", "HEAD") + ("+" if changed else "")
    except (OSError, subprocess.SubprocessError):
        return None
