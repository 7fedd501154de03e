"""Slow tests: their list (tests/slow.txt), its marker, and its measurement.

A test is slow if it or one of its own fixtures needs more than `SLOW_S` of processor time, child
processes included. Fixtures of a whole session count for all tests that use them. `make test-fast`
leaves slow tests out; `make test-durations` measures all tests in one process and writes the list.
A line names a function, whatever its parameters. Tests that are not listed count as quick.
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
    """Names of slow tests, "FILE::FUNCTION"."""
    return set(LIST.read_text(encoding="utf-8").split()) if LIST.exists() else set()


def name_of(nodeid):
    """Name of a test without its parameters."""
    return nodeid.split("[")[0]


class Recorder:
    """Processor time of every test and fixture, without the fixtures that it asks for."""

    def __init__(self):
        self.tests, self.fixtures, self.users, self.inner = Counter(), Counter(), {}, [0.0]

    @pytest.hookimpl(hookwrapper=True)
    def pytest_fixture_setup(self, fixturedef, request):
        start_s = processor_s()
        self.inner.append(0.0)
        yield
        taken_s = processor_s() - start_s
        key = f"{fixturedef.baseid}::{fixturedef.argname}"
        self.fixtures[key] = max(self.fixtures[key], taken_s - self.inner.pop())
        self.inner[-1] += taken_s

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_call(self, item):
        start_s = processor_s()
        yield
        name = name_of(item.nodeid)
        self.tests[name] = max(self.tests[name], processor_s() - start_s)
        closure = item._fixtureinfo.name2fixturedefs.values()
        self.users.setdefault(name, set()).update(
            f"{d.baseid}::{d.argname}" for definitions in closure for d in definitions[-1:]
        )

    def pytest_sessionfinish(self, session, exitstatus):
        if exitstatus == 0:
            LIST.write_text("\n".join(slow_tests(self.tests, self.fixtures, self.users)) + "\n")


def slow_tests(tests, fixtures, users):
    """Names of slow tests, sorted."""
    return sorted(
        name for name, taken_s in tests.items()
        if taken_s > SLOW_S or any(fixtures[f] > SLOW_FIXTURE_S for f in users[name])
    )  # fmt: skip


def pytest_addoption(parser):
    parser.addoption("--record-slow", action="store_true", help="write tests/slow.txt")


def pytest_configure(config):
    if config.getoption("--record-slow"):
        config.pluginmanager.register(Recorder())


def pytest_collection_modifyitems(items):
    slow = listed()
    for item in items:
        if name_of(item.nodeid) in slow:
            item.add_marker("slow")
