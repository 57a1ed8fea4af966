"""The mailbox asks by folders, waits, rejects with a reason, and takes up what was begun."""

import json
import os
import threading
import time
from pathlib import Path

import pytest

from neoworld_mjx.errors import ModelError
from neoworld_mjx.mllm import Panel, Picture, mailbox
from neoworld_mjx.mllm.mailbox import Mailbox


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(mailbox, "POLL_S", 0.01)
    monkeypatch.setattr(mailbox, "UNCHANGED_S", 0.1)


def panel_of(folder: Path, timeout_s: float | None = 5.0, **more) -> Panel:
    return Panel(Mailbox(folder, timeout_s=timeout_s), **more)


def wait_for(path: Path) -> Path:
    for _ in range(3000):
        if path.exists():
            return path
        time.sleep(0.01)
    raise AssertionError(f"{path} did not appear")


def in_background(work) -> threading.Thread:
    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    return thread


def test_a_folder_holds_the_whole_request(make, tmp_path):
    requests = make.request(name="program:cup", pictures=[Picture("the photo", make.noise())])

    def answer():
        folder = wait_for(tmp_path / "0001-program-cup")
        (folder / "response.json").write_text('{"name": "red"}')

    in_background(answer)
    with panel_of(tmp_path) as panel:
        given = panel.ask_sync(requests)
    assert given.value == make.Colour(name="red")
    folder = tmp_path / "0001-program-cup"
    names = {path.name for path in folder.iterdir()}
    assert names == {"prompt.md", "schema.json", "request.json", "response.json", "1-the-photo.png"}
    prompt = (folder / "prompt.md").read_text()
    for part in (requests.system, requests.prompt, "1-the-photo.png: the photo (30 x 20 px)"):
        assert part in prompt
    assert json.loads((folder / "schema.json").read_text()) == requests.json_schema
    assert (folder / "1-the-photo.png").read_bytes() == requests.pictures[0].data


def test_invalid_responses_are_moved_aside_with_a_reason(make, tmp_path):
    def answer():
        folder = wait_for(tmp_path / "0001-parse")
        (folder / "response.json").write_text('{"name": 3}')
        reason = wait_for(folder / "error.md").read_text()
        assert "name: Input should be a valid string, got 3" in reason
        assert "response.rejected-1.json" in reason
        (folder / "error.md").unlink()
        (folder / "response.json").write_text("red, I think")
        assert "no JSON object" in wait_for(folder / "error.md").read_text()
        (folder / "response.json").write_text('```json\n{"name": "red"}\n```')

    writer = in_background(answer)
    with panel_of(tmp_path) as panel:
        assert panel.ask_sync(make.request()).value.name == "red"
    writer.join()
    folder = tmp_path / "0001-parse"
    assert (folder / "response.rejected-1.json").read_text() == '{"name": 3}'
    assert (folder / "response.rejected-2.json").read_text() == "red, I think"
    assert not (folder / "error.md").exists()


def test_incomplete_json_is_not_read_while_its_file_is_young(make, tmp_path, monkeypatch):
    monkeypatch.setattr(mailbox, "UNCHANGED_S", 1000.0)

    def answer():
        path = wait_for(tmp_path / "0001-parse") / "response.json"
        path.write_text('{"name": "r')
        time.sleep(0.1)
        path.write_text('{"name": "red"}')

    in_background(answer)
    with panel_of(tmp_path) as panel:
        assert panel.ask_sync(make.request()).value.name == "red"
    assert not list((tmp_path / "0001-parse").glob("response.rejected*"))


def test_a_request_continues_after_a_timeout(make, tmp_path):
    with (
        panel_of(tmp_path, timeout_s=0.1) as panel,
        pytest.raises(ModelError, match=r"within 0\.1 s"),
    ):
        panel.ask_sync(make.request())
    folder = tmp_path / "0001-parse"
    with panel_of(tmp_path, timeout_s=0.1) as panel, pytest.raises(ModelError):
        panel.ask_sync(make.request())
    assert [path.name for path in tmp_path.iterdir()] == [folder.name]
    (folder / "response.json").write_text('{"name": "red"}')
    with panel_of(tmp_path, timeout_s=0.1) as panel:
        assert panel.ask_sync(make.request()).value.name == "red"
        with pytest.raises(ModelError):
            panel.ask_sync(make.request(prompt="another"))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["0001-parse", "0002-parse"]


def test_names_cannot_leave_the_mailbox(make, tmp_path):
    requests = make.request(name="../../escape", pictures=[Picture("../x/y", make.noise())])
    with panel_of(tmp_path / "box", timeout_s=0.05) as panel, pytest.raises(ModelError):
        panel.ask_sync(requests)
    assert [path.name for path in tmp_path.iterdir()] == ["box"]
    (folder,) = (tmp_path / "box").iterdir()
    assert "1-x-y.png" in {path.name for path in folder.iterdir()}


def test_recorded_responses_replay(make, tmp_path):
    tape = tmp_path / "a.tape.json"
    folder = tmp_path / "box"

    def answer():
        path = wait_for(folder / "0001-parse")
        (path / "response.json").write_text('{"name": "red"}')

    in_background(answer)
    with panel_of(folder, record=tape, photo="ab", made="by looking") as panel:
        panel.ask_sync(make.request())
    data = json.loads(tape.read_text())
    assert (data["photo"], data["made"]) == ("ab", "by looking")
    (entry,) = data["answers"].values()
    assert (entry["name"], entry["role"], entry["answer"]) == ("parse", "reasoner", {"name": "red"})

    with panel_of(tmp_path / "unused", record=tape) as panel:
        assert panel.ask_sync(make.request()).value.name == "red"
    assert not (tmp_path / "unused").exists()
    with pytest.raises(ModelError, match="another photo"):
        panel_of(folder, record=tape, photo="cd")


def planted(act) -> object:
    """Plant something in the folder of a request once it is there."""
    return lambda box: in_background(lambda: act(wait_for(box / "0001-parse")))


def write_hole(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(1 << 40)


def swap(folder: Path, target: Path) -> None:
    """Put a link in the place of a folder; the target holds a response that does not fit."""
    (target / "response.json").write_text('{"name": 3}')
    (target / "error.md").write_text("precious")
    folder.rename(folder.with_name("moved"))
    folder.symlink_to(target)


HOSTILE = {
    "a link in the mailbox": (
        lambda box: (box / "0007-cup").symlink_to(box.parent / "precious"),
        "0007-cup is a link",
    ),
    "a pipe in the mailbox": (lambda box: os.mkfifo(box / "0001-x"), "0001-x is a pipe"),
    "a link as partial folder": (
        lambda box: (box / ".partial-0").symlink_to(box.parent / "precious"),
        ".partial-0 is a link",
    ),
    "a link as response": (
        planted(lambda f: (f / "response.json").symlink_to(f.parents[1] / "precious/key.json")),
        "it is a link, not a regular file",
    ),
    "a pipe as response": (planted(lambda f: os.mkfifo(f / "response.json")), "a pipe or device"),
    "a folder as response": (planted(lambda f: (f / "response.json").mkdir()), "it is a folder"),
    "a folder that becomes a link": (
        planted(lambda f: swap(f, f.parents[1] / "precious")),
        "was removed or replaced while the run waited",
    ),
    "a folder that becomes another": (
        planted(lambda f: (f.rename(f.with_name("moved")), f.mkdir())),
        "was removed or replaced while the run waited",
    ),
    "a mailbox that is deleted": (
        planted(lambda f: f.parent.rename(f.parents[1] / "gone")),
        "was removed or replaced while the run waited",
    ),
    "a huge response": (
        planted(lambda f: write_hole(f / "response.json")),
        "the limit is 16 MiB",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_a_mailbox_that_a_stranger_writes_ends_in_one_message(make, tmp_path, name):
    plant, expected = HOSTILE[name]
    box, precious = tmp_path / "mailbox", tmp_path / "precious"
    box.mkdir()
    precious.mkdir()
    (precious / "key.json").write_text('{"name": "secret"}')
    plant(box)
    with panel_of(box) as panel, pytest.raises(ModelError) as refused:
        panel.ask_sync(make.request())
    assert expected in str(refused.value)
    assert "\n" not in str(refused.value)
    assert "secret" not in str(refused.value)
    left = {path.name for path in precious.iterdir()} - {"response.json", "error.md"}
    assert left == {"key.json"}
    if (precious / "error.md").exists():
        assert (precious / "error.md").read_text() == "precious"
        assert (precious / "response.json").read_text() == '{"name": 3}'
    assert (precious / "key.json").read_text() == '{"name": "secret"}'
