"""Scores of the benchmark's results: figures, tables and pictures."""
