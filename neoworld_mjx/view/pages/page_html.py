"""HTML fragments of the pages, with escaped text."""

from html import escape

STYLE = (
    "<style>.nw{font-size:13px;line-height:1.45;overflow-x:auto;padding:4px 10px}"
    ".nw table{border-collapse:collapse}"
    ".nw td,.nw th{padding:1px 8px 1px 0;text-align:left;vertical-align:top}"
    ".nw .fail{color:#c0392b}.nw .pass{color:#2a8a4a}.nw pre{white-space:pre-wrap}</style>"
)


def framed(*parts: str) -> str:
    """Return HTML parts as one element in the style of the pages."""
    return f'{STYLE}<div class="nw">{"".join(parts)}</div>'


def message(text: str, *, bad: bool = False) -> str:
    """Return a line of plain text as HTML, in red if `bad`."""
    return framed(f'<p class="{"fail" if bad else ""}">{escape(text)}</p>')
