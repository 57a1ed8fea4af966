"""Answers of a model that is wrong or was talked into mischief: it is told, and asked again."""

import json
import re
from typing import get_args, get_origin

import pytest
from pydantic import BaseModel

from neoworld_mjx.fit.fit_tree import fit_tree
from neoworld_mjx.fit.tree_checks import check_tree
from neoworld_mjx.io.names import file_name, identifier, is_name, plain_text
from neoworld_mjx.mllm.requests import Reply, Usage
from neoworld_mjx.mllm.responses import InvalidResponse, read_response
from neoworld_mjx.parse.schema import ParsedScene, to_tree
from neoworld_mjx.program import build
from neoworld_mjx.program.validate import formatted
from neoworld_mjx.spec import SceneTree
from tests.support import answers

EDGES = [1e17, -1e100, 1e308, 5e-324, 1e-162, -0.0, 0.0]


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


def _with(path: str, value: float) -> dict:
    data = answers.answer(answers.item("cup"))
    item = data["objects"][1]
    item |= {"contact": {"u": 20, "v": 80}, "tilt": {"towards": "left", "degrees": 1}}
    item |= {"articulation": [{"part": "lid", "motion": "revolute"}], "doubt": {}}
    if path.startswith("outline"):
        corners = [{"x": -0.5, "y": -0.5}, {"x": 0.5, "y": -0.5}, {"x": 0.0, "y": 0.5}]
        data["objects"][0]["outline"] = {"shape": "polygon", "points": corners}
    if path.startswith("surface"):
        data["objects"][0]["surface"] = {"material": "wood"}
    *heads, last = path.split(".")
    inner = data["objects"][0] if heads[:1] in (["outline"], ["surface"]) else item
    inner = data["camera"] if heads == ["camera"] else inner
    for head in heads if heads != ["camera"] else []:
        inner = inner[head]
        inner = inner[0] if isinstance(inner, list) else inner
    inner[last] = [value] * 3 if last.endswith("colour") else value
    return data


@pytest.mark.parametrize("path", sorted(set(_paths(ParsedScene))))
def test_extreme_numbers_are_rejected_by_name_or_give_a_finite_tree(path):
    rejected = 0
    for value in EDGES:
        try:
            answer = read_response(json.dumps(_with(path, value)), ParsedScene)
        except InvalidResponse as error:
            rejected += bool(re.search(rf"{path.split('.')[-1]}\S*: .* must lie in", str(error)))
        else:
            tree = to_tree(answer, answers.photo())
            assert SceneTree.model_validate_json(tree.to_json()) == tree
    assert rejected >= 3


@pytest.mark.parametrize("text", ["NaN", "Infinity", "1e999", "-1e999"])
def test_non_finite_numbers_are_rejected(text):
    data = json.dumps(answers.answer(answers.item("cup", at=(7.25, 0, 0)))).replace("7.25", text)
    with pytest.raises(InvalidResponse, match=r"is not JSON|must lie in|finite"):
        read_response(data, ParsedScene)


def test_an_answer_of_too_many_objects_is_one_line():
    data = answers.answer(*(answers.item(f"cup{i}") for i in range(20_000)))
    for text in (json.dumps(data), json.dumps(data | {"objects": data["objects"][:300]})):
        with pytest.raises(
            InvalidResponse, match=r"at most 1000000 are read|at most 100 are accepted"
        ):
            read_response(text, ParsedScene)


@pytest.mark.parametrize(
    "text",
    [
        "{}" * 400_000,
        "```\n{}\n```\n" * 60_000,
        '{"a":' * 150_000,
        "{ " * 400_000,
        "```" * 300_000,
        '{"' * 400_000,
    ],
    ids=["pairs", "fences", "depth", "spaces", "ticks", "quotes"],
)
def test_floods_of_braces_end_soon(text):
    with pytest.raises(InvalidResponse):
        read_response(text, ParsedScene)


NAMES = {
    "newline": "cup\n",
    "path": "../../etc/passwd",
    "absolute": "/etc/passwd",
    "markup": "<script>alert(1)</script>",
    "attribute": '"/><body name="x',
    "entity": "&xxe;",
    "right to left": "cup\u202egnp.exe",
    "zero width": "c\u200bup",
    "nul": "cup\0",
    "long": "x" * 10_000,
    "digits": "2nd",
    "script": "чашка",
    "empty": "",
    "dot": ".",
    "half a character": "cup\ud800",
}


@pytest.mark.parametrize("name", NAMES.values(), ids=NAMES)
def test_invalid_names_are_rejected_or_converted(name):
    assert not is_name(name)
    plain = identifier(name, "part")
    assert is_name(plain)
    again = identifier(name, "part", {plain})
    assert is_name(again)
    assert again != plain
    file = file_name(name)
    assert len(file) <= 60
    assert not set(file) & set("/\\\n\0<>\"'&")
    assert not file.startswith((".", "-"))
    line = plain_text(name, 100)
    assert len(line) <= 100
    assert line.isprintable()
    line.encode()
    if name.isascii():
        with pytest.raises(InvalidResponse, match="a name has letters, digits and underscores"):
            read_response(json.dumps(answers.answer(answers.item(name))), ParsedScene)


def test_names_that_collide_after_cleaning_stay_apart():
    taken: set[str] = set()
    for name in ["a/b", "a.b", "a b", "a_b", "x" * 50, "x" * 60] * 30:
        label = identifier(name, "part", taken)
        assert is_name(label)
        assert label not in taken
        taken.add(label)
    assert len(taken) == 180


def test_names_that_differ_by_case_alone_are_told():
    data = json.dumps(answers.answer(answers.item("cup"), answers.item("Cup")))
    with pytest.raises(InvalidResponse, match="object Cup: cup differs by case alone"):
        read_response(data, ParsedScene)


def test_texts_lose_what_cannot_be_seen():
    label = "cup\n\u202e<b>\0" + "x" * 10_000
    data = answers.answer(answers.item("cup", label=label, description=label))
    node = to_tree(read_response(json.dumps(data), ParsedScene), answers.photo()).node("cup")
    assert node.label.startswith("cup <b>xxx")
    assert (len(node.label), len(node.description)) == (100, 4000)


def test_half_a_character_in_a_reply_becomes_a_question_mark():
    assert Reply("a\ud800b", Usage(), "model").text == "a?b"
    with pytest.raises(InvalidResponse):
        read_response('{"camera": "\\ud800"}', ParsedScene)


def test_a_list_of_shared_lists_is_shown_short():
    value: list = [1.0] * 6
    for _ in range(15):
        value = [value] * 6
    assert len(formatted(value)) < 1000


def test_the_number_of_objects_is_bounded():
    data = answers.answer(*(answers.item(f"o{k}") for k in range(99)))
    assert len(ParsedScene.model_validate(data).objects) == 100
    data["objects"].append(answers.item("one_more"))
    with pytest.raises(ValueError, match="objects lists 101 entries, at most 100"):
        ParsedScene.model_validate(data)


@pytest.mark.parametrize("shape", [pytest.param("heap", marks=pytest.mark.slow), "chain"])
def test_the_checks_of_as_many_objects_as_are_read(shape):
    """200 of them took over 100 s, in one heap or each on the one before."""
    data = answers.answer()
    box = {"left": 100, "top": 100, "right": 190, "bottom": 190}
    for k in range(99):
        parent = f"o{k - 1}" if shape == "chain" and k else "table"
        at = (0.8, 0.0, 0.2 if shape == "heap" else 0.02 * k)
        data["objects"].append(answers.item(f"o{k}", at, parent=parent, box=box))
    tree = to_tree(read_response(json.dumps(data), ParsedScene), answers.photo())
    fitted, _ = fit_tree(tree)
    assert len(fitted.nodes) == 100
    assert check_tree(fitted)


def test_names_that_mujoco_reserves():
    data = answers.answer(answers.item("world"))
    with pytest.raises(ValueError, match="MuJoCo reserves this name"):
        ParsedScene.model_validate(data)
    assert identifier("world", "object") == "world_1"
    assert identifier("world", "part") == "world"
    built = build(
        'from neoworld_mjx.program.sdk import Object, box\no = Object("world")\n'
        'o.part("a", material="oak").add(box((1, 1, 1)))\n'
    )
    assert not built.ok
    assert "MuJoCo reserves" in str(built.signals)
