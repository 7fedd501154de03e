"""Results of a diagnosis: gap.json, its page and the waterfall of improvements."""
