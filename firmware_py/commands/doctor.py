"""Say what on this PC would spoil the loop's timing, and how to mend it."""

from __future__ import annotations

import argparse

from firmware_py.console import DONE, NEGATIVE, emit
from firmware_py.machine import Verdict, examine

EXAMPLE = "dropstitch doctor"

_MARKS = {Verdict.GOOD: "  ", Verdict.NOTE: "? ", Verdict.SPOILS: "! "}


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments: none."""


def run(args: argparse.Namespace) -> int:
    """Examine the machine; the verdict is negative where something would spoil the timing."""
    findings = examine()
    good = all(finding.verdict is not Verdict.SPOILS for finding in findings)
    lines = []
    for finding in findings:
        lines.append(f"{_MARKS[finding.verdict]}{finding.name}: {finding.found}")
        if finding.remedy:
            lines.append(f"      {finding.remedy}")
    lines.append("nothing here spoils the timing" if good else "mend what is marked with !")
    rows = [finding._asdict() | {"verdict": finding.verdict.value} for finding in findings]
    emit(args, {"good": good, "findings": rows}, "\n".join(lines))
    return DONE if good else NEGATIVE
