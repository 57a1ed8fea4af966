"""Plots of figures as SVG, by matplotlib where it is installed."""

import io
import logging
from collections.abc import Callable
from typing import Any

_log = logging.getLogger(__name__)


def plot_svg(size: tuple[float, float], draw: Callable[[Any], None]) -> str | None:
    """Return a figure as SVG, the same bytes for the same plot; None without matplotlib.

    The log says what to install where it is not.

    Args:
        size: width and height [inch].
        draw: draws into the matplotlib figure that it is given.
    """
    try:
        import matplotlib
    except ImportError:
        _log.info("no figure: uv sync --inexact --extra plot draws one")
        return None
    from matplotlib.figure import Figure

    # A figure of its own: pyplot would keep it, and ask for a display.
    with matplotlib.rc_context(
        {"font.size": 8, "svg.hashsalt": "neoworld", "svg.fonttype": "none"}
    ):
        figure = Figure(figsize=size, layout="constrained")
        draw(figure)
        drawn = io.StringIO()
        figure.savefig(drawn, format="svg", metadata={"Date": None, "Creator": None})
    return drawn.getvalue()
