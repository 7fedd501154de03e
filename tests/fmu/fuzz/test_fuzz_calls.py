"""Slice of the fuzzer, which `make fuzz-fmu` runs for ten minutes; instances in threads."""

import shutil
import subprocess

import pytest

from tests.fmu.fuzz.__main__ import build_fuzzer, fuzz


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("gcc"), reason="no gcc")
@pytest.mark.parametrize("fmi", [2, 3])
def test_no_sequence_of_calls_breaks_the_fmu(toy, tmp_path, fmi):
    result = fuzz(build_fuzzer(toy, fmi, tmp_path), seed=fmi, seconds=60, calls=200_000)
    assert not result.objection
    assert result.calls >= 200_000
    assert result.accepted > result.calls / 5  # else it would test refusals only


@pytest.mark.skipif(not (shutil.which("gcc") and shutil.which("setarch")), reason="no gcc")
def test_instances_in_threads_share_nothing(toy, tmp_path):
    """No data race in ThreadSanitizer, and each run has the bits that it has alone."""
    race = ("-fsanitize=thread", "-pthread", "-O0")
    program = build_fuzzer(toy, 3, tmp_path, "thread_calls.c", race)
    # the sanitizer needs its memory where it expects it: without random addresses
    done = subprocess.run(
        ["setarch", "-R", str(program), "8", "10"], capture_output=True, text=True, check=False
    )
    assert (done.stdout, done.returncode) == ("80\n", 0), done.stderr[-2000:]
