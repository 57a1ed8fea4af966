import ast
import inspect
from typing import Any

import pytest

from neoworld_mjx.program import sdk
from neoworld_mjx.program.monty_sandbox import _FIELDS, _METHODS, stubs

TREE = ast.parse(stubs())
FUNCTIONS = {node.name: node for node in TREE.body if isinstance(node, ast.FunctionDef)}
CLASSES = {node.name: node for node in TREE.body if isinstance(node, ast.ClassDef)}
METHODS = [
    (owner, node)
    for owner, body in CLASSES.items()
    for node in body.body
    if isinstance(node, ast.FunctionDef) and not node.decorator_list
]


def assert_alike(declared: ast.FunctionDef, real: Any) -> None:
    given = declared.args
    names = [arg.arg for arg in (*given.posonlyargs, *given.args)]
    keyword = [arg.arg for arg in given.kwonlyargs]
    parameters = inspect.signature(real).parameters
    kinds = {
        kind: [n for n, p in parameters.items() if p.kind is kind]
        for kind in inspect._ParameterKind
    }
    assert names == kinds[inspect.Parameter.POSITIONAL_OR_KEYWORD]
    assert keyword == kinds[inspect.Parameter.KEYWORD_ONLY]
    count = len(names) - len(given.defaults)
    optional = {*names[count:], *(k for k, d in zip(keyword, given.kw_defaults, strict=True) if d)}
    assert optional == {n for n, p in parameters.items() if p.default is not p.empty}
    values = dict(zip(names[count:], given.defaults, strict=True))
    values |= {k: d for k, d in zip(keyword, given.kw_defaults, strict=True) if d is not None}
    for name, value in values.items():
        if isinstance(value, ast.Constant) and value.value is ...:
            continue
        assert ast.literal_eval(value) == parameters[name].default, name


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_are_as_declared(name: str):
    assert_alike(FUNCTIONS[name], getattr(sdk, name))


@pytest.mark.parametrize(
    ("owner", "node"), METHODS, ids=lambda value: getattr(value, "name", value)
)
def test_methods_are_as_declared(owner: str, node: ast.FunctionDef):
    assert_alike(node, getattr(getattr(sdk, owner), node.name))


def test_the_stubs_declare_all_there_is_and_the_wall_lets_it_through():
    assert {*FUNCTIONS, *CLASSES} == set(sdk.__all__)
    for name, body in CLASSES.items():
        kind = getattr(sdk, name)
        public = {
            n for n in vars(kind) if not n.startswith("_") and inspect.isfunction(vars(kind)[n])
        }
        declared = {node.name for owner, node in METHODS if owner == name} - {"__init__"}
        assert public == declared == _METHODS[kind]
        fields = {ast.unparse(n.target) for n in body.body if isinstance(n, ast.AnnAssign)}
        assert fields == set(_FIELDS[kind])
