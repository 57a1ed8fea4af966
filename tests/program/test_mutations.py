import random
import re
from concurrent.futures import ThreadPoolExecutor
from importlib import resources

import pytest

from neoworld_mjx.config import ProgramOptions
from neoworld_mjx.program import build

GUIDE = resources.files("neoworld_mjx.program").joinpath("guide.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", GUIDE, re.DOTALL)
TOKEN = re.compile(r"\s+|\w+|[^\w\s]")
NUMBERS = ("0", "-1", "1e9", "1e-9", "100", "0.5", "1000000", "3", "64", "1e400")


def mutate(text: str, source: random.Random) -> str:
    """Drop, swap, double or reverse tokens, and change numbers."""
    tokens = TOKEN.findall(text)
    for _ in range(source.choice((1, 1, 1, 2, 3, 5))):
        at, other = source.randrange(len(tokens)), source.randrange(len(tokens))
        numbers = [k for k, token in enumerate(tokens) if token[0].isdigit()]
        kind = source.randrange(6)
        if kind == 0:
            del tokens[at]
        elif kind == 1:
            tokens[at], tokens[other] = tokens[other], tokens[at]
        elif kind == 2:
            tokens.insert(at, tokens[other])
        elif kind == 3:
            tokens[source.choice(numbers)] = source.choice(NUMBERS)
        elif kind == 4:
            one, two = source.choice(numbers), source.choice(numbers)
            tokens[one], tokens[two] = tokens[two], tokens[one]
        else:
            tokens[at] = tokens[at][::-1]
    return "".join(tokens)


def crashed(seed: int, count: int) -> list[str]:
    """Return mutants that ended in anything but an object or a signal about the program."""
    source, bad = random.Random(seed), []
    for k in range(count):
        text = mutate(source.choice(BLOCKS), source)
        # Unchecked mutants get further; some go the usual way.
        built = build(text, ProgramOptions(type_check=k % 4 == 0))
        told = {signal.code for signal in built.signals}
        if told & {"internal", "crashed", "busy"} or (built.spec is None and not told):
            bad.append(text)
    return bad


def test_mutants_never_crash():
    assert crashed(seed=0, count=120) == []


@pytest.mark.slow
def test_5000_mutants_never_crash():
    assert crashed(seed=1, count=5000) == []


def test_programs_run_at_once_without_mixing():
    alone = {text: build(text) for text in BLOCKS}
    with ThreadPoolExecutor(8) as threads:
        together = list(threads.map(build, BLOCKS * 3))
    for text, built in zip(BLOCKS * 3, together, strict=True):
        assert built.ok and built.spec is not None
        assert built.spec == alone[text].spec and built.lines == alone[text].lines
