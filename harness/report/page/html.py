"""Turns the content of a page into one HTML file with style, scripts, Plotly's library and data in it.

Every text is escaped. A Content-Security-Policy permits the page's own scripts by their hashes, and no
connection: a text that became markup against all this could neither run nor load anything.
"""

import base64
import hashlib
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from harness.report.page.content import Link, Page
from harness.report.page.encoding import script_json

TEMPLATES = Path(__file__).parent / "templates"
_PLOTLY_SLOT, _DATA_SLOT = b"<!--plotly-->", b"<!--data-->"
"""Places in the rendered template; no escaped text contains them."""


def render(page: Page) -> bytes:
    """Return the HTML of a page. Raises OSError if the templates or Plotly's library cannot be read."""
    script, library = _asset("page.js"), get_plotlyjs().encode()
    hashes = " ".join(f"'sha256-{_hash(each)}'" for each in (script.encode(), library))
    text: str = (
        _environment()
        .get_template("page.html.j2")
        .render(page=page, style=_own(_asset("page.css")), script=_own(script), script_hashes=_own(hashes))
    )
    head, _, rest = text.encode().partition(_PLOTLY_SLOT)
    body, _, tail = rest.partition(_DATA_SLOT)
    return b"".join([head, library, body, script_json(page.payload()).encode(), tail])


def _own(text: str) -> Markup:
    """Return a text of this package, which is not escaped."""
    return Markup(text)  # noqa: S704  no text of a scenario or run


def _hash(content: bytes) -> str:
    return base64.b64encode(hashlib.sha256(content).digest()).decode("ascii")


def _asset(name: str) -> str:
    return (TEMPLATES / name).read_text(encoding="utf-8")


@cache
def _environment() -> Environment:
    made = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    made.tests["link"] = _is_link
    return made


def _is_link(value: Any) -> bool:  # noqa: ANN401  any cell
    return isinstance(value, Link)
