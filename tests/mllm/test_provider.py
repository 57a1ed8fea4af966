"""Who answers: a key, else a tape for this very photo, else one message with the ways to go on."""

import pytest

from neoworld_mjx.config import MLLMOptions, RoleOptions
from neoworld_mjx.errors import ConfigError, ModelError
from neoworld_mjx.mllm import Tape, open_panel, provider

PHOTO = "ab" * 32
VARIABLES = ("ANTHROPIC_API_KEY", "ANTHROPIC_BASE_URL", "OPENAI_API_KEY", "OPENAI_BASE_URL")


@pytest.fixture(autouse=True)
def no_keys(monkeypatch):
    for name in VARIABLES:
        monkeypatch.delenv(name, raising=False)


@pytest.fixture
def bundled(monkeypatch, tmp_path):
    """Put one tape where the tapes of the package are."""
    folder = tmp_path / "bundled"
    Tape(photo=PHOTO, made="by hand").save(folder / "coffee.tape.json")
    monkeypatch.setattr(provider, "bundled_tapes", lambda: folder)
    return folder


def chosen(options: MLLMOptions | None = None, name: str = "auto", **given) -> str:
    return open_panel(options or MLLMOptions(), name, **given).name


def other_models() -> MLLMOptions:
    role = RoleOptions(model="gpt-6-sol")
    return MLLMOptions(reasoner=role, programmer=role, critic=role)


@pytest.mark.parametrize(
    ("keys", "options", "name"),
    [
        ({}, MLLMOptions(), "replay"),
        ({"ANTHROPIC_API_KEY": "k" * 20}, MLLMOptions(), "anthropic"),
        ({"ANTHROPIC_API_KEY": " "}, MLLMOptions(), "replay"),
        ({"OPENAI_API_KEY": "k" * 20}, MLLMOptions(), "replay"),
        ({"OPENAI_API_KEY": "k" * 20}, other_models(), "openai"),
    ],
)
def test_auto_prefers_a_key_of_the_models_and_then_the_tape(
    bundled, monkeypatch, keys, options, name
):
    if name == "openai":
        pytest.importorskip("openai")
    for variable, value in keys.items():
        monkeypatch.setenv(variable, value)
    assert chosen(options, photo=PHOTO) == name


def test_auto_without_key_and_tape_lists_the_options(bundled):
    with pytest.raises(ModelError) as caught:
        chosen(photo="cd" * 32)
    for direction in ("ANTHROPIC_API_KEY", "OPENAI_API_KEY", "base_url", "mailbox", ".tape.json"):
        assert direction in str(caught.value)


def test_given_tapes_come_before_bundled_ones(bundled, tmp_path):
    Tape(photo=PHOTO, made="mine").save(tmp_path / "mine" / "a.tape.json")
    panel = open_panel(MLLMOptions(), "replay", photo=PHOTO, tapes=[tmp_path / "mine"])
    assert str(tmp_path / "mine") in str(panel.provider._path)


def test_explicit_providers_report_missing_inputs(bundled):
    with pytest.raises(ConfigError, match=r"got 'anthropc'.*did you mean 'anthropic'\?"):
        chosen(name="anthropc")
    with pytest.raises(ConfigError, match="mailbox needs a folder"):
        chosen(name="mailbox")
    with pytest.raises(ModelError, match="set ANTHROPIC_API_KEY"):
        chosen(name="anthropic")
    local = MLLMOptions(base_url="http://localhost:1")
    assert chosen(local, "anthropic") == "anthropic"
