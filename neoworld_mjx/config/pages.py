"""Write the pages that list options: configs/default.yaml, docs/options.md, docs/differences-from-the-paper.md."""

import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from ..options import Option, Options, list_options
from .run_config import Config

_YAML_HEAD = """\
# Every option with its default, written by `python -m neoworld_mjx.config`.
# A file of your own states only what differs:
#     neoworld reconstruct PHOTO --out DIR --config my.yaml
# A comment that begins with brackets gives the option's unit.

"""

_PAGE_HEAD = """\
# Options

Every option with its default; `python -m neoworld_mjx.config` writes this page and
`configs/default.yaml` from the declarations in `neoworld_mjx/config/`. Set options in a YAML file
(`--config`) or one by one (`--set refine.cem.population=64`).

A resumed run does a step again when the options of its group have changed (`parse`, `program`,
`verify`, `compose`, `refine`), and then all steps that read its files. The last column says what a
change costs in the search itself, and so in a [sweep](how-to/sweeps.md) over it:

- **nothing**: the value acts outside of compiled code;
- **nothing, traced**: the value is an array that compiled code takes, so all values of a sweep are
  one computation;
- **compiles**, with the reason: other values are other compiled code.
"""


_DEPARTURES_HEAD = """\
# Departures

Where the defaults depart from the paper, why, and what comes of it. `configs/paper.yaml`
switches all of it off, and a test holds that file against this list;
`python -m neoworld_mjx.config` writes the page from the declarations in `neoworld_mjx/config/`.

Three departures have no switch: MuJoCo in place of Isaac Sim; valid candidates go before others of
higher reward, those nearer to the photograph first; and the returned layout is snapped exactly onto
its supports before it is checked.

The last column says what was measured, here and as in the paper. Rollouts and seconds are means of
[ablations of the search](benchmarks/refinement.md#what-each-part-of-refinement-does), with all defaults and
with this one option as in the paper. Composed scenes are those of `python -m benchmarks composing`.
What has no effect there was not measured.

| option | here | paper | why | effect |
|---|---|---|---|---|
"""
_ABLATIONS = {
    "configs/ablations/refine.yaml": "benchmarks/figures/refine_ablation.yaml",
    "configs/ablations/departures.yaml": "benchmarks/figures/departures_ablation.yaml",
}
"""Files of variants, and their figures."""
_EFFECTS = ((1, "valid {}"), (5, "xy error {} mm"), (8, "{} rollouts"), (9, "search {} s"))
"""Columns of the ablations' figures that the page of departures shows."""


def differences_page(root: Path) -> str:
    """Return docs/differences-from-the-paper.md: every option whose default departs from the paper.

    Args:
        root: a checkout of the repository, for the ablations' variants and figures.
    """
    effects: dict[tuple[str, Any], str] = {}
    for variants, figures in _ABLATIONS.items():
        effects |= _ablated(_read(root / variants)["variants"], _read(root / figures))
    text = [_DEPARTURES_HEAD]
    for option in list_options(Config):
        if option.difference is None:
            continue
        value, reason, effect = option.difference
        effect = effect or effects.get((option.path, value), "")
        cells = [f"`{option.path}`", f"`{_shown(option.default)}`", f"`{_shown(value)}`"]
        text.append(f"| {' | '.join([*cells, reason, effect])} |\n")
    return "".join(text)


def _read(path: Path) -> dict[str, Any]:
    return yaml.safe_load(path.read_text(encoding="utf-8"))


def _ablated(
    variants: dict[str, dict[str, Any]], figures: dict[str, Any]
) -> dict[tuple[str, Any], str]:
    """Return the effect of each variant of a single option, by the option and its value."""
    rows = {row[0]: row for row in figures["rows"]}
    base, effects = rows["as it is"], {}
    for name, change in variants.items():
        if len(change) > 1 or name not in rows:
            continue
        ((path, value),) = change.items()
        own = rows[name]
        shown = [words.format(f"{base[k]} and {own[k]}") for k, words in _EFFECTS if own[k]]
        effects[path, value] = f"{'; '.join(shown)} (n = {figures['n'].split(':')[0]})"
    return effects


def _shown(value: object) -> str:
    return yaml.safe_dump(value, default_flow_style=True).split("\n")[0]


def default_yaml() -> str:
    """Return configs/default.yaml: every option under its meaning."""
    return _YAML_HEAD + "".join(_yaml_group(Config(), "", ""))


def options_page() -> str:
    """Return docs/options.md: a table of options for each group."""
    return _PAGE_HEAD + "".join(_page_group(Config(), "", "The run"))


def write_pages(root: Path) -> None:
    """Write all pages into a checkout of the repository."""
    (root / "docs" / "differences-from-the-paper.md").write_text(differences_page(root), encoding="utf-8")
    (root / "configs" / "default.yaml").write_text(default_yaml(), encoding="utf-8")
    (root / "docs" / "options.md").write_text(options_page(), encoding="utf-8")


def _yaml_group(group: Options, at: str, indent: str) -> Iterator[str]:
    by_path = {option.path: option for option in list_options(group, at)}
    for name in type(group).model_fields:
        inner = getattr(group, name)
        if isinstance(inner, Options):
            yield "\n" if not indent else ""
            yield _comment(_summary(inner), indent)
            yield f"{indent}{name}:\n"
            yield from _yaml_group(inner, f"{at}{name}.", indent + "  ")
        else:
            option = by_path[at + name]
            unit = f"[{option.unit}] " if option.unit else ""
            yield _comment(unit + option.meaning, indent)
            value = yaml.safe_dump({name: option.default}, default_flow_style=False)
            yield textwrap.indent(value, indent)


def _comment(text: str, indent: str) -> str:
    start = f"{indent}# "
    return textwrap.fill(text, 100, initial_indent=start, subsequent_indent=start) + "\n"


def _page_group(group: Options, at: str, title: str) -> Iterator[str]:
    own = [option for option in list_options(group, at) if "." not in option.path[len(at) :]]
    if own:
        yield f"\n## {title}\n\n{_summary(group)}\n\n"
        yield "| option | default | valid | unit | meaning | cost of a change |\n"
        yield "|---|---|---|---|---|---|\n"
        yield from map(_row, own)
    for name in type(group).model_fields:
        inner = getattr(group, name)
        if isinstance(inner, Options):
            yield from _page_group(inner, f"{at}{name}.", f"`{at}{name}`")


def _row(option: Option) -> str:
    default = _shown(option.default)
    valid = ", ".join(option.values) or option.bounds
    cells = [f"`{option.path}`", f"`{default}`", valid, option.unit, option.meaning, _cost(option)]
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |\n"


def _cost(option: Option) -> str:
    if option.kind == "static":
        return f"compiles: {option.reason}"
    if option.kind == "traced":
        return f"nothing, traced; but it {option.reason}" if option.reason else "nothing, traced"
    return "nothing"


def _summary(group: Options) -> str:
    return (type(group).__doc__ or "").split("\n\n")[0].replace("\n    ", " ")
