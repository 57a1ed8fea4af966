"""Generator of `sdk.pyi`, the type stubs against which programs are checked.

`python -m neoworld_mjx.program.stubs` reports whether the file matches the SDK's signatures. With
`--write`, it writes the file.
"""

import ast
import inspect
import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import cast

from . import object_joints, part, sdk, sdk_object, shape_functions
from . import part as placing
from . import part as sdk_types
from . import sdk_object as furniture
from . import shape_functions as patterns

PATH = Path(__file__).with_name("sdk.pyi")
WIDTH = 100
_HEADER = "from collections.abc import Sequence\nfrom typing import Literal\n"
_CLASSES = (
    (placing, "Shape"),
    (part, "Geom"),
    (part, "Part"),
    (part, "Joint"),
)
"""Classes in an order in which each class follows the classes that its signatures mention."""


def stub_text() -> str:
    """Return the text of the stubs: type aliases, classes with public members, and functions."""
    blocks = [_HEADER, _aliases(sdk_types)]
    for module, name in _CLASSES:
        blocks.append(_class(_definitions(module)[name]))
    blocks.append(_aliases(object_joints))
    parents = [_definitions(furniture)["Furniture"], _definitions(object_joints)["ObjectJoints"]]
    blocks.append(_class(_definitions(sdk_object)["Object"], parents))
    functions = []
    for module in (shape_functions, patterns):
        definitions = _definitions(module)
        functions += [
            _function(definitions[name], "") for name in definitions if hasattr(sdk, name)
        ]
    return "\n".join([*blocks, "".join(functions)])


def _definitions(module: ModuleType) -> dict[str, ast.stmt]:
    body = ast.parse(inspect.getsource(module)).body
    return {node.name: node for node in body if isinstance(node, ast.ClassDef | ast.FunctionDef)}


def _aliases(module: ModuleType) -> str:
    """Return the source of a module's type aliases, which are assignments to capitalized names."""
    lines = [
        ast.unparse(node)
        for node in ast.parse(inspect.getsource(module)).body
        if isinstance(node, ast.Assign)
        and isinstance(node.targets[0], ast.Name)
        and node.targets[0].id[0].isupper()
        and not node.targets[0].id.isupper()
    ]
    return "".join(f"{line}\n" for line in lines).replace("'", '"')


def _class(node: ast.stmt, parents: Sequence[ast.stmt] = ()) -> str:
    """Return the stub of a class with the public members of the class and its parent classes."""
    assert isinstance(node, ast.ClassDef)
    lines = [f"class {node.name}:\n"]
    inherited = [member for parent in parents for member in cast(ast.ClassDef, parent).body]
    for member in [*node.body, *inherited]:
        if isinstance(member, ast.AnnAssign) and _public(ast.unparse(member.target)):
            lines.append(f"    {ast.unparse(member)}\n")
        elif isinstance(member, ast.FunctionDef) and (
            _public(member.name) or (member.name == "__init__" and node.name == "Object")
        ):
            lines += [f"    @{ast.unparse(each)}\n" for each in member.decorator_list]
            lines.append(_function(member, "    "))
    return "".join(lines)


def _public(name: str) -> bool:
    return not name.startswith("_")


def _function(node: ast.stmt, indent: str) -> str:
    """Return the stub of a function.

    If the signature is too long for one line, the arguments are on a second line. If they are too
    long for that, each argument is on a separate line.
    """
    assert isinstance(node, ast.FunctionDef) and node.returns is not None
    result = ast.unparse(node.returns).replace('"', "").replace("'", "")
    arguments = _arguments(node.args)
    start, end = f"{indent}def {node.name}(", f") -> {result}: ..."
    line = start + ", ".join(arguments) + end
    inner = f"{indent}    " + ", ".join(arguments)
    if len(line) <= WIDTH:
        return f"{line}\n"
    if len(inner) <= WIDTH:
        return f"{start}\n{inner}\n{indent}{end}\n"
    return (
        start + "\n" + "".join(f"{indent}    {each},\n" for each in arguments) + indent + end + "\n"
    )


def _arguments(arguments: ast.arguments) -> list[str]:
    positional = arguments.args
    missing: list[ast.expr | None] = [None] * (len(positional) - len(arguments.defaults))
    written = [
        _argument(*each) for each in zip(positional, [*missing, *arguments.defaults], strict=True)
    ]
    if arguments.vararg is not None:
        written.append(f"*{_argument(arguments.vararg, None)}")
    elif arguments.kwonlyargs:
        written.append("*")
    return written + [
        _argument(*each) for each in zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True)
    ]


def _argument(argument: ast.arg, default: ast.expr | None) -> str:
    if argument.annotation is None:
        return argument.arg
    text = f"{argument.arg}: {ast.unparse(argument.annotation)}".replace("'", '"')
    if default is None:
        return text
    try:
        ast.literal_eval(default)
    except ValueError:  # A computed default, such as 2 * math.pi.
        return f"{text} = ..."
    return f"{text} = {ast.unparse(default)}".replace("'", '"')


def main() -> int:
    """Compare `sdk.pyi` with the SDK, or write it with `--write`, and return the exit status."""
    text = stub_text()
    if "--write" in sys.argv[1:]:
        PATH.write_text(text, encoding="utf-8")
        return 0
    if PATH.read_text(encoding="utf-8") == text:
        return 0
    sys.stderr.write("sdk.pyi is stale: run python -m neoworld_mjx.program.stubs --write\n")
    return 1


if __name__ == "__main__":
    sys.exit(main())
