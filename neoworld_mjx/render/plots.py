"""Plot figures as SVG with matplotlib, an optional dependency."""

import io
import logging
from collections.abc import Callable
from typing import Any

_log = logging.getLogger(__name__)


def plot_svg(size: tuple[float, float], draw: Callable[[Any], None]) -> str | None:
    """Return a figure as SVG, or None if matplotlib is not installed.

    If matplotlib is not installed, log how to install it. Equal plots give equal bytes.

    Args:
        size: width and height [inch].
        draw: function that draws into a matplotlib figure.
    """
    try:
        import matplotlib
    except ImportError:
        _log.info("no figure, as matplotlib is missing: uv sync --inexact --extra plot")
        return None
    from matplotlib.figure import Figure

    # Use no pyplot: it would keep the figure in memory and need a display.
    with matplotlib.rc_context(
        {"font.size": 8, "svg.hashsalt": "neoworld", "svg.fonttype": "none"}
    ):
        figure = Figure(figsize=size, layout="constrained")
        draw(figure)
        file = io.BytesIO()
        figure.savefig(file, format="svg", metadata={"Date": None, "Creator": None})
    return file.getvalue().decode()
