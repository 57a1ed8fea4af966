"""README and pages: every command parses, every Python block is run or listed with the reason."""

import os
import re
import shlex
import shutil
from pathlib import Path

import pytest

from neoworld_mjx import cli

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
GENERATED = {"options.md", "differences-from-the-paper.md"}
COMMAND = re.compile(r"^    (?:uv run )?(?:--extra \w+ )?(?:[A-Z]+=\S+ )?(neoworld .*)", re.M)
BLOCK = re.compile(r"^```python\n(.*?)^```", re.M | re.S)
PLACEHOLDERS = {"SUITE": "photos", "SUITE,": "photos", "NAME": "coffee"}
RUN_BY = {
    "docs/how-to/sample-scenes.md": "tests/environments/test_samples.py",
    "docs/how-to/simulate-with-mjx.md": "tests/notebooks/test_mjx_loop.py",
    "docs/how-to/write-a-reward.md": "tests/notebooks/test_howto.py",
    "docs/how-to/write-your-own-search.md": "tests/notebooks/test_own_search.py",
    "docs/programs.md": "tests/program/test_guide.py",
}
"""Pages whose blocks another test runs."""
NOT_RUN = {
    "docs/how-to/use-in-simulators.md": "needs a finished run, and a simulator beside it",
    "docs/benchmark.md": "takes long; tests/bench/test_tasks.py executes plans by the same calls",
    "docs/models.md": "needs a model, and names of a program around it",
    "docs/how-to/sweeps.md": "needs pandas and finished sweeps; tests/sweeps runs sweeps",
    "docs/how-to/photo-to-policy.md": "trains for minutes; tests/environments/test_policies.py "
    "uses the same calls",
    "docs/how-to/learn-in-environments.md": "needs a run with a drawer; the notebook "
    "open_a_drawer and tests/environments use the same calls",
    "docs/how-to/robots-and-tasks.md": "needs a run with a drawer and a robot's package; "
    "tests/environments/test_reach.py uses the same calls",
}
"""Pages whose blocks are only imported, and why."""


def _name(page):
    return page.relative_to(ROOT).as_posix()


def _commands():
    for page in PAGES:
        if page.name in GENERATED:
            continue
        for line in COMMAND.findall(page.read_text(encoding="utf-8")):
            yield pytest.param(line, id=f"{_name(page)}: {line[:60]}")


def _words(line):
    """Return a line's arguments without comments, options in brackets and further choices."""
    line = re.sub(r"\[[^\]]*\]", "", line.split(" #")[0])
    rest = re.split(r" {2,}(?!-)| > ", line.removeprefix("neoworld"))[0].strip()
    rest = re.sub(r"(\S+?)\|\S+", r"\1", rest)
    return [PLACEHOLDERS.get(word, word) for word in shlex.split(rest)]


@pytest.mark.parametrize("line", list(_commands()))
def test_a_command_of_the_pages_can_be_given(line):
    words = _words(line)
    if words == ["sweep"]:
        return  # Named in a sentence.
    if words[:1] in (["export"], ["check"]) and len(words) == 1:
        words.append("out")
    command = cli.parse(words[0], words[1:])
    assert callable(command.run)


@pytest.mark.parametrize(
    "page", [page for page in PAGES if BLOCK.search(page.read_text(encoding="utf-8"))], ids=_name
)
def test_every_python_block_is_run_somewhere_or_says_why_not(page, monkeypatch, tmp_path):
    name = _name(page)
    if name in RUN_BY:
        assert page.name in (ROOT / RUN_BY[name]).read_text(encoding="utf-8")
        return
    if name == "README.md":
        return  # Below, slow.
    monkeypatch.chdir(tmp_path)
    (tmp_path / "photo.png").write_bytes(b"a picture")
    for block in BLOCK.findall(page.read_text(encoding="utf-8")):
        if name not in NOT_RUN:
            exec(compile(block, name, "exec"), {})
            continue
        imports = [line for line in block.splitlines() if re.match(r"(from|import) ", line)]
        for line in imports:
            if not re.search(r"pandas|isaaclab|\(", line):
                exec(compile(line, name, "exec"), {})


def test_no_page_is_listed_that_is_gone():
    names = {_name(page) for page in PAGES if BLOCK.search(page.read_text(encoding="utf-8"))}
    assert RUN_BY.keys() | NOT_RUN.keys() <= names


@pytest.mark.slow
def test_the_python_of_the_readme_runs(monkeypatch, tmp_path, capsys):
    shutil.copytree(ROOT / "examples", tmp_path / "examples", ignore=shutil.ignore_patterns("o*"))
    monkeypatch.chdir(tmp_path)
    (block,) = BLOCK.findall((ROOT / "README.md").read_text(encoding="utf-8"))
    exec(compile(block, "README.md", "exec"), {})
    assert "Result(" in capsys.readouterr().out
    assert os.path.exists("out/scene.xml")
