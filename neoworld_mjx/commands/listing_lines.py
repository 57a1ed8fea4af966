"""Answers of commands that list things, in few lines: doctor, template, examples, bench."""

import shutil
import textwrap
from collections.abc import Iterable, Mapping
from typing import Any

from .base_command import CommandResult
from .result_lines import DETAILS, count

_LEAST_COLUMNS, _MOST_COLUMNS = 60, 110
MOST_FACTS = 8


def doctor_lines(result: CommandResult) -> list[str]:
    """Return what is here, then each missing thing with its cost and its remedy."""
    if "installed" in result:
        return [f"installed: {result['installed']} in {result['folder']}"]
    versions = result["versions"]
    engines = result["engines"]
    ready = [name for name, state in engines.items() if state == "ready"]
    lacking = [name for name in engines if name not in ready]
    here = ", ".join(
        f"{name} {versions[name]}" for name in ("neoworld-mjx", "jax", "mujoco") if name in versions
    )
    devices = ", ".join(result["devices"])
    rows = [
        f"here: {count(result['cores'], 'core')}, {devices}; Python {versions['python']}, {here}",
        f"engines: {', '.join(ready)}" + (f"; not here: {', '.join(lacking)}" if lacking else ""),
    ]
    for need in result["missing"]:
        rows += [f"missing: {need['what']}: {need['costs']}", f"  mend: {need['mend']}"]
    if not result["missing"]:
        rows.append("nothing is missing")
    return [*rows, DETAILS]


def template_lines(result: CommandResult) -> list[str]:
    """Return the names of all templates, or one with its parameters."""
    if "templates" in result:
        names = result["templates"]
        return [
            f"{count(len(names), 'template')}:",
            *_wrapped(names),
            "one of them: neoworld template NAME [--out x.py]; what each is: -v, or --json",
        ]
    rows = [f"{result['template']}: {result['label']}"]
    rows += _wrapped(_parameter(name, p) for name, p in result["parameters"].items())
    if "program" in result:
        rows += [f"program: {result['program']}", f"next: neoworld view {result['program']}"]
    else:
        rows.append(f"its program: neoworld template {result['template']} --out x.py")
    return rows


def example_lines(result: CommandResult) -> list[str]:
    """Return one line for each photograph."""
    rows = [
        f"{each['name']}: {count(each['objects'], 'object')}, {count(each['joints'], 'joint')}; "
        f"{each['shows']} ({each['licence']})"
        for each in result["examples"]
    ]
    return [*rows, f"next: neoworld reconstruct NAME --out DIR; credits and files: {DETAILS[9:]}"]


def bench_lines(result: CommandResult) -> list[str]:
    """Return a benchmark's numbers without its rows."""
    facts = list(_facts({k: v for k, v in result.items() if k not in _HEAD}))
    tables = [
        f"{len(value)} {key}" for key, value in result.items() if isinstance(value, list) and value
    ]
    rows = [f"{result['suite']}: {', '.join(tables) or 'done'}"] if "suite" in result else []
    rows += _wrapped(facts[:MOST_FACTS])
    if len(facts) > MOST_FACTS:
        rows.append(f"  and {len(facts) - MOST_FACTS} more numbers")
    if "paper" in result:
        theirs = f"theirs: {result['paper']['note']}"
        rows += textwrap.wrap(theirs, _MOST_COLUMNS, initial_indent="  ", subsequent_indent="  ")
    return [*rows, DETAILS]


_HEAD = ("suite", "command", "date", "machine", "models", "paper")


def _facts(result: Mapping[str, Any], prefix: str = "") -> Iterable[str]:
    for key, value in result.items():
        if isinstance(value, Mapping):
            yield from _facts(value, f"{prefix}{key} ")
        elif isinstance(value, bool) or value is None:
            yield f"{prefix}{key} {({None: 'unknown', True: 'yes', False: 'no'})[value]}"
        elif isinstance(value, float):
            yield f"{prefix}{key} {value:.4g}"
        elif not isinstance(value, list):
            yield f"{prefix}{key} {value}"


def _parameter(name: str, described: Mapping[str, Any]) -> str:
    value = described["value"]
    unit = f" {described['unit']}" if described.get("unit") else ""
    if "choices" in described:
        return f"{name} {value} ({', '.join(map(str, described['choices']))})"
    low, high = described["range"]
    return f"{name} {value:g} ({low:g} to {high:g}{unit})"


def _wrapped(entries: Iterable[str]) -> list[str]:
    """Join entries by commas into lines of the terminal's width; none is broken."""
    columns = shutil.get_terminal_size((_MOST_COLUMNS, 24)).columns
    width = min(max(columns, _LEAST_COLUMNS), _MOST_COLUMNS) - 2
    joined = ", ".join(entry.replace(" ", "\0") for entry in entries)
    lines = textwrap.wrap(joined, width, break_long_words=False, break_on_hyphens=False)
    return [f"  {line}".replace("\0", " ") for line in lines]
