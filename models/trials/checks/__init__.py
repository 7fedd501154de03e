"""Checks of trials and imports: what can be wrong, how it is found, and what to do."""
