"""The page on a search of one's own runs as it stands, on the composed scene of the example."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs/how-to/write-your-own-search.md"
SCENE = ROOT / "benchmarks/neoworld_bench/photographs/real/coffee.json"


@pytest.mark.slow
def test_the_pages_search_improves_its_population(tmp_path, monkeypatch, capsys):
    (code,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)
    assert code.count("\n") <= 50
    (tmp_path / "out/compose").mkdir(parents=True)
    shutil.copy(SCENE, tmp_path / "out/compose/scene.json")
    monkeypatch.chdir(tmp_path)
    space = {}
    exec(code, space)
    lines = capsys.readouterr().out.splitlines()
    means = [float(line.rpartition(" ")[2]) for line in lines[:-1]]
    assert len(means) == 4 and means[-1] > means[0]
    assert lines[-1] in ("valid", "not valid")
    assert np.isfinite(space["best_reward"])
    assert space["result"].name == space["scene"].spec.name
