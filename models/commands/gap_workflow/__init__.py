"""Commands of the gap workflow: gap, experiment."""
