"""Who answers: a key, else a tape for this very photo, else one message with the ways to go on."""

import importlib.util

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


def test_auto_uses_the_bundled_tape_without_a_key(bundled):
    assert chosen(photo=PHOTO) == "replay"


def test_auto_prefers_a_key(bundled, monkeypatch):
    monkeypatch.setenv("ANTHROPIC_API_KEY", "k" * 20)
    assert chosen(photo=PHOTO) == "anthropic"


@pytest.mark.parametrize("value", ["", "  "])
def test_empty_key_is_no_key(bundled, monkeypatch, value):
    monkeypatch.setenv("ANTHROPIC_API_KEY", value)
    assert chosen(photo=PHOTO) == "replay"


def test_auto_uses_an_openai_key_only_for_other_models(bundled, monkeypatch):
    monkeypatch.setenv("OPENAI_API_KEY", "k" * 20)
    assert chosen(photo=PHOTO) == "replay"
    if importlib.util.find_spec("openai") is not None:
        assert chosen(other_models(), photo=PHOTO) == "openai"


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


def test_local_server_needs_no_key():
    assert chosen(MLLMOptions(base_url="http://localhost:1"), "anthropic") == "anthropic"


def test_bundled_tapes_are_valid():
    for path in provider.bundled_tapes().glob("*.json"):
        tape = Tape.load(path)
        assert path.name.endswith(".tape.json")
        assert tape.photo is not None
        assert tape.made
        assert tape.answers
