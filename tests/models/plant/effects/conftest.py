"""Compiler options of the tests of effects: many models, each run for a few seconds."""

import pytest

from models.shared.c_compiler import OPTIONS_VARIABLE


@pytest.fixture(autouse=True)
def unoptimised_code(monkeypatch):
    """Compile without optimisation: the same bits, in less time where a model runs briefly."""
    monkeypatch.setenv(OPTIONS_VARIABLE, "-O0")
