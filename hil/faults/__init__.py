"""Faults of line, servo, host and process: injected by name and seed, checked against a table."""
