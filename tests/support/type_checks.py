"""Annotations of our packages, checked in tests: beartype for types, jaxtyping for shapes.

jaxtyping's own hook (`--jaxtyping-packages`) checks each call twice and builds the checks of every
function at import, which was half of the time of the suite. Here a function's checks are built at
its first call, and only functions with shapes get jaxtyping's scope of named axes. In every test
the first `CALLS` calls of a function are checked: loops that turn a vector a hundred thousand times
took a tenth of the time of the suite.
"""

import ast
import dataclasses
import functools
import hashlib
import importlib.machinery
import inspect
import marshal
import os
import sys
import typing
from collections.abc import Callable
from pathlib import Path
from typing import Any

from beartype import BeartypeConf, beartype
from jaxtyping import AbstractArray, jaxtyped

PACKAGES = ("neoworld_mjx", "neoworld_kernels", "neoworld_bench")
SETTINGS = BeartypeConf(is_pep484_tower=True)
"""An int is valid where a float is annotated, as type checkers have it."""
CALLS = 20
"""Number of calls of each function that are checked in each test."""


class _Test:
    number = 0


def checked(item: Any) -> Any:
    """Check a function's calls, or how a dataclass is built."""
    if inspect.isclass(item):
        if dataclasses.is_dataclass(item) and not hasattr(item.__init__, "__wrapped__"):
            item.__init__ = checked(item.__init__)  # pyright: ignore[reportAttributeAccessIssue]
        return item
    if not item.__annotations__:
        return item
    checks, test, left = None, -1, 0

    @functools.wraps(item)
    def call(*args: Any, **kwargs: Any) -> Any:
        nonlocal checks, test, left
        __tracebackhide__ = True
        if test != _Test.number:
            test, left = _Test.number, CALLS
        if left == 0:
            return item(*args, **kwargs)
        left -= 1
        if checks is None:
            checks = _with_checks(item)
        return checks(*args, **kwargs)

    return call


def _with_checks(function: Callable[..., Any]) -> Callable[..., Any]:
    """Build the checks of a function; a name that only type checkers import is not checked."""
    written = function.__annotations__
    hints = {name: _resolved(hint, function) for name, hint in written.items()}
    try:
        function.__annotations__ = hints
        typed = beartype(conf=SETTINGS)(function)
    finally:
        function.__annotations__ = written
    return jaxtyped(typed, typechecker=None) if any(map(_has_shape, hints.values())) else typed


def _resolved(hint: Any, function: Callable[..., Any]) -> Any:
    holder = type("holder", (), {"__annotations__": {"hint": hint}})
    try:
        return typing.get_type_hints(holder, function.__globals__, {}, include_extras=True)["hint"]
    except NameError:
        return Any


def _has_shape(hint: Any) -> bool:
    if inspect.isclass(hint) and issubclass(hint, AbstractArray):
        return True
    return any(map(_has_shape, typing.get_args(hint)))


class _Decorate(ast.NodeTransformer):
    VERSION = Path(__file__).read_bytes()

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.AST:
        # Outermost, after `@dataclass`.
        return self._decorated(node, 0)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        # Innermost, before `@property` and `@jax.jit`.
        return self._decorated(node, len(node.decorator_list))

    def _decorated(self, node: Any, at: int) -> ast.AST:
        if any(ast.unparse(one).endswith("no_type_check") for one in node.decorator_list):
            return node
        name = ast.copy_location(ast.Name("__checked__", ast.Load()), node)
        node.decorator_list.insert(at, name)
        return self.generic_visit(node)


class _Loader(importlib.machinery.SourceFileLoader):
    kept_in: Path | None = None

    def get_code(self, fullname: str) -> Any:
        path = self.get_filename(fullname)
        source = self.get_data(path)
        if self.kept_in is None:
            return self._with_decorators(source, path)
        # Its own folder: Python would take it for the code without checks.
        key = (_Decorate.VERSION, sys.version, path, source)
        kept = self.kept_in / hashlib.sha256(repr(key).encode()).hexdigest()
        if not kept.is_file():
            part = kept.with_suffix(f".{os.getpid()}")
            part.write_bytes(marshal.dumps(self._with_decorators(source, path)))
            part.replace(kept)
        return marshal.loads(kept.read_bytes())

    @staticmethod
    def _with_decorators(source: bytes, path: str) -> Any:
        return compile(_Decorate().visit(ast.parse(source, path)), path, "exec", dont_inherit=True)

    def exec_module(self, module: Any) -> None:
        module.__checked__ = checked
        super().exec_module(module)


class _Finder:
    @staticmethod
    def find_spec(name: str, path: Any = None, target: Any = None) -> Any:
        if name.partition(".")[0] not in PACKAGES:
            return None
        spec = importlib.machinery.PathFinder.find_spec(name, path, target)
        if spec is not None and isinstance(spec.loader, importlib.machinery.SourceFileLoader):
            spec.loader = _Loader(spec.loader.name, spec.loader.path)
        return spec


def check_annotations() -> None:
    """Check what is imported of our packages from here on."""
    early = sorted(name for name in sys.modules if name.partition(".")[0] in PACKAGES)
    assert not early, f"imported before their annotations could be checked: {early}"
    sys.meta_path.insert(0, _Finder)  # pyright: ignore[reportArgumentType]


def check_anew() -> None:
    """Count the calls of every function anew, for the next test."""
    _Test.number += 1


def keep_code(folder: Path) -> None:
    """Keep the code with checks of each module there; building it takes longer than a read."""
    _Loader.kept_in = folder
