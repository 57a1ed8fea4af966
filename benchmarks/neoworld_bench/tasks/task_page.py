"""The table of docs/tasks.md: `python -m neoworld_bench.tasks` writes it from the tasks."""

from pathlib import Path

from .catalogue import all_tasks
from .predicates import Every

PAGE = Path(__file__).parents[3] / "docs" / "tasks.md"
BEGIN, END = "<!-- table of tasks: generated -->", "<!-- end of the table -->"


def page(text: str) -> str:
    """Return the page with its table as the tasks are now; what is around it stays.

    Raises:
        ValueError: the page has no marks around its table.
    """
    before, _, rest = text.partition(BEGIN)
    _, mark, after = rest.partition(END)
    if not mark:
        raise ValueError(f"{PAGE.name} has no {BEGIN!r} before {END!r}")
    return f"{before}{BEGIN}\n\n{_tables()}\n{END}{after}"


def _tables() -> str:
    lines: list[str] = []
    tasks = all_tasks()
    for kind in dict.fromkeys(task.kind for task in tasks):
        rows = [task for task in tasks if task.kind == kind]
        lines += [f"### {kind.capitalize()} ({len(rows)})", ""]
        lines += ["| task | instruction | object | success |", "|---|---|---|---|"]
        lines += [
            f"| `{task.name}` | {task.instruction} | {task.object} | {task.predicate.meaning()} |"
            for task in rows
        ]
        lines += [""]
    leaves = (
        leaf
        for task in tasks
        for leaf in (task.predicate.of if isinstance(task.predicate, Every) else (task.predicate,))
    )
    sources = dict.fromkeys(leaf.source for leaf in leaves)
    lines += ["Sources of the bounds:", "", *(f"- {source}" for source in sorted(sources)), ""]
    return "\n".join(lines)
