"""The five figures of README are those of docs/figures.json."""

import json

from bench.figures import DOCUMENT, README, README_FIGURES, readme_block


def test_readme_states_the_measured_figures():
    document = json.loads(DOCUMENT.read_text(encoding="utf-8"))
    block = readme_block(document)
    assert len(block.splitlines()) == 2 + len(README_FIGURES)
    assert block in README.read_text(encoding="utf-8")
