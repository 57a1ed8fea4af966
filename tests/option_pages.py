"""Generate docs/options.md and docs/differences-from-the-paper.md from the declared options.

Run `python -m tests.option_pages --write`.
"""

import sys
from collections.abc import Iterator
from pathlib import Path

import yaml

from neoworld_mjx.config import Config, Option, Options, list_options

_OPTIONS_HEAD = """\
# Options

This page lists all options with their defaults. `python -m tests.option_pages --write` generates
it from the declarations in `neoworld_mjx/config/`. Set options in a YAML file (`--config`), which
needs only the values that differ, or individually (`--set refine.cem.population=64`).

If you resume a run after you have changed options of a group (`parse`, `program`, `verify`,
`compose`, `refine`), the step of this group is repeated, and so are all steps that read its files.
"""


_DIFFERENCES_HEAD = """\
# Differences from the paper

The table lists every option whose default differs from the paper, with the reason.
`configs/paper.yaml` sets all of these options to the paper's values, and a test compares
that file with this list. `python -m tests.option_pages --write` generates this page from the
declarations in `neoworld_mjx/config/`.

Three differences have no option:

- MuJoCo replaces Isaac Sim.
- Valid candidates rank before invalid candidates, even if these have a higher reward.
- Before the final check, the returned scene is settled. If settling is disabled, its objects are
  snapped exactly onto their supports.

The effects that were measured are in [decisions](decisions.md). The plan
`configs/ablations/refine.yaml` measures the options of the search.

| option | default | paper | reason |
|---|---|---|---|
"""


def write_pages(root: Path) -> None:
    """Write all generated files into a checkout of the repository."""
    for name, text in (
        ("docs/options.md", options_page()),
        ("docs/differences-from-the-paper.md", differences_page()),
    ):
        (root / name).write_text(text, encoding="utf-8")


def differences_page() -> str:
    """Return the text of docs/differences-from-the-paper.md."""
    text = [_DIFFERENCES_HEAD]
    for option in list_options(Config):
        if option.difference is not None:
            value, reason = option.difference
            cells = [f"`{option.path}`", f"`{_flow(option.default)}`", f"`{_flow(value)}`", reason]
            text.append(f"| {' | '.join(cells)} |\n")
    return "".join(text)


def _flow(value: object) -> str:
    return yaml.safe_dump(value, default_flow_style=True).split("\n")[0]


def options_page() -> str:
    """Return the text of docs/options.md: one table for each group of options."""
    return _OPTIONS_HEAD + "".join(_options_group(Config(), "", "The run"))


def _options_group(group: Options, prefix: str, title: str) -> Iterator[str]:
    options = [o for o in list_options(group, prefix) if "." not in o.path[len(prefix) :]]
    if options:
        yield f"\n## {title}\n\n{_summary(group)}\n\n"
        yield "| option | default | valid | unit | meaning |\n"
        yield "|---|---|---|---|---|\n"
        yield from map(_row, options)
    for name in type(group).model_fields:
        inner = getattr(group, name)
        if isinstance(inner, Options):
            yield from _options_group(inner, f"{prefix}{name}.", f"`{prefix}{name}`")


def _row(option: Option) -> str:
    valid = ", ".join(option.values) or option.bounds
    cells = [f"`{option.path}`", f"`{_flow(option.default)}`", valid, option.unit, option.meaning]
    escaped = (cell.replace("|", r"\|") for cell in cells)
    return f"| {' | '.join(escaped)} |\n"


def _summary(group: Options) -> str:
    return (type(group).__doc__ or "").split("\n\n")[0].replace("\n    ", " ")


if __name__ == "__main__":
    if sys.argv[1:] != ["--write"]:
        sys.exit("usage: python -m tests.option_pages --write")
    write_pages(Path(__file__).parents[1])
