"""Commands of the gap workflow: calibrate, gap, experiment."""
