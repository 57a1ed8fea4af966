"""Responses of a model that is wrong or prompt-injected: rejected by name, or converted."""

import json
import re
from typing import get_args, get_origin

import pytest
from pydantic import BaseModel

from neoworld_mjx.io.names import file_name, identifier, is_name, plain_text
from neoworld_mjx.mllm.requests import InvalidResponse, read_response
from neoworld_mjx.parse.schema import ParsedScene, to_tree
from neoworld_mjx.spec import SceneTree
from tests.support import answers

EDGES = [1e17, -1e100, 1e308, 5e-324, -0.0, 0.0]


def _paths(schema: type[BaseModel], at: str = ""):
    """Yield the paths of all numbers of a schema, those of objects begun anew."""
    for name, field in schema.model_fields.items():
        path = "" if name == "objects" else f"{at}{name}"
        kinds = [field.annotation]
        while kinds:
            kind = kinds.pop()
            if kind is float:
                yield path
            elif isinstance(kind, type) and issubclass(kind, BaseModel):
                yield from _paths(kind, f"{path}." if path else "")
            elif get_origin(kind) is not None:
                kinds += get_args(kind)


@pytest.mark.parametrize("path", sorted({p for p in _paths(ParsedScene) if "." not in p}))
def test_extreme_numbers_are_rejected_by_name_or_give_a_finite_tree(path):
    rejected = 0
    for value in EDGES:
        data = answers.answer(answers.item("cup"))
        data["objects"][1][path] = [value] * 3 if path.endswith("colour") else value
        try:
            answer = read_response(json.dumps(data), ParsedScene)
        except InvalidResponse as error:
            rejected += bool(re.search(rf"{path}\S*: .* must lie in", str(error)))
        else:
            tree = to_tree(answer, answers.photo())
            assert SceneTree.model_validate_json(tree.to_json()) == tree
    assert rejected >= 3


@pytest.mark.parametrize("text", ["NaN", "Infinity", "1e999", "-1e999"])
def test_non_finite_numbers_are_rejected(text):
    data = json.dumps(answers.answer(answers.item("cup", at=(7.25, 0, 0)))).replace("7.25", text)
    with pytest.raises(InvalidResponse, match=r"is not JSON|must lie in|finite"):
        read_response(data, ParsedScene)


FLOODS = {
    "pairs": "{}" * 400_000,
    "fences": "```\n{}\n```\n" * 60_000,
    "depth": '{"a":' * 150_000,
    "ticks": "```" * 300_000,
    "surrogate": '{"camera": "\\ud800"}',
    "objects": json.dumps(answers.answer(*(answers.item(f"cup{i}") for i in range(300)))),
    "world": json.dumps(answers.answer(answers.item("world"))),
    "case": json.dumps(answers.answer(answers.item("cup"), answers.item("Cup"))),
}


@pytest.mark.parametrize("name", FLOODS)
def test_floods_and_reserved_names_are_rejected(name):
    with pytest.raises(InvalidResponse):
        read_response(FLOODS[name], ParsedScene)


NAMES = {
    "newline": "cup\n",
    "path": "../../etc/passwd",
    "markup": '"/><script>alert(1)</script>',
    "right to left": "cup\u202egnp.exe",
    "zero width": "c\u200bup",
    "nul": "cup\0",
    "long": "x" * 10_000,
    "digits": "2nd",
    "script": "чашка",
    "empty": "",
    "half a character": "cup\ud800",
}


@pytest.mark.parametrize("name", NAMES.values(), ids=NAMES)
def test_invalid_names_are_rejected_or_converted(name):
    assert not is_name(name)
    plain = identifier(name, "part")
    again = identifier(name, "part", {plain})
    assert is_name(plain) and is_name(again) and again != plain
    file = file_name(name)
    assert len(file) <= 60 and not set(file) & set("/\\\n\0<>\"'&")
    assert not file.startswith((".", "-"))
    line = plain_text(name, 100)
    assert len(line) <= 100 and line.isprintable()
    line.encode()
    if name.isascii():
        with pytest.raises(InvalidResponse, match="a name has letters, digits and underscores"):
            read_response(json.dumps(answers.answer(answers.item(name))), ParsedScene)
