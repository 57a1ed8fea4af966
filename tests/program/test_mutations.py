from concurrent.futures import ThreadPoolExecutor

import pytest

from neoworld_mjx.program import build
from tests.support.mutants import crashed, programs

BLOCKS = programs()


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
