"""A run's ledger goes on in every command that asks models for it."""

import json

import pytest

from neoworld_mjx.config import Config
from neoworld_mjx.errors import RunError
from neoworld_mjx.mllm import Panel
from neoworld_mjx.mllm.requests import Usage
from neoworld_mjx.pipeline import reconstruction
from neoworld_mjx.run_folder import RunFolder
from tests.support.scripted_model import ScriptedModel


def spend(panel, tokens):
    panel.ledger.add("critic", "claude-sonnet-5-5", Usage(input=tokens, output=0))


def test_a_second_command_continues_the_ledger(tmp_path):
    for times in (1, 2):
        with RunFolder(tmp_path / "run", Config(), "resume") as run:
            panel = Panel(ScriptedModel())
            with reconstruction.recorded_costs(run, panel):
                spend(panel, 1000)
        booked = json.loads((tmp_path / "run" / "run.json").read_text())["mllm"]
        assert (booked["calls"], booked["tokens"]["input"]) == (times, 1000 * times)


def test_costs_are_recorded_if_a_step_fails(tmp_path):
    with RunFolder(tmp_path / "run", Config()) as run:
        panel = Panel(ScriptedModel())
        with pytest.raises(RunError, match="in between"), reconstruction.recorded_costs(run, panel):
            spend(panel, 10)
            raise RunError("in between")
        assert run.data["mllm"]["calls"] == 1


def test_a_damaged_ledger_is_named(tmp_path):
    with RunFolder(tmp_path / "run", Config()) as run:
        run.record("mllm", by_role_and_model=3)
        with pytest.raises(RunError, match=r"run\.json: the costs under mllm are damaged"):
            with reconstruction.recorded_costs(run, Panel(ScriptedModel())):
                pass
