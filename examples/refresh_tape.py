"""Bind the answers of a tape to today's requests, after a prompt, schema or drawing has changed.

A tape finds an answer by the whole request, so a change of the guide loses it. This script asks
the first steps again through the mailbox and answers each request with the old answer of the same
name, for a person to look over with `git diff`:

    uv run python examples/refresh_tape.py examples/coffee.png \
        neoworld_mjx/data/tapes/coffee.tape.json
"""

import json
import sys
import tempfile
import threading
from pathlib import Path

from neoworld_mjx.config import load_config
from neoworld_mjx.mllm.replay import Tape
from neoworld_mjx.pipeline import reconstruct


def answer(mailbox: Path, texts: dict[str, str], done: threading.Event) -> None:
    """Answer requests by their names until `done` is set."""
    while not done.wait(0.1):
        for request in mailbox.glob("*/request.json"):
            response = request.with_name("response.json")
            if not response.exists():
                name = json.loads(request.read_text(encoding="utf-8"))["name"]
                part = response.with_name("response.part")
                part.write_text(texts[name], encoding="utf-8")
                part.replace(response)


def main(photo: Path, path: Path) -> None:
    """Refresh one tape in place, its header kept."""
    old = Tape.load(path)
    texts = {entry.name: entry.text for entry in old.answers.values()}
    with tempfile.TemporaryDirectory() as folder:
        done, new = threading.Event(), Path(folder) / "new.tape.json"
        mailbox = Path(folder) / "mailbox"
        clerk = threading.Thread(target=answer, args=(mailbox, texts, done), daemon=True)
        clerk.start()
        reconstruct(
            photo,
            Path(folder) / "run",
            load_config(None, {"provider": "mailbox"}),
            until="program",
            record=new,
            mailbox=mailbox,
        )
        done.set()
        fresh = Tape.load(new)
    models = {entry.name: entry.model for entry in old.answers.values()}
    for entry in fresh.answers.values():
        entry.model = models[entry.name]
    fresh.made = old.made
    fresh.save(path)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
