"""Pages as one HTML file: sections of paragraphs, tables, figures, facts and commands.

Text is plain text and is escaped when the page is rendered; `Markup` and drawings are inserted as
they are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import ClassVar, Final, NamedTuple

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from firmware_py.core.output_files import write_whole
from firmware_py.core.units import DisplayUnit
from models.shared.palette import css_variables

NO_VALUE = "–"
"""Text of a table cell without a value."""

PHONE_COLUMNS: Final = 4
"""Most columns of numbers that fit on a phone."""


def value_text(value: float | None, unit: DisplayUnit) -> str:
    return NO_VALUE if value is None else unit.text(value)


Text = str | Markup


@dataclass(frozen=True)
class Paragraph:
    """Running text, or a lead, a note or a line about missing inputs."""

    macro: ClassVar = "paragraph"
    text: Text
    kind: str = ""  # "" for running text, "lead", "note" or "missing"


@dataclass(frozen=True)
class Notice:
    """Coloured line with a label, that a reader must not overlook."""

    macro: ClassVar = "notice"
    kind: str  # Selects the colour: "simulated", "measured", "mixed" or "unknown"
    label: str  # The kind in words
    text: Text


@dataclass(frozen=True)
class TableCell:
    """Text of a cell, whether it meets its target, and a shade between 0 and 1 for its size."""

    text: Text
    met: bool | None = None  # None without a target
    shade: float | None = None


Cell = TableCell | Text


@dataclass(frozen=True)
class Table:
    """Table whose first column names the rows."""

    macro: ClassVar = "table"
    title: str  # Heading; "" for none
    header: Sequence[Text]  # Names of the columns
    rows: Sequence[Sequence[Cell]]  # Cells, one per column
    note: str = ""

    @property
    def is_wide(self) -> bool:
        """Whether a phone shows each row as a list; shades need their rows and columns."""
        shaded = any(cell.shade is not None for row in self.cells for cell in row)
        return len(self.header) > PHONE_COLUMNS and not shaded

    @property
    def cells(self) -> list[list[TableCell]]:
        return [[c if isinstance(c, TableCell) else TableCell(c) for c in row] for row in self.rows]


@dataclass(frozen=True)
class Panel:
    """Drawing in a figure."""

    title: str
    alt: str  # What the drawing shows, for readers who cannot see it
    svg: str


class LegendEntry(NamedTuple):
    """Line of a legend; `dash` is "solid", "dashed" or "dotted"."""

    colour: str
    label: str
    dash: str = "solid"


@dataclass(frozen=True)
class Figure:
    """Panels under one heading and one legend, side by side if there is room."""

    macro: ClassVar = "figure"
    title: str  # Heading; "" for none
    note: str  # Sentence below the heading
    panels: Sequence[Panel]
    legend: Sequence[LegendEntry] = ()  # What the colours stand for


@dataclass(frozen=True)
class Facts:
    """Names with short values, such as software versions."""

    macro: ClassVar = "facts"
    rows: Sequence[tuple[str, str]]


@dataclass(frozen=True)
class CommandList:
    """Commands in order."""

    macro: ClassVar = "commands"
    commands: Sequence[str]


@dataclass(frozen=True)
class Folded:
    """Parts that the reader unfolds; paper shows them."""

    macro: ClassVar = "folded"
    title: str
    parts: Sequence[Paragraph | Table | Figure | Facts | CommandList]


Part = Paragraph | Notice | Table | Figure | Facts | CommandList | Folded


@dataclass(frozen=True)
class Section:
    """Section of a page with a heading; its parts are shown in order."""

    id: str
    title: str
    parts: list[Part] = field(default_factory=list)


def missing_inputs(commands: Mapping[str, str]) -> Paragraph:
    """Line about inputs that a page lacks, with the command that writes each."""
    row = Markup("{} (<code>{}</code>)")
    listed = Markup(", ").join(row.format(what, command) for what, command in commands.items())
    return Paragraph(Markup("Not in this report: {}.").format(listed), "missing")


def folded_commands(commands: Sequence[str]) -> Folded:
    """The commands that made a page's inputs."""
    return Folded(f"{len(commands)} commands", [CommandList(commands)])


STYLE: Final = Path(__file__).with_name("style.css")


def stylesheet() -> str:
    """Style sheet of every page, with the colours of the palette."""
    return css_variables() + STYLE.read_text(encoding="utf-8")


def render_page(
    title: str, lead: Sequence[Part], sections: Sequence[Section], made: datetime | None = None
) -> str:
    """Whole page, with a table of contents of its sections; `made` is its time stamp in UTC."""
    environment = Environment(
        loader=FileSystemLoader(STYLE.parent), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    return environment.get_template("page.html").render(
        title=title, lead=lead, sections=sections, style=stylesheet(),
        made=made.strftime("%d %B %Y, %H:%M UTC") if made else "",
    )  # fmt: skip


def write_page(path: Path, page: str) -> int:
    """Write a page, with its directory; return its size in bytes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    data = page.encode("utf-8")
    write_whole(path, data)
    return len(data)
