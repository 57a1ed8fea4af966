"""The stubs that programs are checked against are the SDK's, and the sandbox exposes no more."""

import ast

from neoworld_mjx.program import sdk, stubs
from neoworld_mjx.program.execution import _FIELDS, _METHODS, _PROPERTIES

TREE = ast.parse(stubs.PATH.read_text(encoding="utf-8"))
FUNCTIONS = {node.name for node in TREE.body if isinstance(node, ast.FunctionDef)}
CLASSES = {node.name: node for node in TREE.body if isinstance(node, ast.ClassDef)}


def test_the_committed_stubs_are_up_to_date():
    written = stubs.PATH.read_text(encoding="utf-8")
    assert written == stubs.stub_text(), "run python -m neoworld_mjx.program.stubs --write"


def test_a_new_parameter_makes_the_stubs_stale(monkeypatch):
    source = "def box(size: Vec3, wall: float = 0.0) -> Shape: ..."
    box = ast.parse(source).body[0]
    real = stubs._definitions
    monkeypatch.setattr(stubs, "_definitions", lambda module: {**real(module), "box": box})
    assert source in stubs.stub_text()
    assert stubs.main() == 1


def test_the_stubs_declare_all_that_the_sdk_exports():
    assert FUNCTIONS | set(CLASSES) == set(sdk.__all__)


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
