"""Bad input ends in exit code 2 and one message that names the thing and says what to do.

No traceback, nothing written that looks like a finished run, and an earlier run stays unchanged.
"""

import importlib.util
import json
import os
import shutil
from pathlib import Path

import pytest
from PIL import Image

from neoworld_mjx import cli
from tests.support.model_server import ModelServer, fails

PHOTO = Path(__file__).parents[1] / "examples" / "coffee.png"


@pytest.fixture
def refused(capfd):
    """Run the command in this process; return its one message."""

    def run(*words) -> str:
        with pytest.raises(SystemExit) as ended:
            cli.main(["reconstruct", *map(str, words), "--json"])
        said = capfd.readouterr()
        assert ended.value.code == 2, said.err
        assert "Traceback" not in said.err
        message = json.loads(said.out)["error"]
        assert said.err.count("error:") == 1
        assert f"error: {message}" in said.err
        return message

    return run


def picture(path: Path, size=(64, 48)) -> Path:
    Image.new("RGB", size, "red").save(path)
    return path


@pytest.fixture(scope="module")
def parsed(tmp_path_factory) -> Path:
    """A run of the example, stopped after its first step."""
    out = tmp_path_factory.mktemp("parsed") / "out"
    words = ["reconstruct", str(PHOTO), "--out", str(out), "--until", "parse", "--quiet"]
    with pytest.raises(SystemExit) as ended:
        cli.main(words)
    assert ended.value.code == 0
    return out


def everything(folder: Path) -> dict[str, bytes]:
    files = [path for path in folder.rglob("*") if path.is_file() and path.name != ".lock"]
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (("--overwrite", "--resume"), "give one of them"),
        (("--overwrite", "--from", "parse"), "give one of them"),
        (("--from", "refine", "--until", "compose"), "no step would run"),
    ],
)
def test_contradicting_flags_leave_the_run_unchanged(refused, parsed, tmp_path, more, said):
    out = shutil.copytree(parsed, tmp_path / "out")
    before = everything(out)
    assert said in refused(PHOTO, "--out", out, *more)
    assert everything(out) == before


@pytest.mark.parametrize("provider", ["auto", "replay", "anthropic", "openai", "gpt"])
def test_without_a_model_no_folder_is_created(refused, tmp_path, provider):
    photo = picture(tmp_path / "other.png")
    message = refused(photo, "--out", tmp_path / "out", "--provider", provider)
    openai = importlib.util.find_spec("openai")
    said = {
        "auto": "answer yourself: --provider mailbox",
        "replay": "no tape was recorded for this photo",
        "anthropic": "set ANTHROPIC_API_KEY",
        "openai": "set OPENAI_API_KEY" if openai else "needs its extra: uv sync",
        "gpt": "valid are: auto",
    }
    assert said[provider] in message
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("more", [("--from", "refine"), ("--resume",)])
def test_a_run_of_another_photo_is_not_resumed(refused, parsed, tmp_path, more):
    out = shutil.copytree(parsed, tmp_path / "out")
    before = everything(out)
    photo = picture(tmp_path / "other.png")
    message = refused(photo, "--out", out, "--provider", "mailbox", *more)
    assert "is a run of another photograph (coffee.png), not of" in message
    assert "--overwrite" in message
    assert everything(out) == before


def test_a_refused_key(refused, monkeypatch, tmp_path):
    monkeypatch.setenv("ANTHROPIC_API_KEY", "sk-secret-123456")
    out = tmp_path / "out"
    with ModelServer("anthropic", fails(401, "invalid key")) as server:
        url = f"mllm.base_url={server.url}"
        message = refused(PHOTO, "--out", out, "--provider", "anthropic", "--set", url)
    assert "ANTHROPIC_API_KEY was refused" in message
    assert "sk-secret" not in message
    data = json.loads((out / "run.json").read_text())
    assert (data["status"], data["steps"], data["error"]) == ("failed", {}, message)
    assert all(b"sk-secret" not in content for content in everything(out).values())


@pytest.mark.skipif(os.name == "nt" or os.geteuid() != 0, reason="only root can act as another")
@pytest.mark.parametrize("mode", [0o700, 0o755, 0o711])
def test_a_folder_of_someone_else(refused, parsed, tmp_path, mode):
    home = tmp_path
    while home != home.parent and home.stat().st_mode & 0o005 != 0o005:
        home.chmod(home.stat().st_mode | 0o055)  # The folders above are open to all.
        home = home.parent
    out = shutil.copytree(parsed, tmp_path / "out")
    photo = shutil.copy(PHOTO, tmp_path / "photo.png")
    out.chmod(mode)
    before = everything(out)
    os.seteuid(65534)
    try:
        message = refused(photo, "--out", out, "--resume")
    finally:
        os.seteuid(0)
    assert "Permission denied; name a folder that you may write to" in message
    assert str(out) in message
    assert everything(out) == before
