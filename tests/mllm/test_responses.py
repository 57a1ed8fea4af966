"""JSON is found in whatever a model writes around it, and never in half an answer."""

import pytest
from pydantic import BaseModel, Field

from neoworld_mjx.mllm.requests import InvalidResponse, read_response


class Node(BaseModel):
    name: str
    size: tuple[float, float] | None = None
    children: list["Node"] = []


class Share(BaseModel):
    value: float = Field(ge=0, le=1)


@pytest.mark.parametrize(
    "text",
    [
        '{"name": "cup"}',
        ' \n{"name": "cup"}\n',
        'Here it is:\n```json\n{"name": "cup"}\n```\nAnything else?',
        '```\r\n{"name": "cup"}\r\n```',
        'I looked {closely}. The answer is {"name": "cup"}.',
        '```json\n{"name": 3}\n```\nNo, rather\n```json\n{"name": "cup"}\n```',
        'Unclosed fence\n```json\n{"name": "cup"}',
    ],
)
def test_json_is_found(text):
    assert read_response(text, Node).name == "cup"


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "empty"),
        ("There is a cup.", "no JSON object"),
        ("[1, 2]", "a JSON object is needed, got list"),
        ('{"value": 2}', "value: Input should be less than or equal to 1, got 2"),
        ('{"value": NaN}', "NaN is not JSON"),
        ('{"value": "a"}', "valid number"),
        ('{"a":' * 100000, "nested too deeply|broken"),
    ],
)
def test_invalid_responses_state_the_reason(text, reason):
    with pytest.raises(InvalidResponse, match=reason):
        read_response(text, Share)


def test_an_inner_object_does_not_pass_for_a_cut_off_response():
    cut = '{"name": "table", "children": [{"name": "cup"}, {"na'
    for text in (cut, "```json\n" + cut, "Sure: " + cut):
        with pytest.raises(InvalidResponse, match="no JSON object"):
            read_response(text, Node)
