"""The other side of a mailbox lists, reads and answers what a run waits for, and nothing else."""

import threading

import pytest

from neoworld_mjx.errors import ModelError
from neoworld_mjx.mllm import Panel, Picture, mailbox, mailbox_client
from neoworld_mjx.mllm.mailbox import Mailbox
from neoworld_mjx.mllm.mailbox_client import forget_waiting, open_requests, read_request, respond


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(mailbox, "POLL_S", 0.01)
    monkeypatch.setattr(mailbox_client, "POLL_S", 0.01)


@pytest.fixture
def asked(make, tmp_path):
    """Ask a request in a thread; return the mailbox and the future of the response."""
    box = tmp_path / "box"
    with Panel(Mailbox(box, timeout_s=20)) as panel:

        def ask(name="program:cup", **more):
            known = set(open_requests(box))
            future = panel.ask_soon(make.request(name=name, **more))
            while set(open_requests(box)) <= known:
                threading.Event().wait(0.01)
            return box, future

        yield ask


def test_a_request_is_read_in_its_parts(make, asked):
    pictures = [Picture(f"view {k}", make.noise()) for k in range(11)]
    request = make.request(name="program:cup", pictures=pictures)
    box, _ = asked(pictures=pictures)
    read = read_request(box)
    assert (read.id, read.title) == ("0001-program-cup", f"program:cup ({request.role})")
    assert (read.instructions, read.prompt) == (request.system, request.prompt)
    assert [picture.label for picture in read.pictures] == [f"{k + 1}-view-{k}" for k in range(11)]
    assert [p.pixels for p in read.pictures] == [p.pixels for p in pictures]


def test_responses_are_accepted_or_rejected_at_once(make, asked):
    box, future = asked()
    reason = respond(box, "0001-program-cup", '{"name": 3}', timeout_s=20)
    assert "name: Input should be a valid string, got 3" in reason
    assert open_requests(box) == ["0001-program-cup"]
    assert "a JSON object is needed" in respond(box, "0001-program-cup", "3", timeout_s=20)
    assert respond(box, "0001-program-cup", '{"name": "red"}', timeout_s=20) == ""
    assert future.result(20).value.name == "red"
    assert open_requests(box) == []
    with pytest.raises(ModelError, match="no request is open, got '0001-program-cup'"):
        respond(box, "0001-program-cup", '{"name": "red"}', timeout_s=1)


def test_only_names_of_open_requests_are_taken(asked, tmp_path):
    box, _ = asked()
    (tmp_path / "secret").mkdir()
    (tmp_path / "secret" / "waiting.md").write_text("")
    (box / "0009-link").symlink_to(tmp_path / "secret")
    for name in ("../secret", "0009-link", str(tmp_path / "secret"), "", "0001-program-cap"):
        with pytest.raises(ModelError, match="valid are: 0001-program-cup"):
            respond(box, name, "{}", timeout_s=1)
        with pytest.raises(ModelError, match="valid are: 0001-program-cup"):
            read_request(box, name)
    assert [path.name for path in (tmp_path / "secret").iterdir()] == ["waiting.md"]


def test_a_request_of_a_run_that_was_killed_opens_again_with_the_run(make, asked, tmp_path):
    folder = tmp_path / "box" / "0001-old"
    folder.mkdir(parents=True)
    (folder / "waiting.md").write_text("")
    assert open_requests(tmp_path / "box") == ["0001-old"]
    forget_waiting(tmp_path / "box")
    assert open_requests(tmp_path / "box") == []
    box, _ = asked()
    assert open_requests(box) == ["0002-program-cup"]
