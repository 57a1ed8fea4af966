"""`--fast` asks for each response once, and `--model` names the model of every role."""

import json

PARSE_ONLY = ("--until", "parse", "--json")


def test_fast_sends_one_request_for_the_parse_and_one_for_each_program(neoworld, photo, tmp_path):
    done = neoworld(
        "reconstruct", photo, "--out", tmp_path, "--fast", "--until", "verify", "--json"
    )
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["mllm"]["calls"] == 1 + 3
    assert result["fallbacks"] == []
    options = json.loads((tmp_path / "run.json").read_text())["config"]
    assert options["parse"]["critic_rounds"] == options["program"]["critic_rounds"] == 0
    assert options["verify"]["critic"] == "never"


def test_one_name_is_the_model_of_all_roles(neoworld, photo, tmp_path):
    done = neoworld("reconstruct", photo, "--out", tmp_path, "--model", "qwen3-vl:8b", *PARSE_ONLY)
    assert done.returncode == 0, done.stderr
    options = json.loads((tmp_path / "run.json").read_text())["config"]["mllm"]
    roles = ("reasoner", "programmer", "critic")
    assert [options[role]["model"] for role in roles] == 3 * ["qwen3-vl:8b"]
