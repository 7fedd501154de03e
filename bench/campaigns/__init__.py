"""Benchmark of campaigns: overhead of a case, engines side by side, a worker that is killed."""
