"""Pages that tell of the effects: they are those of the catalogue."""

import re
from pathlib import Path

from models.plant.effects_page import effects_page, main
from models.shared.catalogue import BEYOND_THE_RIG, CATALOGUE, EVERY_EFFECT

ROOT = Path(__file__).parents[3]
PAGE = ROOT / "docs" / "gap" / "effects.md"


def test_the_page_is_that_of_the_catalogue(tmp_path):
    main([str(tmp_path / "effects.md")])
    assert (tmp_path / "effects.md").read_text(encoding="utf-8") == PAGE.read_text(encoding="utf-8")


def test_every_effect_has_a_row_with_meaning_size_and_equation():
    rows = [line.split(" | ") for line in effects_page().splitlines() if line.startswith("| `")]
    assert len(rows) == len(EVERY_EFFECT)
    assert all(len(row) == 5 and row[1].strip() and row[3].strip() for row in rows)
    assert sum(not row[2].strip() for row in rows) == len(BEYOND_THE_RIG)


def test_the_number_of_effects_is_stated_rightly():
    stated = {}
    for page in ("README.md", "docs/decisions.md"):
        text = (ROOT / page).read_text(encoding="utf-8")
        stated[page] = re.findall(r"(?:lacks\*\*, out of|which of|names the) (\d+)\b", text)
    assert set(stated["README.md"] + stated["docs/decisions.md"]) == {str(len(CATALOGUE))}
    assert len(stated["README.md"]) == 2 and stated["docs/decisions.md"]
