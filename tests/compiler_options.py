"""Compiler options of rooms whose models run briefly: compiling costs them more than running.

Code without optimisation gives the same bits in four times the time and compiles in a third of it.
The toy FMUs, `models/plant/simulation` and every room that is not listed are compiled as shipped.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from models.shared.c_compiler import OPTIONS_VARIABLE

TESTS = Path(__file__).parent
BRIEF = (
    "firmware_py", "fmu", "hil", "house", "models/plant/components", "models/plant/composition",
    "models/plant/effects",
)  # fmt: skip


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_protocol(item):
    with pytest.MonkeyPatch.context() as patch:
        if any(item.path.is_relative_to(TESTS / room) for room in BRIEF):
            patch.setenv(OPTIONS_VARIABLE, "-O0")
        yield
