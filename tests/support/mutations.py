"""Mutants of the core rooms: small changes, each of one expression or statement of one module.

Left out are templates, render, view, commands, sweeps, verify and mllm, the Warp engine, and
Blender.
"""

import ast
import copy
import random
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[2]
ROOMS = (
    *("spec", "estimate", "evidence", "compose", "physics", "search", "measure", "checks"),
    *("program", "parse", "pipeline", "environments", "export", "io"),
)
LEFT_OUT = ("neoworld_mjx/physics/warp_", "neoworld_mjx/program/blender")
OPERATORS: dict[type, Any] = {
    **{ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt},
    **{ast.Eq: ast.NotEq, ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is},
    **{ast.In: ast.NotIn, ast.NotIn: ast.In, ast.And: ast.Or, ast.Or: ast.And},
    **{ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult},
}
UNREAD = ("annotation", "returns", "decorator_list", "pattern")
"""Fields of nodes that are not mutated."""


class Mutant(NamedTuple):
    """A change of one module: `source[start:end]`, in bytes, becomes `text`."""

    module: str
    line: int
    operator: str
    start: int
    end: int
    text: str

    def apply(self, source: bytes) -> bytes:
        return source[: self.start] + self.text.encode() + source[self.end :]


def draw(rooms: Sequence[str], n: int, seed: int) -> list[Mutant]:
    """Draw mutants: a module by its lines of code, one of its lines, a mutant of the line."""
    rng = random.Random(seed)
    files = [path for room in rooms for path in (ROOT / "neoworld_mjx" / room).rglob("*.py")]
    found = sorted(str(path.relative_to(ROOT)) for path in files)
    paths = [path for path in found if not path.startswith(LEFT_OUT)]
    source = {path: (ROOT / path).read_bytes() for path in paths}
    nodes = [ast.walk(ast.parse(source[path])) for path in paths]
    lines = [len({getattr(node, "lineno", 0) for node in within}) for within in nodes]
    left: dict[str, list[Mutant]] = {}
    drawn = []
    while len(drawn) < n:
        path = rng.choices(paths, lines)[0]
        if path not in left:
            left[path] = mutants(path, source[path])
        if left[path]:
            line = rng.choice(sorted({mutant.line for mutant in left[path]}))
            mutant = rng.choice([mutant for mutant in left[path] if mutant.line == line])
            left[path].remove(mutant)
            drawn.append(mutant)
    return drawn


def mutants(module: str, source: bytes) -> list[Mutant]:
    """Return every mutant of a module.

    Docstrings, annotations, decorators, patterns, assertions, errors and their messages, logs,
    `__all__` and imports for type checkers stay.
    """
    starts = [0, *(end.end() for end in re.finditer(rb"\n", source))]
    found = []
    for operator, node, text in _changes(ast.parse(source)):
        start = starts[node.lineno - 1] + node.col_offset
        end = starts[node.end_lineno - 1] + node.end_col_offset
        found.append(Mutant(module, node.lineno, operator, start, end, text))
    return found


def _changes(node: ast.AST) -> Iterator[tuple[str, Any, str]]:
    """Yield operator, node and its new text, for each change of a node and of what it holds."""
    if _is_skipped(node):
        return
    match node:
        case ast.Compare():
            for i, old in enumerate(node.ops):
                new = copy.deepcopy(node)
                new.ops[i] = OPERATORS[type(old)]()
                yield "compare", node, f"({ast.unparse(new)})"
        case ast.BoolOp() | ast.BinOp() if type(node.op) in OPERATORS and not _joins_text(node):
            new = copy.deepcopy(node)
            new.op = OPERATORS[type(node.op)]()
            yield type(node).__name__.lower(), node, f"({ast.unparse(new)})"
        case ast.UnaryOp(op=ast.Not()):
            yield "not", node, f"({ast.unparse(node.operand)})"
        case ast.If() if not _has_opposite(node.test):
            yield "if", node.test, f"(not ({ast.unparse(node.test)}))"
        case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
            yield "constant", node, repr(_other(number))
        case ast.FunctionDef():
            for value in (*node.args.defaults, *node.args.kw_defaults):
                if isinstance(value, ast.Constant) and isinstance(value.value, bool):
                    yield "default", value, repr(not value.value)
        case ast.Return(value=ast.expr()):
            yield "return", node, "return None"
        case ast.AugAssign():
            yield "delete", node, "pass"
        case ast.Expr(value=ast.Call()) if not _is_skipped(node.value):
            yield "delete", node, "pass"
    for name, value in ast.iter_fields(node):
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and name not in UNREAD:
                yield from _changes(child)


def _is_skipped(node: ast.AST) -> bool:
    match node:
        case ast.Assert() | ast.Raise() | ast.JoinedStr():
            return True
        case ast.Return(value=ast.Constant(value=None)):
            return True
        case ast.If():
            return "TYPE_CHECKING" in ast.unparse(node.test)
        case ast.Assign():
            return ast.unparse(node.targets[0]) == "__all__"
        case ast.Call():
            called = ast.unparse(node.func)
            return called.endswith("Error") or called.split(".")[0] in ("logging", "warnings")
    return False


def _joins_text(node: ast.AST) -> bool:
    sides = (node.left, node.right) if isinstance(node, ast.BinOp) else ()
    return any(
        isinstance(side, ast.JoinedStr)
        or (isinstance(side, ast.Constant) and isinstance(side.value, str))
        for side in sides
    )


def _has_opposite(test: ast.expr) -> bool:
    """Return whether another operator yields the same as `not test`."""
    if isinstance(test, ast.Compare):
        return len(test.ops) == 1 and not isinstance(
            test.ops[0], ast.Lt | ast.LtE | ast.Gt | ast.GtE
        )
    return isinstance(test, ast.UnaryOp) and isinstance(test.op, ast.Not)


def _other(value: float) -> float:
    if value in (0, 1):
        return type(value)(1 - value)
    return value + 1 if isinstance(value, int) else value * 1.1 + 0.1
