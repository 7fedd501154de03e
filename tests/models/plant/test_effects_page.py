"""Page of the effects: it is that of the catalogue."""

from pathlib import Path

from models.plant.effects_page import effects_page, main
from models.shared.catalogue import BEYOND_THE_RIG, EVERY_EFFECT

PAGE = Path(__file__).parents[3] / "docs" / "gap" / "effects.md"


def test_the_page_is_that_of_the_catalogue(tmp_path):
    main([str(tmp_path / "effects.md")])
    assert (tmp_path / "effects.md").read_text(encoding="utf-8") == PAGE.read_text(encoding="utf-8")


def test_every_effect_has_a_row_with_meaning_size_and_equation():
    rows = [line.split(" | ") for line in effects_page().splitlines() if line.startswith("| `")]
    assert len(rows) == len(EVERY_EFFECT)
    assert all(len(row) == 5 and row[1].strip() and row[3].strip() for row in rows)
    assert sum(not row[2].strip() for row in rows) == len(BEYOND_THE_RIG)
