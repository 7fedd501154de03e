"""Plans for the tip: paths, the twin inverted for its goals, limits, the plan document."""
