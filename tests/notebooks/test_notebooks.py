"""The notebooks run, each is the same as the script beside it, and all cells have their outputs."""

import ast
from pathlib import Path

import jupytext
import pytest
from nbclient import NotebookClient

NOTEBOOKS = sorted((Path(__file__).parents[2] / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_its_script(path):
    notebook, script = jupytext.read(path), jupytext.read(path.with_suffix(".py"))
    cells = [[(cell.cell_type, cell.source) for cell in nb.cells] for nb in (notebook, script)]
    assert cells[0] == cells[1], "bring them together with jupytext --sync"


@pytest.mark.slow  # Two run in small form in test_sweep and test_pipeline.
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path):
    notebook = jupytext.read(path)
    had_outputs = [bool(cell.outputs) for cell in code_cells(notebook)]
    NotebookClient(notebook, timeout=300, resources={"metadata": {"path": path.parent}}).execute()
    assert [bool(cell.outputs) for cell in code_cells(notebook)] == had_outputs


def code_cells(notebook):
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def shows(source):
    """Return whether a cell prints at its top level, or ends in a value that is not silenced."""
    body = ast.parse(source).body
    calls = [node.value for node in body if isinstance(node, ast.Expr)]
    prints = any(isinstance(c, ast.Call) and ast.unparse(c.func) == "print" for c in calls)
    value = body and isinstance(body[-1], ast.Expr) and not source.rstrip().endswith(";")
    return prints or bool(value)


def missing(notebook):
    """Return what the cells of a notebook lack, by number."""
    lacks = []
    for number, cell in enumerate(code_cells(notebook), start=1):
        if cell.execution_count != number:
            lacks.append(f"cell {number} was not run in order")
        elif shows(cell.source) and not cell.outputs:
            lacks.append(f"cell {number} has no output")
        lacks += [f"cell {number} failed" for o in cell.outputs if o.output_type == "error"]
    return lacks


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_every_cell_was_run_and_has_its_output(path):
    notebook = jupytext.read(path)
    assert missing(notebook) == []
    assert any(cell.outputs for cell in code_cells(notebook))
