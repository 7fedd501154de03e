"""The page of figures: a part that fails costs the others nothing, and nothing is half written."""

import json

import pytest

from bench import figures
from bench.figures import Figure, Part, main

README = "# Title\n\n<!-- figures -->\nold\n<!-- /figures -->\n\nMore.\n"


@pytest.fixture
def pages(tmp_path, monkeypatch):
    """A checkout with one part that measures and one that fails."""
    figure = Figure("sum", "one and one", 2.0, "2", "n = 1", "this machine", "echo 2")

    def broken(out):
        raise ValueError("no data\nat all")

    monkeypatch.setattr(
        figures, "PARTS", {"adds": Part("Sums", lambda out: [figure]), "fails": Part("Not", broken)}
    )
    monkeypatch.setattr(figures, "READING", ("fails", "adds"))
    monkeypatch.setattr(figures, "README_FIGURES", ("sum",))
    for name, path in (("PAGE", "figures.md"), ("DOCUMENT", "figures.json"),
                       ("README", "README.md"), ("OUT", "out")):  # fmt: skip
        monkeypatch.setattr(figures, name, tmp_path / path)
    (tmp_path / "README.md").write_text(README)
    return tmp_path


def test_a_part_that_fails_says_so_and_the_others_are_written(pages, capsys):
    assert main([]) == 1
    page = (pages / "figures.md").read_text()
    assert "| one and one | 2 | n = 1 | this machine | `echo 2` |" in page
    assert "Not measured: ValueError: no data (`make figures ONLY=fails`)." in page
    document = json.loads((pages / "figures.json").read_text())
    assert [part["part"] for part in document["parts"]] == ["fails", "adds"]
    assert document["measured_by"]["commit"] in page
    readme = (pages / "README.md").read_text()
    assert "| one and one | 2 (n = 1) |" in readme and "old" not in readme
    assert readme.startswith("# Title\n") and readme.endswith("More.\n")
    capsys.readouterr()
    assert main(["--readme"]) == 0
    assert capsys.readouterr().out in readme


def test_readme_states_the_measured_figures():
    document = json.loads(figures.DOCUMENT.read_text(encoding="utf-8"))
    assert figures.readme_block(document) in figures.README.read_text(encoding="utf-8")


def test_a_part_by_name_is_printed_and_nothing_is_written(pages, capsys):
    assert main(["--only", "adds"]) == 0
    assert "2" in capsys.readouterr().out
    assert not (pages / "figures.md").exists() and (pages / "README.md").read_text() == README


def test_files_of_an_earlier_commit_are_refused(pages, monkeypatch, capsys):
    needs = Part("Sums", lambda out: [], ("README.md",))
    monkeypatch.setitem(figures.PARTS, "adds", needs)
    monkeypatch.setattr(figures, "ROOT", figures.ROOT)
    monkeypatch.setattr(figures, "_git", lambda *arguments: str(2**40))
    assert main([]) == 2
    assert "README.md: is older than the commit" in capsys.readouterr().err
