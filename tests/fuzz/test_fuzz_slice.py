"""A seeded slice of the fuzzer, and every input that once broke a reader.

`make fuzz` runs more of it. The readers of a bundle need a trained one and run there only.
"""

import pytest

from tests.fuzz.campaign_of_inputs import fuzz, kept, verdicts_on
from tests.fuzz.fork_cases import run_cases
from tests.fuzz.fuzz_readers import every_reader

INPUTS = 8


@pytest.fixture(scope="module")
def readers():
    return {reader.name: reader for reader in every_reader()}


@pytest.mark.slow
def test_every_reader_uses_or_refuses_a_slice_of_inputs(readers, tmp_path):
    failures = {}
    for name, reader in readers.items():
        if not reader.fed:
            continue
        tally = fuzz(reader, tmp_path, 60.0, INPUTS)
        failures |= {(name, seed): verdict for seed, verdict in tally.failures}
        assert tally.counts.total() == INPUTS
    assert not failures


def test_inputs_that_once_broke_a_reader_no_longer_do(readers, tmp_path):
    for reader, name, changed in kept(readers.values()):
        verdict = verdicts_on(reader, [lambda changed=changed: changed], tmp_path)[0]
        assert not verdict.failed, (reader.name, name, verdict)


def test_the_fuzzer_sees_what_is_wrong(tmp_path):
    import ctypes

    from firmware_py.core.errors import InputError

    def two_lines():
        error = InputError("a", "b", "c")
        error.args = ("a: b\nc.",)
        raise error

    works = [lambda: None, two_lines, lambda: 1 / 0, lambda: bytearray(10**9),
             lambda: ctypes.string_at(0), lambda: None]  # fmt: skip
    kinds = [verdict.kind for verdict in run_cases(works, tmp_path)]
    assert kinds == ["used", "sentence", "traceback", "memory", "crash", "used"]
