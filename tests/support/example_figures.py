"""Comparison of a reconstruction of a bundled example with the figures of the pages."""

from collections.abc import Mapping

import pytest

from benchmarks.figure import read_figure

TOLERANCES = {
    **{"objects": 0.0, "joints": 0.0, "calls": 0.0},
    **{"drift, mm": 0.1, "tilt, degrees": 0.2, "overlap, mm": 0.1, "box IoU": 0.01},
}


def check_figures(name: str, measured: Mapping[str, float | bool]) -> None:
    """Compare measured values, by column of the figure `examples`, within TOLERANCES."""
    figure = read_figure("examples")
    for column, value in measured.items():
        cell = figure.cell(name, column)
        if isinstance(value, bool):
            assert cell == ("yes" if value else "no"), (name, column)
        else:
            known = 0.0 if cell.startswith("under") else float(cell)
            near = pytest.approx(known, abs=TOLERANCES[column] + 1e-9)
            assert value == near, (
                f"{name}, {column}: {value} is not what the pages state; measure again: "
                "neoworld bench run examples --json > examples.json; "
                "python -m benchmarks.page --record examples examples.json"
            )
