"""Mutation score: change one token of a module, and see whether its direct tests notice.

cosmic-ray's operators make the mutants; each worker changes a copy of the repository of its own.
Signatures, annotations and decorators are left as they are.
"""

import ast
import hashlib
import importlib.util
import itertools
import json
import os
import queue
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import yaml

from benchmarks.seed_rows import log_row, logged_rows
from benchmarks.suites import Mutation
from neoworld_mjx.errors import ConfigError

ROOT = Path(__file__).parents[1]
TABLE = ROOT / "benchmarks/mutation.yaml"
_ARITHMETIC, _ORDER = "(Add|Sub|Mul|Div|Mod|Pow|FloorDiv)", "(Eq|NotEq|Lt|LtE|Gt|GtE)"
OPERATORS = re.compile(
    rf"core/(ReplaceBinaryOperator_({_ARITHMETIC}_{_ARITHMETIC}|BitOr_BitAnd|BitAnd_BitOr)"
    rf"|ReplaceComparisonOperator_({_ORDER}_{_ORDER}|Is_IsNot|IsNot_Is)|ReplaceUnaryOperator_.*"
    r"|AddNot|Replace(True|False|And|Or|Break|Continue)With.*|NumberReplacer|ZeroIterationForLoop)"
)
"""Operators that give code which runs; shifts of floats and the like would only raise the score."""
SKIPPED = (".git", ".venv", "__pycache__", ".pytest_cache", ".ruff_cache")
LEAST_LIMIT_S, LIMIT_FACTOR = 60.0, 6.0
"""Limit of a mutant's tests: the factor times the time of the unchanged module's tests."""
REASON_LINES = 40
"""Lines of the output that are shown where the tests of an unchanged module fail."""
NAMED_BY = ("module", "line", "becomes")
"""Fields that identify a survivor in the list of explained ones."""


def occurrences(module: str) -> list[tuple[str, str, int]]:
    """Return every (module, operator, occurrence) of a module."""
    from cosmic_ray.ast import ast_nodes, get_ast
    from cosmic_ray.plugins import get_operator, operator_names

    nodes = [*ast_nodes(get_ast((ROOT / module).read_text()))]
    found = []
    for name in filter(OPERATORS.fullmatch, operator_names()):
        operator = get_operator(name)()
        count = sum(len([*operator.mutation_positions(node)]) for node in nodes)
        found += [(module, name, k) for k in range(count)]
    return found


def mutate(module: str, operator: str, occurrence: int) -> dict[str, Any] | None:
    """Return a mutant; None if it does not compile, or changes a signature or a decorator."""
    from cosmic_ray.mutating import mutate_code
    from cosmic_ray.plugins import get_operator

    source = (ROOT / module).read_text()
    text = mutate_code(source, get_operator(operator)(), occurrence) or source
    rows = [*itertools.zip_longest(source.splitlines(), text.splitlines())]
    changed = [k for k, (before, after) in enumerate(rows) if before != after]
    if len(changed) != 1 or changed[0] + 1 in _fixed_lines(source):
        return None
    try:
        compile(text, module, "exec", dont_inherit=True)
    except (SyntaxError, SyntaxWarning):
        return None
    line, becomes = (row.strip() for row in rows[changed[0]])
    named = {"module": module, "number": changed[0] + 1, "line": line, "becomes": becomes}
    return {**named, "text": text}


def _fixed_lines(source: str) -> set[int]:
    """Return the lines of signatures, annotated fields and decorators."""
    fixed: set[int] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef):
            fixed |= {*range(node.lineno, node.body[0].lineno)}
            fixed |= {decorator.lineno for decorator in node.decorator_list}
        elif isinstance(node, ast.AnnAssign):
            fixed |= {*range(node.lineno, (node.annotation.end_lineno or node.lineno) + 1)}
    return fixed


def run_tests(copy: Path, tests: list[str], limit_s: float) -> tuple[str, str]:
    """Run tests in a copy: "survived" if all pass, else "killed" or "timeout"; with the output."""
    others = [p for p in os.environ.get("PYTHONPATH", "").split(os.pathsep) if p]
    others = [p for p in others if not Path(p).resolve().is_relative_to(ROOT)]
    paths = [str(copy), str(copy / "benchmarks"), str(copy / "kernels"), *others]
    environ = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(paths)}
    environ.pop("JAX_COMPILATION_CACHE_DIR", None)  # Each copy has its own, in .pytest_cache.
    command = [sys.executable, "-m", "pytest", "-x", "-q", *tests]
    try:
        done = subprocess.run(
            command, cwd=copy, env=environ, capture_output=True, timeout=limit_s, check=False
        )
    except subprocess.TimeoutExpired:
        return "timeout", ""
    said = (done.stdout + done.stderr).decode(errors="replace")
    return "survived" if done.returncode == 0 else "killed", said


def run_suite(o: Mutation) -> dict[str, Any]:
    """Mutate modules, and return the score with the surviving mutants."""
    if importlib.util.find_spec("cosmic_ray") is None:
        raise ConfigError("mutation needs cosmic-ray: install the extra mutation")
    table = yaml.safe_load(TABLE.read_text())
    modules = {m: t for m, t in table["modules"].items() if not o.module or m in o.module}
    places = [place for module in modules for place in occurrences(module)]
    random.Random(o.seed).shuffle(places)
    mutants = filter(None, (mutate(*place) for place in places))
    rows = [*itertools.islice(mutants, o.sample or None)]
    known = {row["key"]: row["outcome"] for row in logged_rows(o.log)}
    for row in rows:
        files = [ROOT / test.partition("::")[0] for test in modules[row["module"]]]
        texts = [row["text"], *(path.read_text() for path in files)]
        row["key"] = hashlib.sha256("\0".join(texts).encode()).hexdigest()[:16]
        row["outcome"] = known.get(row["key"])
    with tempfile.TemporaryDirectory() as folder:
        _try_all([row for row in rows if row["outcome"] is None], modules, Path(folder), o)
    skipped = sorted({row["module"] for row in rows if row["outcome"] is None})
    rows = [row for row in rows if row["outcome"] is not None]
    left = [
        {k: row[k] for k in ("number", *NAMED_BY)} for row in rows if row["outcome"] == "survived"
    ]
    explained = [
        [entry["module"], entry["line"], becomes]
        for entry in table["explained"]
        for becomes in (
            [entry["becomes"]] if isinstance(entry["becomes"], str) else entry["becomes"]
        )
    ]
    survivors = [row for row in left if [row[key] for key in NAMED_BY] not in explained]
    counted = len(rows) - len(left) + len(survivors)
    score = 1 - len(survivors) / counted if counted else None
    sizes = {"places": len(places), "tried": len(rows), "explained": len(left) - len(survivors)}
    sizes |= {"skipped": skipped}
    return {"score": score, "seed": o.seed, **sizes, "survivors": survivors}


def _try_all(
    rows: list[dict[str, Any]], modules: dict[str, list[str]], folder: Path, o: Mutation
) -> None:
    """Run the tests of every mutant, and set its outcome."""
    copies: queue.Queue[Path] = queue.Queue()
    first = shutil.copytree(ROOT, folder / "0", ignore=shutil.ignore_patterns(*SKIPPED))
    limits = {}
    failing: list[tuple[str, ...]] = []

    def try_unchanged(tests: tuple[str, ...]) -> None:
        began = time.perf_counter()
        # The copies below contain what this compiles.
        outcome, said = run_tests(first, [*tests], 3600.0)
        if outcome != "survived":
            failing.append(tests)
            print("\n".join(said.splitlines()[-REASON_LINES:]), file=sys.stderr, flush=True)
            return
        limits[tests] = max(LEAST_LIMIT_S, LIMIT_FACTOR * (time.perf_counter() - began))

    with ThreadPoolExecutor(o.workers) as pool:
        list(pool.map(try_unchanged, {tuple(modules[row["module"]]) for row in rows}))
    if failing:
        names = "; ".join(" ".join(tests) for tests in failing)
        if not o.skip_failing:
            raise ConfigError(f"the tests fail without a mutation: {names}")
        print(f"skipped, because they fail without a mutation: {names}", file=sys.stderr)
        rows = [row for row in rows if tuple(modules[row["module"]]) not in failing]
    for k in range(1, o.workers):
        copies.put(Path(shutil.copytree(first, folder / str(k))))
    copies.put(first)

    def try_one(row: dict[str, Any]) -> None:
        copy, tests = copies.get(), modules[row["module"]]
        path = copy / row["module"]
        try:
            path.write_text(row["text"])
            row["outcome"], _ = run_tests(copy, tests, limits[tuple(tests)])
        finally:
            path.write_text((ROOT / row["module"]).read_text())
            copies.put(copy)
        named = {k: v for k, v in row.items() if k != "text"}
        print(json.dumps(named), file=sys.stderr, flush=True)
        log_row(o.log, named)

    with ThreadPoolExecutor(o.workers) as pool:
        list(pool.map(try_one, rows))
