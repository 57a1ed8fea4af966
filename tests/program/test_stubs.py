"""The stubs that programs are checked against are the SDK's, and the sandbox exposes no more."""

import ast
import inspect

import pytest

from neoworld_mjx.program import sdk
from neoworld_mjx.program.sandbox import _FIELDS, _METHODS, _PROPERTIES, stubs

TREE = ast.parse(stubs())
FUNCTIONS = {node.name: node for node in TREE.body if isinstance(node, ast.FunctionDef)}
CLASSES = {node.name: node for node in TREE.body if isinstance(node, ast.ClassDef)}


def in_sdk(function):
    """Return the kind, the name and the default of each parameter."""
    return [
        (parameter.kind, parameter.name, parameter.default)
        for parameter in inspect.signature(function).parameters.values()
    ]


def in_stubs(node):
    """Return the same of a declaration, whose names are those of the SDK's source."""
    namespace = {}
    exec("from __future__ import annotations\n" + ast.unparse(node), namespace)
    return in_sdk(namespace[node.name])


def test_the_stubs_declare_all_that_the_sdk_exports():
    assert {*FUNCTIONS, *CLASSES} == set(sdk.__all__)


@pytest.mark.parametrize("owner", ["", *CLASSES])
def test_the_stubs_have_the_parameters_of_the_sdk(owner):
    declared = CLASSES[owner].body if owner else TREE.body
    home = getattr(sdk, owner) if owner else sdk
    for node in declared:
        if isinstance(node, ast.FunctionDef) and not node.decorator_list:
            found, expected = in_stubs(node), in_sdk(getattr(home, node.name))
            # A computed default, such as 2 * math.pi, is written as "...".
            expected = [
                (kind, name, ... if shown is ... else default)
                for (kind, name, default), (_, _, shown) in zip(expected, found, strict=True)
            ]
            assert found == expected, f"sdk.pyi: {owner}.{node.name}"


def test_the_sandbox_exposes_what_the_stubs_declare_and_nothing_private():
    for name, body in CLASSES.items():
        kind = getattr(sdk, name)
        functions = [node for node in body.body if isinstance(node, ast.FunctionDef)]
        methods = {node.name for node in functions if not node.decorator_list} - {"__init__"}
        assert methods == _METHODS[kind]
        assert {node.name for node in functions if node.decorator_list} == set(_PROPERTIES[kind])
        fields = {ast.unparse(n.target) for n in body.body if isinstance(n, ast.AnnAssign)}
        assert fields == set(_FIELDS[kind])
    exposed = [*_METHODS.values(), *_PROPERTIES.values(), *_FIELDS.values()]
    assert not [name for names in exposed for name in names if name.startswith("_")]
