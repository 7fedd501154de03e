"""Site of the guides: built from docs/ with every warning an error, a page outside the menu too.

The notebooks are run by test_notebooks.py, in one process, and by `make docs`; here they are
only drawn.
"""

import re

import pytest
from sphinx.cmd.build import main as sphinx_build

from tests.house.sources import ROOT

pytestmark = pytest.mark.slow

DOCS = ROOT / "docs"


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    out = tmp_path_factory.mktemp("site")
    options = ["-b", "html", "-c", str(DOCS / "site"), "-W", "--keep-going", "-q"]
    options += ["-D", "nb_execution_mode=off", "-d", str(out / "trees")]
    assert sphinx_build([*options, str(DOCS), str(out / "html")]) == 0
    return out / "html"


def test_the_first_page_leads_to_the_guides(site):
    target = re.search(r"url=([\w/.]+)", (site / "index.html").read_text(encoding="utf-8"))[1]
    assert (site / target).is_file()
