"""The notebooks run, and each is the same as the script beside it."""

from pathlib import Path

import jupytext
import pytest
from nbclient import NotebookClient

# In small form they run in test_sweep, test_environments and test_pipeline.
SLOW = {"quickstart", "sweep_with_plots", "policy_rollouts_in_mjx"}
NOTEBOOKS = sorted((Path(__file__).parents[2] / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize(
    "path",
    [
        pytest.param(path, marks=[pytest.mark.slow] if path.stem in SLOW else [])
        for path in NOTEBOOKS
    ],
    ids=lambda path: path.stem,
)
def test_a_notebook_runs_and_is_its_script(path):
    notebook, script = jupytext.read(path), jupytext.read(path.with_suffix(".py"))
    cells = [[(cell.cell_type, cell.source) for cell in nb.cells] for nb in (notebook, script)]
    assert cells[0] == cells[1], "bring them together with jupytext --sync"
    NotebookClient(notebook, timeout=300, resources={"metadata": {"path": path.parent}}).execute()


def test_there_are_notebooks():
    assert NOTEBOOKS
