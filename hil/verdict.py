"""Verdict of a run or a campaign, its exit code, and JUnit XML of several verdicts."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import Any, NamedTuple

from firmware_py.core.console import DONE, INCONCLUSIVE, NEGATIVE


class Verdict(StrEnum):
    """Result of a check; inconclusive if something other than the checked code disturbed it."""

    PASS = "pass"
    FAIL = "fail"
    INCONCLUSIVE = "inconclusive"

    @property
    def exit_code(self) -> int:
        """Exit code of a command with this verdict: 0, 1 or 3."""
        return _EXIT_CODES[self]


_EXIT_CODES = {Verdict.PASS: DONE, Verdict.FAIL: NEGATIVE, Verdict.INCONCLUSIVE: INCONCLUSIVE}
_ELEMENTS = {Verdict.FAIL: "failure", Verdict.INCONCLUSIVE: "skipped"}


class JUnitCase(NamedTuple):
    """One test case of a JUnit suite."""

    name: str
    verdict: Verdict  # `FAIL` becomes a failure, `INCONCLUSIVE` a skipped test
    message: str = ""  # One line that explains a verdict other than `PASS`
    text: str = ""  # The full explanation


def junit_xml(
    suite: str, cases: Sequence[JUnitCase], properties: Mapping[str, Any] | None = None
) -> bytes:
    verdicts = [case.verdict for case in cases]
    root = ET.Element(
        "testsuite", name=f"dropstitch.{suite}", tests=str(len(cases)),
        failures=str(verdicts.count(Verdict.FAIL)),
        skipped=str(verdicts.count(Verdict.INCONCLUSIVE)),
    )  # fmt: skip
    if properties is not None:
        element = ET.SubElement(root, "properties")
        for name, value in properties.items():
            ET.SubElement(element, "property", name=name, value=str(value))
    for case in cases:
        element = ET.SubElement(root, "testcase", classname=suite, name=case.name)
        if kind := _ELEMENTS.get(case.verdict):
            ET.SubElement(element, kind, message=case.message).text = case.text
    ET.indent(root)
    document: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    return document
