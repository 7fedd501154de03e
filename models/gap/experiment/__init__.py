"""The next experiment: a motion that separates the hypotheses of a diagnosis."""
