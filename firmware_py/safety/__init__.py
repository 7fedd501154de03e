"""Safety: supervisor, its states and limits, and the blending of goals."""
