"""Plot figures as SVG with matplotlib, an optional dependency."""

import io
import logging
from collections.abc import Callable
from typing import Any

_log = logging.getLogger(__name__)


def plot_svg(size: tuple[float, float], draw: Callable[[Any], None]) -> str | None:
    """Return a figure as SVG; log how to install matplotlib and return None without it.

    The same plot gives the same bytes.

    Args:
        size: width and height [inch].
        draw: function that draws into a matplotlib figure.
    """
    try:
        import matplotlib
    except ImportError:
        _log.info("no figure: uv sync --inexact --extra plot draws one")
        return None
    from matplotlib.figure import Figure

    # pyplot would keep the figure in memory and need a display.
    with matplotlib.rc_context(
        {"font.size": 8, "svg.hashsalt": "neoworld", "svg.fonttype": "none"}
    ):
        figure = Figure(figsize=size, layout="constrained")
        draw(figure)
        svg = io.StringIO()
        figure.savefig(svg, format="svg", metadata={"Date": None, "Creator": None})
    return svg.getvalue()
