"""Checks of trials and imports: what can be wrong, what shows it, and what to do."""
