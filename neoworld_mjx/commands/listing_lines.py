"""Short summaries of the results of doctor, template, examples and bench."""

import shutil
import textwrap
from collections.abc import Iterable, Mapping
from typing import Any

from .base_command import CommandResult
from .result_lines import DETAILS, count

_MIN_COLUMNS, _MAX_COLUMNS = 60, 110
MAX_FACTS = 8


def doctor_lines(result: CommandResult) -> list[str]:
    """Summarize the installation, and list each missing component with its effect and remedy."""
    if "installed" in result:
        return [f"installed: {result['installed']} in {result['folder']}"]
    versions = result["versions"]
    engines = result["engines"]
    ready = [name for name, state in engines.items() if state == "ready"]
    unavailable = [name for name in engines if name not in ready]
    packages = ", ".join(
        f"{name} {versions[name]}" for name in ("neoworld-mjx", "jax", "mujoco") if name in versions
    )
    devices = ", ".join(result["devices"])
    others = f"; unavailable: {', '.join(unavailable)}" if unavailable else ""
    rows = [
        f"machine: {count(result['cores'], 'core')}, {devices}; "
        f"Python {versions['python']}, {packages}",
        f"engines: {', '.join(ready)}{others}",
    ]
    for need in result["missing"]:
        rows += [f"missing: {need['what']}: {need['costs']}", f"  fix: {need['mend']}"]
    if not result["missing"]:
        rows.append("nothing is missing")
    return [*rows, DETAILS]


def template_lines(result: CommandResult) -> list[str]:
    """List all templates, or the parameters of one template."""
    if "templates" in result:
        names = result["templates"]
        return [
            f"{count(len(names), 'template')}:",
            *_wrapped(names),
            "use one: neoworld template NAME [--out x.py]; descriptions: -v, or --json",
        ]
    rows = [f"{result['template']}: {result['label']}"]
    rows += _wrapped(_parameter(name, p) for name, p in result["parameters"].items())
    if "program" in result:
        rows += [f"program: {result['program']}", f"next: neoworld view {result['program']}"]
    else:
        rows.append(f"its program: neoworld template {result['template']} --out x.py")
    return rows


def example_lines(result: CommandResult) -> list[str]:
    """Summarize the bundled photographs, each in one line."""
    rows = [
        f"{example['name']}: {count(example['objects'], 'object')}, "
        f"{count(example['joints'], 'joint')}; {example['shows']} ({example['licence']})"
        for example in result["examples"]
    ]
    return [*rows, f"next: neoworld reconstruct NAME --out DIR; credits and files: {DETAILS[9:]}"]


def bench_lines(result: CommandResult) -> list[str]:
    """Summarize the numbers of a benchmark, without its rows."""
    facts = list(_facts({k: v for k, v in result.items() if k not in _HEAD}))
    tables = [
        f"{len(value)} {key}" for key, value in result.items() if isinstance(value, list) and value
    ]
    rows = [f"{result['suite']}: {', '.join(tables) or 'done'}"] if "suite" in result else []
    rows += _wrapped(facts[:MAX_FACTS])
    if len(facts) > MAX_FACTS:
        rows.append(f"  and {len(facts) - MAX_FACTS} more numbers")
    if "paper" in result:
        note = f"paper: {result['paper']['note']}"
        rows += textwrap.wrap(note, _MAX_COLUMNS, initial_indent="  ", subsequent_indent="  ")
    return [*rows, DETAILS]


_HEAD = ("suite", "command", "date", "commit", "machine", "models", "paper")


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
    """Join entries by commas and wrap them to the terminal's width, without breaking entries."""
    columns = shutil.get_terminal_size((_MAX_COLUMNS, 24)).columns
    width = min(max(columns, _MIN_COLUMNS), _MAX_COLUMNS) - 2
    joined = ", ".join(entry.replace(" ", "\0") for entry in entries)
    lines = textwrap.wrap(joined, width, break_long_words=False, break_on_hyphens=False)
    return [f"  {line}".replace("\0", " ") for line in lines]
