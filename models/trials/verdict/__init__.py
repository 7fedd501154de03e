"""Verdict on an import: what was checked, what is wrong and why, with a picture."""
