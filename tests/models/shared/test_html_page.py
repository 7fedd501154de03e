from html.parser import HTMLParser

import pytest
from markupsafe import Markup

from models.shared.pages import (
    ClaimCard,
    ClaimCards,
    CommandList,
    Facts,
    Figure,
    LegendEntry,
    Panel,
    Paragraph,
    Section,
    Table,
    TableCell,
    missing_inputs,
    render_page,
)

VOID = {"meta", "link", "br"}
PANEL = Panel("x over t", "a rising line", '<svg viewBox="0 0 1 1"></svg>')
PARTS = {
    "paragraph": Paragraph("plain <text>", "note"),
    "markup": Paragraph(Markup("<b>{}</b>").format("<bold>")),
    "table": Table("sizes", ["name", "value"], [["a", TableCell("1", True)], ["b", "2"]], "in mm"),
    "figure": Figure("A figure", "a note", [PANEL], "7", [LegendEntry("red", "line", "dashed")]),
    "facts": Facts([("python", "3")]),
    "commands": CommandList(["make <all>"], folded=True),
    "claims": ClaimCards([ClaimCard("it holds", [(["1DOF"], None, "unknown")], ["the motion"])]),
    "missing": missing_inputs("make <demo>"),
}


class Balance(HTMLParser):
    """Tags that are open, and all text."""

    def __init__(self, page):
        super().__init__()
        self.open, self.text = [], ""
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        """A tag that closes itself leaves nothing open."""

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


@pytest.mark.parametrize("name", PARTS)
def test_every_part_is_sound_html_and_escapes_its_text(name):
    page = render_page("A <title>", [Paragraph("lead")], [Section("one", "One", [PARTS[name]])])
    balance = Balance(page)
    assert balance.open == []
    assert "<title>dropstitch: A &lt;title&gt;</title>" in page
    for raw in ("<text>", "<bold>", "<all>", "<demo>"):
        assert raw not in page


def test_sections_are_listed_and_linked():
    sections = [Section("one", "First", []), Section("two", "Second", [])]
    page = render_page("T", [], sections)
    for section in sections:
        assert f'<a href="#{section.id}">{section.title}</a>' in page
        assert f'<section id="{section.id}">' in page


def test_a_judged_cell_is_marked_for_eyes_and_readers():
    table = Table("", ["", "value"], [["a", TableCell("1", True)], ["b", TableCell("2", False)]])
    page = render_page("T", [], [Section("one", "One", [table])])
    assert 'aria-label="met">✓' in page and 'aria-label="not met">✗' in page
