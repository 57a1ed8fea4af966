"""Bind the answers of a tape to today's requests, after a prompt, schema or drawing has changed.

A tape finds an answer by the whole request, so a change of the guide loses it. This script asks
the first steps again through the mailbox and answers each request with the old answer of the same
name, for a person to look over with `git diff` (a changed version of the prompts goes into
`neoworld_mjx/data/examples.yaml`, `tests/test_examples.py` says which):

    uv run python examples/refresh_tape.py examples/coffee.png \
        neoworld_mjx/data/tapes/coffee.tape.json

Configurations named after them are asked, too, another language of programs after a colon: coffee
has answers for `configs/paper.yaml`, the microwave for `configs/paper.yaml:sdk` before it. Answers
of models called "by hand, Blender" are given where programs are asked for in Blender, which must be
installed then.
"""

import json
import sys
import tempfile
import threading
from pathlib import Path

from neoworld_mjx.config import Config, load_config
from neoworld_mjx.mllm.replay import Entry, Tape
from neoworld_mjx.pipeline import reconstruct


def answer(mailbox: Path, texts: dict[str, str], done: threading.Event) -> None:
    """Answer requests by their names until `done` is set; others wait for an answer by hand."""
    told: set[Path] = set()
    while not done.wait(0.1):
        for request in mailbox.glob("[0-9]*/request.json"):
            response = request.with_name("response.json")
            if response.exists() or response in told:
                continue
            name = json.loads(request.read_text(encoding="utf-8"))["name"]
            if name in texts:
                part = response.with_name("response.part")
                part.write_text(texts[name], encoding="utf-8")
                part.replace(response)
            else:
                told.add(response)
                print(f"the tape has no answer to {name}: write {response}", file=sys.stderr)


def main(photo: Path, path: Path, configs: list[str]) -> None:
    """Refresh one tape in place, its header kept, for the defaults and further configurations."""
    old = Tape.load(path)
    fresh = Tape(photo=old.photo, made=old.made, date=old.date)
    for number, given_config in enumerate([None, *configs]):
        config = _config(given_config)
        blender = config.program.language == "blender"
        # A name may have an answer for each configuration, as its pictures differ.
        given: dict[str, list[Entry]] = {}
        for entry in old.answers.values():
            given.setdefault(entry.name, []).append(entry)
        chosen: dict[str, Entry] = {}
        for name, some in given.items():
            same = [entry for entry in some if ("Blender" in entry.model) == blender] or some
            chosen[name] = same[min(number, len(same) - 1)]
        texts = {name: entry.text for name, entry in chosen.items()}
        until = "program" if given_config is None else "verify"
        answers = asked_again(photo, texts, config, until).answers
        for entry in answers.values():
            entry.model = chosen[entry.name].model
        fresh.answers |= answers
    left = {entry.name for entry in old.answers.values()}
    left -= {entry.name for entry in fresh.answers.values()}
    if left:
        sys.exit(f"not asked for, so the tape is left as it was: {', '.join(sorted(left))}")
    fresh.save(path)


def _config(given: str | None) -> Config:
    """Return a configuration given as FILE or FILE:LANGUAGE; None is that of the defaults."""
    if given is None:
        return load_config(None, {"provider": "mailbox"})
    path, _, language = given.partition(":")
    program = {"program": {"language": language}} if language else {}
    return load_config(Path(path), {"provider": "mailbox", **program})


def asked_again(photo: Path, texts: dict[str, str], config: Config, until: str) -> Tape:
    """Return the tape of one run whose requests are answered by their names."""
    with tempfile.TemporaryDirectory() as folder:
        done, new = threading.Event(), Path(folder) / "new.tape.json"
        mailbox = Path(folder) / "mailbox"
        clerk = threading.Thread(target=answer, args=(mailbox, texts, done), daemon=True)
        clerk.start()
        reconstruct(
            photo,
            Path(folder) / "run",
            config,
            until=until,
            record=new,
            mailbox=mailbox,
        )
        done.set()
        return Tape.load(new)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:])
