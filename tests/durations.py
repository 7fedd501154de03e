"""Slow tests: their list (tests/slow.txt), its marker, and its measurement.

A test is slow if it needs more than `SLOW_S` of processor time, child processes included, or asks
for a fixture that needs more than `SLOW_FIXTURE_S`. `make test-fast` leaves slow tests out;
`make test-durations` measures all tests in one process and writes the list. A line is the name of a
test function in whatever file, or `fixture:NAME`. Tests that are not listed count as quick.
"""

from __future__ import annotations

import resource
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
LIST = ROOT / "tests" / "slow.txt"
SLOW_S = 0.5
SLOW_FIXTURE_S = 2.0
"""A fixture is shared, so it may cost more than a test."""


def processor_s():
    """Processor time of this process and its children, s."""
    usages = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(u.ru_utime + u.ru_stime for u in usages)


def listed():
    """Lines of the list."""
    return set(LIST.read_text(encoding="utf-8").split()) if LIST.exists() else set()


def name_of(item):
    """Name of a test function, without parameters."""
    return getattr(item, "originalname", None) or item.name.split("[")[0]


class Recorder:
    """Processor time of every test and fixture, without the fixtures that it asks for."""

    def __init__(self):
        self.tests, self.fixtures, self.inner = Counter(), Counter(), [0.0]

    @pytest.hookimpl(hookwrapper=True)
    def pytest_fixture_setup(self, fixturedef):
        start_s = processor_s()
        self.inner.append(0.0)
        yield
        taken_s = processor_s() - start_s
        name = fixturedef.argname
        self.fixtures[name] = max(self.fixtures[name], taken_s - self.inner.pop())
        self.inner[-1] += taken_s

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_call(self, item):
        start_s = processor_s()
        yield
        name = name_of(item)
        self.tests[name] = max(self.tests[name], processor_s() - start_s)

    def pytest_sessionfinish(self, exitstatus):
        if exitstatus == 0:
            LIST.write_text("\n".join(slow_names(self.tests, self.fixtures)) + "\n")


def slow_names(tests, fixtures):
    """Lines of the list, from processor times by name."""
    return sorted(
        [name for name, taken_s in tests.items() if taken_s > SLOW_S]
        + [f"fixture:{name}" for name, taken_s in fixtures.items() if taken_s > SLOW_FIXTURE_S]
    )


def pytest_addoption(parser):
    parser.addoption("--record-slow", action="store_true", help="write tests/slow.txt")


def pytest_configure(config):
    if config.getoption("--record-slow"):
        config.pluginmanager.register(Recorder())


def pytest_collection_modifyitems(items):
    slow = listed()
    for item in items:
        names = {name_of(item), *(f"fixture:{name}" for name in getattr(item, "fixturenames", ()))}
        if names & slow:
            item.add_marker("slow")
