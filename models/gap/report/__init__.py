"""Results of a diagnosis: the class, gap.json, its words, charts and page."""
