"""Pages without outside files, in one look (`style.css`): sections, tables, pictures side by side.

What is put in as text is escaped here; bodies, cells and drawings are HTML already.
"""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from firmware_py.display_units import error_unit
from models.shared.palette import css_variables

STYLE: Final = Path(__file__).with_name("style.css")


@dataclass(frozen=True)
class Section:
    """A part of the page: heading, its body as HTML, a sentence below."""

    id: str
    title: str
    body: str
    note: str = ""


def page_of(title: str, opening: str, parts: Sequence[Section]) -> str:
    """A whole page in the look of the others."""
    contents = "".join(f'<a href="#{s.id}">{html.escape(s.title)}</a>' for s in parts)
    body = "".join(
        f'<section id="{s.id}"><h2>{html.escape(s.title)}</h2>{s.body}'
        + (f'<p class="note">{s.note}</p>' if s.note else "")
        + "</section>\n"
        for s in parts
    )
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<title>{html.escape(title)}</title><link rel="icon" href="data:,">'
        f"<style>\n{stylesheet()}</style></head>\n<body><header>"
        f'<p class="kicker">dropstitch</p><h1>{html.escape(title)}</h1>{opening}'
        f'<nav aria-label="Contents">{contents}</nav></header>\n<main>{body}</main>'
        "</body></html>\n"
    )


def table_of(header: Sequence[str], rows: Iterable[Sequence[str]], title: str = "") -> str:
    """A table of the page's style; cells are HTML, the first of a row is its heading."""
    head = "".join(f'<th scope="col">{name}</th>' for name in header)
    body = "".join(
        f'<tr><th scope="row">{row[0]}</th>' + "".join(f"<td>{c}</td>" for c in row[1:]) + "</tr>"
        for row in rows
    )
    caption = f"<caption>{title}</caption>" if title else ""
    label = html.escape(title or header[0] or "Table")
    return (
        f'<div class="table" tabindex="0" role="region" aria-label="{label}"><table>{caption}'
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"
    )


def stylesheet() -> str:
    """The style of every page, its colours from the palette."""
    return css_variables() + STYLE.read_text(encoding="utf-8")


def readable(value: float, unit: str) -> str:
    """A value in the unit in which people read it."""
    return error_unit(unit).significant(value)


def panels_of(panels: Iterable[tuple[str, str]]) -> str:
    """Titles and drawings, side by side where there is room."""
    figures = "".join(
        f"<figure><figcaption>{html.escape(title)}</figcaption>"
        f'<div role="img" aria-label="{html.escape(title)}">{drawing}</div></figure>'
        for title, drawing in panels
    )
    return f'<div class="panels">{figures}</div>'
