"""Compiler options of rooms whose models run briefly: compiling costs them more than running.

Code without optimisation gives the same bits in four times the time and compiles in a third of it.
Rooms that are not listed compile as shipped: in them models run for longer, or, like
`models/plant/simulation` and `tests/test_wheel.py`, they judge the shipped options.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from models.shared.c_compiler import OPTIONS_VARIABLE

TESTS = Path(__file__).parent
BRIEF = ("fmu", "hil/report", "house", "models/plant/effects")


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_protocol(item):
    with pytest.MonkeyPatch.context() as patch:
        if any(item.path.is_relative_to(TESTS / room) for room in BRIEF):
            patch.setenv(OPTIONS_VARIABLE, "-O0")
        yield
