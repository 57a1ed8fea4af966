"""Bind the answers of a tape to today's requests, after a prompt, schema or drawing has changed.

A tape finds an answer by the whole request, so a change of the guide loses it. This script asks
the first steps again through the mailbox and answers each request with the old answer of the same
name, for a person to look over with `git diff`:

    uv run python examples/refresh_tape.py examples/coffee.png \
        neoworld_mjx/data/tapes/coffee.tape.json

Configurations named after them are asked, too; the microwave has answers for configs/paper.yaml.
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


def main(photo: Path, path: Path, configs: list[Path]) -> None:
    """Refresh one tape in place, its header kept, for the defaults and further configurations."""
    old = Tape.load(path)
    fresh = Tape(photo=old.photo, made=old.made)
    for number, config in enumerate([None, *configs]):
        # A name may have an answer for each configuration, as its pictures differ.
        given: dict[str, list[str]] = {}
        for entry in old.answers.values():
            given.setdefault(entry.name, []).append(entry.text)
        texts = {name: some[min(number, len(some) - 1)] for name, some in given.items()}
        fresh.answers |= asked_again(photo, texts, config).answers
    models = {entry.name: entry.model for entry in old.answers.values()}
    for entry in fresh.answers.values():
        entry.model = models[entry.name]
    left = {entry.name for entry in old.answers.values()}
    left -= {entry.name for entry in fresh.answers.values()}
    if left:
        sys.exit(f"not asked for, so the tape is left as it was: {', '.join(sorted(left))}")
    fresh.save(path)


def asked_again(photo: Path, texts: dict[str, str], config: Path | None) -> Tape:
    """Return the tape of one run whose requests are answered by their names."""
    with tempfile.TemporaryDirectory() as folder:
        done, new = threading.Event(), Path(folder) / "new.tape.json"
        mailbox = Path(folder) / "mailbox"
        clerk = threading.Thread(target=answer, args=(mailbox, texts, done), daemon=True)
        clerk.start()
        reconstruct(
            photo,
            Path(folder) / "run",
            load_config(config, {"provider": "mailbox"}),
            until="program" if config is None else "verify",
            record=new,
            mailbox=mailbox,
        )
        done.set()
        return Tape.load(new)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), [Path(name) for name in sys.argv[3:]])
