"""Errors of noisy responses to rendered scenes, step by step."""

import json

import pytest

from neoworld_mjx import cli


@pytest.mark.slow
def test_photos_command_prints_one_json_object(capfd):
    arguments = ["bench", "run", "photos", "--scenes", "8", "--no-search", "--json"]
    with pytest.raises(SystemExit, match="0"):
        cli.main(arguments)
    answer = json.loads(capfd.readouterr().out)
    assert answer["command"] == "neoworld bench run photos --scenes 8 --no-search --json"
    assert answer["tuned_on"]["scenes"] == 1 and "refined" not in answer["tuned_on"]["steps"]
