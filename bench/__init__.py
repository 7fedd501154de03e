"""Benchmarks against peers and limits, and the claims of the documentation."""
