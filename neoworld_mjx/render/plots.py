"""Plot figures as SVG or PDF with matplotlib, an optional dependency."""

import io
import logging
from collections.abc import Callable
from typing import Any, Literal

_log = logging.getLogger(__name__)


def plot_svg(size: tuple[float, float], draw: Callable[[Any], None]) -> str | None:
    """Return a figure as SVG, or None if matplotlib is not installed.

    If matplotlib is not installed, log how to install it. Equal plots give equal bytes.

    Args:
        size: width and height [inch].
        draw: function that draws into a matplotlib figure.
    """
    data = plot(size, draw, "svg")
    return None if data is None else data.decode()


def plot(
    size: tuple[float, float], draw: Callable[[Any], None], form: Literal["svg", "pdf"]
) -> bytes | None:
    """Return a figure as SVG or PDF, or None if matplotlib is not installed; see `plot_svg`."""
    try:
        import matplotlib
    except ImportError:
        _log.info("no figure, as matplotlib is missing: uv sync --inexact --extra plot")
        return None
    from matplotlib.figure import Figure

    dates = {"svg": {"Date": None, "Creator": None}, "pdf": {"CreationDate": None}}
    # Use no pyplot: it would keep the figure in memory and need a display.
    with matplotlib.rc_context(
        {"font.size": 8, "svg.hashsalt": "neoworld", "svg.fonttype": "none", "pdf.fonttype": 42}
    ):
        figure = Figure(figsize=size, layout="constrained")
        draw(figure)
        file = io.BytesIO()
        figure.savefig(file, format=form, metadata=dates[form])
    return file.getvalue()
