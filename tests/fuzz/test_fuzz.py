"""A seeded slice of the fuzzer, and every input that once broke a reader.

`make fuzz` runs more of it. The readers of a bundle need a trained one and run there only.
"""

import ctypes

import pytest

from firmware_py.core.errors import InputError
from tests.fuzz.cases import fuzz, regressions, run_cases, verdicts_on
from tests.fuzz.readers import every_reader

INPUTS = 8


@pytest.fixture(scope="module")
def readers():
    return list(every_reader())


@pytest.mark.slow
def test_every_reader_uses_or_refuses_a_slice_of_inputs(readers, tmp_path):
    failures = {}
    for reader in readers:
        if reader.fed:
            tally = fuzz(reader, tmp_path, 60.0, INPUTS)
            failures |= {(reader.name, seed): verdict for seed, verdict in tally.failures}
            assert tally.counts.total() == INPUTS
    assert not failures


def test_inputs_that_once_broke_a_reader_no_longer_do(readers, tmp_path):
    for reader, name, changed in regressions(readers):
        verdict = verdicts_on(reader, [lambda changed=changed: changed], tmp_path)[0]
        assert not verdict.failed, (reader.name, name, verdict)


def test_the_fuzzer_notices_every_failure(tmp_path):
    def two_lines():
        error = InputError("a", "b", "c")
        error.args = ("a: b\nc.",)
        raise error

    works = [lambda: None, two_lines, lambda: 1 / 0, lambda: bytearray(10**9),
             lambda: ctypes.string_at(0), lambda: None]  # fmt: skip
    kinds = [verdict.kind for verdict in run_cases(works, tmp_path)]
    assert kinds == ["used", "sentence", "traceback", "memory", "crash", "used"]
