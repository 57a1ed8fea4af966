"""Rules of the code that linters do not check."""

import ast
import re
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LIBRARY = sorted(
    path
    for folder in ("neoworld_mjx", "kernels/neoworld_kernels", "benchmarks/neoworld_bench")
    for path in (ROOT / folder).rglob("*.py")
    if path.parent.name != "programs"
)
"""Modules; object programs are no modules."""
TEXTS = sorted(
    path
    for folder in ("neoworld_mjx", "kernels", "configs", "docs", "tests", "notebooks", "examples")
    for path in (ROOT / folder).rglob("*")
    if path.suffix in (".py", ".pyi", ".md", ".yaml", ".json", ".toml", ".ipynb")
) + sorted(ROOT.glob("*.md"))

VAGUE_NAMES = re.compile(r"(Manager|Handler|Helper)$|^(utils?|helpers?|misc|common)$")
MACHINE_PATHS = re.compile(r"(?<![\w.~}])/(home|root|Users|work|mnt/data)/\w")


def _name(path):
    return path.relative_to(ROOT).as_posix()


@cache
def _tree(path):
    return ast.parse(path.read_text(encoding="utf-8"))


def _repeated(names):
    """Return the names that stand at more than one place, each with its places."""
    places = {}
    for name, path in names:
        places.setdefault(name, []).append(_name(path))
    return {name: result for name, result in places.items() if len(result) > 1}


def test_every_public_class_has_a_name_of_its_own():
    classes = [
        (node.name, path)
        for path in LIBRARY
        for node in _tree(path).body
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
    ]
    assert _repeated(classes) == {}


def _broken_rules(path):
    """Yield the rules that a module breaks, with its line."""
    tree = _tree(path)
    if not ast.get_docstring(tree):
        yield "1: say what the module is for"
    if VAGUE_NAMES.search(path.stem):
        yield "1: name the module after what it does"
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef) and VAGUE_NAMES.search(node.name):
            yield f"{node.lineno}: {node.name}: name what it is"
        if isinstance(node, ast.ImportFrom):
            if node.module == "__future__":
                yield f"{node.lineno}: annotations are needed at run time"
            if node.names[0].name == "*":
                yield f"{node.lineno}: import names"
        if isinstance(node, ast.Call) and path.name != "cli.py":
            called = node.func.id if isinstance(node.func, ast.Name) else ""
            if called == "print":
                yield f"{node.lineno}: a library logs or returns"


def test_modules_have_docstrings_and_plain_names_and_print_nothing():
    broken = [f"{_name(path)}:{rule}" for path in LIBRARY for rule in _broken_rules(path)]
    assert not broken, "\n".join(broken)


def test_no_file_holds_a_path_of_a_machine_or_an_unfinished_mark():
    result = []
    for path in TEXTS:
        if path == Path(__file__):
            continue
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
            if MACHINE_PATHS.search(line) or re.search(r"\b(TODO|FIXME|XXX)\b", line):
                result.append(f"{_name(path)}:{number}: {line.strip()[:80]}")
    assert not result, "\n".join(result)


def test_importing_the_package_is_light():
    code = (
        "import sys, neoworld_mjx\n"
        "print(sorted({'jax', 'mujoco', 'pxr', 'trimesh', 'anthropic'} & set(sys.modules)))"
    )
    completed = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert completed.stdout.strip() == "[]"


def test_links_between_pages_lead_somewhere():
    pages = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "examples").glob("*.md")]
    broken = []
    for page in pages:
        for target in re.findall(r"\]\(([^)#\s]+)", page.read_text(encoding="utf-8")):
            if "://" not in target and not (page.parent / target).exists():
                broken.append(f"{_name(page)}: {target}")
    assert not broken, "\n".join(broken)


def test_the_readme_gives_the_command_that_ci_runs():
    command = "uv run --extra dev pytest -n 2 --dist loadfile"
    assert command in (ROOT / "README.md").read_text(encoding="utf-8")
    assert (ROOT / ".ci" / "run").read_text(encoding="utf-8").rstrip().endswith(f'{command} "$@"')


def test_annotations_are_checked_in_every_test():
    import jax.numpy as jnp
    import numpy as np
    from beartype.roar import BeartypeCallHintViolation
    from neoworld_kernels import sorted_samples

    from neoworld_mjx.cache import free_memory_maps
    from neoworld_mjx.physics.layout import Layout
    from neoworld_mjx.spec.convex import Piece

    wrong: dict[str, Callable[[], object]] = {
        "type": lambda: free_memory_maps("half"),  # pyright: ignore[reportArgumentType]
        "type of a field": lambda: Piece("ball"),  # pyright: ignore[reportArgumentType]
        "shape": lambda: sorted_samples(np.zeros((4, 2))),
        "shape of a field": lambda: Layout(jnp.zeros((2, 3, 2)), jnp.zeros((2, 3)), jnp.zeros(2)),
        "named axis": lambda: Layout(jnp.zeros((2, 3, 2)), jnp.zeros((2, 3)), jnp.zeros((2, 4))),
    }
    for what, call in wrong.items():
        with pytest.raises(BeartypeCallHintViolation):
            print(what, call())
