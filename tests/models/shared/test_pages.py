"""Pages and drawings: sound HTML with escaped text, unique ids."""

import re
from html.parser import HTMLParser

import pytest
from markupsafe import Markup

from models.shared.drawing import Drawing
from models.shared.pages import (
    CommandList,
    Facts,
    Figure,
    Folded,
    LegendEntry,
    Panel,
    Paragraph,
    Section,
    Table,
    TableCell,
    missing_inputs,
    render_page,
)

PANEL = Panel("x over t", "a rising line", '<svg viewBox="0 0 1 1"></svg>')
PARTS = {
    "paragraph": Paragraph("plain <text>", "note"),
    "markup": Paragraph(Markup("<b>{}</b>").format("<bold>")),
    "table": Table(
        "sizes", ["name", "value"], [["a", TableCell("1", True)], ["b", TableCell("2", False)]]
    ),
    "figure": Figure("A figure", "a note", [PANEL], [LegendEntry("red", "line", "dashed")]),
    "facts": Facts([("python", "3")]),
    "commands": CommandList(["make <all>"]),
    "folded": Folded("more", [CommandList(["make <all>"])]),
    "missing": missing_inputs({"demo": "make <demo>"}),
}


class Balance(HTMLParser):
    """Tags that are open."""

    def __init__(self, page):
        super().__init__()
        self.open = []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        if tag not in ("meta", "link", "br"):
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        """A tag that closes itself leaves nothing open."""

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


@pytest.mark.parametrize("name", PARTS)
def test_every_part_is_sound_html_and_escapes_its_text(name):
    sections = [Section("one", "First", [PARTS[name]]), Section("two", "Second", [])]
    page = render_page("A <title>", [Paragraph("lead")], sections)
    assert Balance(page).open == []
    assert "<title>dropstitch: A &lt;title&gt;</title>" in page
    for raw in ("<text>", "<bold>", "<all>", "<demo>"):
        assert raw not in page
    for section in sections:
        assert f'<a href="#{section.id}">{section.title}</a>' in page
        assert f'<section id="{section.id}">' in page
    if name == "table":
        assert 'aria-label="met">✓' in page and 'aria-label="not met">✗' in page


def test_drawings_with_the_same_content_have_different_ids():
    svgs = []
    for title in ("one", "two"):
        with Drawing() as (drawing, ax):
            ax.plot([0, 1], [0, 1], "o")
        svgs.append(drawing.panel(title, "a line").svg)
    one, two = (set(re.findall(r' id="([^"]+)"', svg)) for svg in svgs)
    assert one and not one & two
    assert svgs[0].startswith("<svg") and "http" not in svgs[0]
