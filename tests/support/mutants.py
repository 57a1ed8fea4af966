"""Mutants of valid programs: tokens dropped, swapped, doubled or reversed, numbers changed."""

import random
import re
from collections.abc import Sequence

from neoworld_mjx.config import ProgramOptions
from neoworld_mjx.program import build
from neoworld_mjx.program.synthesise import guide

_TOKEN = re.compile(r"\s+|\w+|[^\w\s]")
_NUMBERS = ("0", "-1", "1e9", "1e-9", "100", "0.5", "1000000", "3", "64", "1e400")


def programs() -> list[str]:
    """Return the programs of the guide, all valid."""
    return re.findall(r"```python\n(.*?)```", guide(), re.DOTALL)


def mutate(text: str, source: random.Random) -> str:
    """Drop, swap, double or reverse tokens of a program, and change its numbers."""
    tokens = _TOKEN.findall(text)
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
            tokens[source.choice(numbers)] = source.choice(_NUMBERS)
        elif kind == 4:
            i, j = source.choice(numbers), source.choice(numbers)
            tokens[i], tokens[j] = tokens[j], tokens[i]
        else:
            tokens[at] = tokens[at][::-1]
    return "".join(tokens)


def crashed(seed: int, count: int, valid: Sequence[str] | None = None) -> list[str]:
    """Return mutants that ended in neither an object nor a signal about the program.

    Args:
        seed: seed of the mutations.
        count: number of mutants.
        valid: programs to mutate; by default the guide's.
    """
    source, bad = random.Random(seed), []
    originals = list(valid or programs())
    for k in range(count):
        text = mutate(source.choice(originals), source)
        # Mutants without a type check run further, so only every fourth has one.
        built = build(text, ProgramOptions(type_check=k % 4 == 0))
        codes = {signal.code for signal in built.signals}
        if codes & {"internal", "crashed", "busy"} or (built.spec is None and not codes):
            bad.append(text)
    return bad
