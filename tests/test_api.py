"""The public names, README's example of them, and errors for arguments of a wrong type."""

import inspect
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

import neoworld_mjx as nw
from neoworld_mjx.errors import ConfigError

ROOT = Path(__file__).parents[1]


def test_every_public_name_resolves_and_has_a_docstring():
    for name in nw.__all__:
        assert getattr(nw, name).__doc__, name
    assert set(nw.__all__) <= set(dir(nw))
    with pytest.raises(AttributeError, match="no attribute 'refin'"):
        nw.refin  # noqa: B018


def test_the_readme_example_runs(quick_run, tmp_path, monkeypatch, capsys):
    shutil.copytree(quick_run, tmp_path / "out")
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.S)
    names = {}
    exec(code, names)
    printed = capsys.readouterr().out
    assert printed.startswith("Result('out': ")
    assert "objects: table, saucer, cup, spoon" in printed
    assert np.isfinite(names["again"].history["absolute"].max())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((3, "out"), "photo must be a path, got int"),
        (("photo.png", None), "out must be a path, got NoneType"),
        (("photo.png", "out", {"seed": 1}), r"config must be a Config, got dict: .*load_config"),
    ],
)
def test_reconstruct_names_an_argument_of_a_wrong_type(arguments, message):
    with pytest.raises(ConfigError, match=message):
        inspect.unwrap(nw.reconstruct)(*arguments)
