"""Site of the guides: built from docs/ with every warning an error.

The notebooks are run by test_notebooks.py, in one process, and by `make docs`; here they are
only drawn.
"""

from __future__ import annotations

import re

import pytest
from sphinx.cmd.build import main as sphinx_build

from tests.house.each_file import ROOT

DOCS = ROOT / "docs"


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    out = tmp_path_factory.mktemp("site")
    options = ["-b", "html", "-c", str(DOCS / "site"), "-W", "--keep-going", "-q"]
    options += ["-D", "nb_execution_mode=off", "-d", str(out / "trees")]
    assert sphinx_build([*options, str(DOCS), str(out / "html")]) == 0
    return out / "html"


def test_every_page_and_notebook_is_in_the_menu(site):
    menu = (site / "guides" / "index.html").read_text(encoding="utf-8")
    for source in (*DOCS.rglob("*.md"), *DOCS.rglob("*.ipynb")):
        if source.name != "MODEL_CARD.md" and source.stem != "index":
            page = source.relative_to(DOCS).with_suffix(".html")
            assert (site / page).is_file(), page
            link = page.name if page.parent.name == "guides" else f"../{page}"
            assert f'href="{link}"' in menu, page


def test_the_first_page_leads_to_the_guides(site):
    target = re.search(r"url=([\w/.]+)", (site / "index.html").read_text(encoding="utf-8"))[1]
    assert (site / target).is_file()


def test_make_guides_builds_the_same_with_the_notebooks_run():
    recipe = (ROOT / "Makefile").read_text(encoding="utf-8").split("\nguides:")[1]
    assert "-m sphinx -b html -c docs/site -W" in recipe and "nb_execution" not in recipe
    assert 'nb_execution_mode = "force"' in (DOCS / "site" / "conf.py").read_text(encoding="utf-8")
