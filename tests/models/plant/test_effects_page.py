"""Page of the effects: the one that the catalogue gives."""

from pathlib import Path

from models.plant.effects_page import main

ROOT = Path(__file__).parents[3]
PAGE = ROOT / "docs" / "gap" / "effects.md"


def test_the_page_is_that_of_the_catalogue(tmp_path):
    main([str(tmp_path / "effects.md")])
    assert (tmp_path / "effects.md").read_text(encoding="utf-8") == PAGE.read_text(encoding="utf-8")
