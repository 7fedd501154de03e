"""HTML pages without external files, from the parts of `page_parts` through one template.

The template escapes text; drawings are inserted unchanged.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from functools import cache
from pathlib import Path
from typing import Final

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from models.shared.page_parts import Part, Section
from models.shared.palette import css_variables

HERE: Final = Path(__file__).parent
STYLE: Final = HERE / "style.css"


def stylesheet() -> str:
    """Style sheet of every page, with the colours of the palette."""
    return css_variables() + STYLE.read_text(encoding="utf-8")


def render_page(
    title: str,
    lead: Sequence[Part],
    sections: Sequence[Section],
    made: datetime | None = None,
) -> str:
    """Render a whole page, with a table of contents of its sections.

    `made` is the time stamp of the page, in UTC.
    """
    return _environment().get_template("page.html").render(
        title=title,
        lead=lead,
        sections=sections,
        style=stylesheet(),
        made=made.strftime("%d %B %Y, %H:%M UTC") if made else "",
    )  # fmt: skip


@cache
def _environment() -> Environment:
    return Environment(
        loader=FileSystemLoader(HERE), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
