"""Tapes give back what was recorded, in any order, and say what is missing."""

import json

import pytest

from neoworld_mjx.errors import MissingResponseError, ModelError
from neoworld_mjx.mllm import Panel, Picture, Tape, find_tape
from neoworld_mjx.mllm.replay import Replay
from tests.mllm.conftest import ask_all


def tape_of(*requests) -> Tape:
    tape = Tape(photo="ab" * 32, made="by hand")
    for number, asked in enumerate(requests):
        tape.put(asked, json.dumps({"name": f"c{number}"}), "m")
    return tape


def test_round_trip_is_byte_for_byte_and_free_of_order(make, tmp_path):
    requests = [make.request(prompt=f"p{i}", name=f"n{i}") for i in range(3)]
    first, second = Tape(photo="ab", made="x"), Tape(photo="ab", made="x")
    for r in requests:
        first.put(r, '{"name":"ü"}', "m")
    for r in reversed(requests):
        second.put(r, '{"name": "ü"}', "m")
    first.save(tmp_path / "one.tape.json")
    second.save(tmp_path / "two.tape.json")
    text = (tmp_path / "one.tape.json").read_text(encoding="utf-8")
    assert text == (tmp_path / "two.tape.json").read_text(encoding="utf-8")
    assert "ü" in text
    assert Tape.load(tmp_path / "one.tape.json") == first

    with Panel(Replay(first, "one")) as panel:
        answers = ask_all(panel, [requests[2], requests[0], requests[1]])
    assert [a.value for a in answers] == [make.Colour(name="ü")] * 3
    assert panel.ledger.to_json()["cost_usd"] == 0


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        (lambda make: {"prompt": "other"}, "differs in: prompt\\."),
        (
            lambda make: {"pictures": [Picture("photo", make.noise(5))]},
            "differs in: pictures\\.",
        ),
        (lambda make: {"schema": make.Shade}, "differs in: schema\\."),
        (lambda make: {"system": "s", "role": "critic"}, "differs in: role, system\\."),
        (lambda make: {"prompt": "other", "name": "zzz"}, "the tape contains: parse"),
    ],
)
def test_a_missing_response_names_the_request_and_the_nearest_entry(make, changes, what):
    panel = Panel(Replay(tape_of(make.request()), "some.tape.json"))
    missing = make.request(**changes(make))
    with panel, pytest.raises(MissingResponseError, match=what) as caught:
        panel.ask_sync(missing)
    message = str(caught.value)
    assert "some.tape.json" in message
    assert repr(missing.name) in message
    assert missing.role in message
    assert missing.key[:16] in message


def test_tapes_are_found_by_their_photo(make, tmp_path):
    tape_of(make.request()).save(tmp_path / "a.tape.json")
    (tmp_path / "broken.tape.json").write_text("{")
    result = find_tape("ab" * 32, [tmp_path / "none", tmp_path])
    assert result is not None
    assert result[1] == tmp_path / "a.tape.json"
    assert find_tape("cd" * 32, [tmp_path]) is None
    assert find_tape(None, [tmp_path]) is None
    assert find_tape("cd" * 32, [tmp_path / "a.tape.json"]) is not None


@pytest.mark.parametrize("text", ["{", "[]", '{"format": 2}', '{"answers": {"k": {}}}', '{"x": 1}'])
def test_a_broken_tape_is_one_error(tmp_path, text):
    path = tmp_path / "t.tape.json"
    path.write_text(text)
    with pytest.raises(ModelError, match="is not a tape"):
        Tape.load(path)
    with pytest.raises(ModelError, match="No such file"):
        Tape.load(tmp_path / "missing.tape.json")
