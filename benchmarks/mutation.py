"""Mutation score: change one token of a module at a time, and see whether its tests notice.

    uv run --extra mutation python -m benchmarks.mutation neoworld_mjx/measure --sample 100

cosmic-ray's operators make the mutants; each worker changes a copy of the repository of its own.
The tests of `neoworld_mjx/ROOM/NAME.py` are tests/ROOM/test_NAME.py, or all fast tests of
tests/ROOM if there is no such file. Signatures, annotations and decorators are not changed. Mutants
and outcomes are printed as they come; the last line is one JSON object with the score and the
surviving mutants.
"""

import ast
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
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import tyro
from tyro.conf import Positional

ROOT = Path(__file__).parents[1]
_ARITHMETIC, _ORDER = "(Add|Sub|Mul|Div|Mod|Pow|FloorDiv)", "(Eq|NotEq|Lt|LtE|Gt|GtE)"
OPERATORS = re.compile(
    rf"core/(ReplaceBinaryOperator_({_ARITHMETIC}_{_ARITHMETIC}|BitOr_BitAnd|BitAnd_BitOr)"
    rf"|ReplaceComparisonOperator_({_ORDER}_{_ORDER}|Is_IsNot|IsNot_Is)|ReplaceUnaryOperator_.*"
    r"|AddNot|Replace(True|False|And|Or|Break|Continue)With.*|NumberReplacer|ZeroIterationForLoop)"
)
"""Operators that give code which runs; shifts of floats and the like would only raise the score."""
SKIPPED = (".git", ".venv", "__pycache__", ".pytest_cache", ".ruff_cache")
LEAST_LIMIT_S, LIMIT_FACTOR = 60.0, 6.0
"""Time limit of a mutant's tests: the factor times the time of the unchanged module's tests."""


@dataclass(frozen=True, kw_only=True)
class Mutation:
    """Change one token of a module at a time, and see whether its tests notice."""

    modules: Positional[tuple[Path, ...]] = (
        Path("neoworld_mjx/refinement"),
        Path("neoworld_mjx/measure"),
        Path("neoworld_mjx/physics/layout.py"),
        Path("neoworld_mjx/physics/placed.py"),
    )
    """Modules and folders of modules, relative to the repository."""
    sample: int = 400
    """Number of mutants, drawn from all; 0 tries all, some ten thousand."""
    seed: int = 0
    """Seed of the sample."""
    workers: int = 1
    """Processes, each with a copy of the repository and one core."""


class Mutant(NamedTuple):
    """A module with one changed line."""

    module: str
    number: int
    """Number of the changed line."""
    line: str
    becomes: str
    text: str
    """Text of the changed module."""


def modules_of(paths: Sequence[Path]) -> list[str]:
    """Return the modules among files and folders, relative to the repository."""
    files = [
        file for path in paths for file in ([path] if path.suffix else (ROOT / path).glob("*.py"))
    ]
    names = [(ROOT / file).relative_to(ROOT).as_posix() for file in files]
    return sorted(name for name in names if not name.endswith("__init__.py"))


def direct_tests(module: str) -> str:
    """Return the file or folder of a module's tests."""
    path = Path(module)
    folder = Path("tests", *path.parent.parts[1:])
    file = folder / f"test_{path.name}"
    return (file if (ROOT / file).is_file() else folder).as_posix()


def places(module: str) -> list[tuple[str, str, int]]:
    """Return every (module, operator, occurrence) of a module."""
    from cosmic_ray.ast import ast_nodes, get_ast
    from cosmic_ray.plugins import get_operator, operator_names

    nodes = [*ast_nodes(get_ast((ROOT / module).read_text()))]
    result = []
    for name in filter(OPERATORS.fullmatch, operator_names()):
        count = sum(len([*get_operator(name)().mutation_positions(node)]) for node in nodes)
        result += [(module, name, k) for k in range(count)]
    return result


def mutate(module: str, operator: str, occurrence: int) -> Mutant | None:
    """Return a mutant; None if it does not compile, or changes a signature or a decorator."""
    from cosmic_ray.mutating import mutate_code
    from cosmic_ray.plugins import get_operator

    source = (ROOT / module).read_text()
    text = mutate_code(source, get_operator(operator)(), occurrence) or source
    rows = [*itertools.zip_longest(source.splitlines(), text.splitlines(), fillvalue="")]
    changed = [k for k, (before, after) in enumerate(rows) if before != after]
    if len(changed) != 1 or changed[0] + 1 in _fixed_lines(source):
        return None
    try:
        compile(text, module, "exec", dont_inherit=True)
    except (SyntaxError, SyntaxWarning):
        return None
    line, becomes = (row.strip() for row in rows[changed[0]])
    return Mutant(module, changed[0] + 1, line, becomes, text)


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


def run_tests(copy: Path, tests: str, limit_s: float) -> bool:
    """Run tests in a copy of the repository; a run that exceeds the limit has not passed."""
    paths = os.pathsep.join(str(copy / name) for name in ("", "benchmarks", "kernels"))
    environ = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": paths}
    environ.pop("JAX_COMPILATION_CACHE_DIR", None)  # Each copy has its own, in .pytest_cache.
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-m", "not slow", tests]
    try:
        done = subprocess.run(
            command, cwd=copy, env=environ, capture_output=True, timeout=limit_s, check=False
        )
    except subprocess.TimeoutExpired:
        return False
    return done.returncode == 0


def run(options: Mutation, folder: Path) -> dict[str, object]:
    """Mutate modules in copies under a folder, and return the score with the survivors."""
    modules = modules_of(options.modules)
    drawn = [place for module in modules for place in places(module)]
    random.Random(options.seed).shuffle(drawn)
    candidates = filter(None, (mutate(*place) for place in drawn))
    mutants = [*itertools.islice(candidates, options.sample or None)]
    copies: queue.Queue[Path] = queue.Queue()
    first = Path(shutil.copytree(ROOT, folder / "0", ignore=shutil.ignore_patterns(*SKIPPED)))
    limits = {}
    for tests in sorted({direct_tests(mutant.module) for mutant in mutants}):
        began = time.perf_counter()
        # The copies below contain what this compiles.
        if not run_tests(first, tests, 3600.0):
            sys.exit(f"the tests fail without a mutation: {tests}")
        limits[tests] = max(LEAST_LIMIT_S, LIMIT_FACTOR * (time.perf_counter() - began))
    for k in range(1, options.workers):
        copies.put(Path(shutil.copytree(first, folder / str(k))))
    copies.put(first)

    def survives(mutant: Mutant) -> bool:
        copy, tests = copies.get(), direct_tests(mutant.module)
        try:
            (copy / mutant.module).write_text(mutant.text)
            passed = run_tests(copy, tests, limits[tests])
        finally:
            (copy / mutant.module).write_text((ROOT / mutant.module).read_text())
            copies.put(copy)
        print("survived" if passed else "killed", *mutant[:4], file=sys.stderr, flush=True)
        return passed

    with ThreadPoolExecutor(options.workers) as pool:
        survived = list(pool.map(survives, mutants))
    survivors = [m._asdict() for m, left in zip(mutants, survived, strict=True) if left]
    for survivor in survivors:
        del survivor["text"]
    score = 1 - len(survivors) / len(mutants) if mutants else None
    return {"score": score, "seed": options.seed, "n": len(mutants), "survivors": survivors}


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as copies_folder:
        print(json.dumps(run(tyro.cli(Mutation), Path(copies_folder))))
