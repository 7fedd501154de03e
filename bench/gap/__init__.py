"""Benchmark of the gap workflow: how often it names an effect that is hidden in the rig."""
