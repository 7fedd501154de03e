"""Budget of a test file: those that exceed it are printed at the end of a run.

A test that cannot be fast is marked `slow`: `make test` leaves it out, `make test-all` runs it.
"""

from __future__ import annotations

from collections import Counter

FILE_BUDGET_S = 12.0
"""Seconds of a file without its slow tests, on one process of an idle machine."""
MOST_PRINTED = 10


def pytest_terminal_summary(terminalreporter):
    seconds = Counter()
    for reports in terminalreporter.stats.values():
        for report in reports:
            seconds[getattr(report, "nodeid", "").split("::")[0]] += getattr(report, "duration", 0)
    over = [(f, s) for f, s in seconds.most_common(MOST_PRINTED) if f and s > FILE_BUDGET_S]
    if over:
        terminalreporter.section(f"files beyond {FILE_BUDGET_S:.0f} s: speed up, or mark slow")
        for file, taken_s in over:
            terminalreporter.write_line(f"{taken_s:6.1f} s  {file}")
