"""Faults of line, servo, host and process: injected by name and seed, judged against a table."""
