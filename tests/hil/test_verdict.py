"""Verdicts: one exit code each, and JUnit XML that says the same."""

from __future__ import annotations

from xml.etree import ElementTree as ET

import pytest

from hil.verdict import JUnitCase, Verdict, junit_xml


@pytest.mark.parametrize(("verdict", "code"), [("pass", 0), ("fail", 1), ("inconclusive", 3)])
def test_each_verdict_has_the_exit_code_of_the_commands(verdict, code):
    assert Verdict(verdict).exit_code == code


def test_junit_counts_failures_and_skips_and_gives_their_reasons():
    cases = [JUnitCase(f"case {verdict}", verdict, "why", "details") for verdict in Verdict]
    suite = ET.fromstring(junit_xml("trial", cases, {"line": "pty"}))
    assert (suite.get("name"), suite.get("tests")) == ("dropstitch.trial", "3")
    assert (suite.get("failures"), suite.get("skipped")) == ("1", "1")
    failed, skipped = suite.find("testcase/failure"), suite.find("testcase/skipped")
    assert (failed.get("message"), failed.text, skipped.text) == ("why", "details", "details")
    assert suite.find("properties/property[@name='line']").get("value") == "pty"
