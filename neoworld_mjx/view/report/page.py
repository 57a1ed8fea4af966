"""HTML of the report, from Jinja templates that escape all text."""

from collections.abc import Iterable
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

_ENVIRONMENT = Environment(
    loader=PackageLoader("neoworld_mjx.view.report", "html"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
elements: Any = _ENVIRONMENT.get_template("elements.html").module
"""The macros of html/elements.html; each returns markup."""


def document(title: str, body: Iterable[Markup], scripts: Iterable[str] = ()) -> str:
    """Return a self-contained page.

    The page's content security policy forbids network access and all scripts except `scripts`.

    Args:
        title: title of the page.
        body: sections of the page.
        scripts: hashes of the allowed scripts, in the form of a content security policy.
    """
    policy = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
    allowed = " ".join(scripts)
    policy += f"; script-src {allowed}" if allowed else ""
    page = _ENVIRONMENT.get_template("page.html")
    return page.render(title=title, body=body, policy=Markup(policy))
