"""The command `dropstitch bench`: a tick's own cost against servos in memory."""

import json

import pytest

from dropstitch.__main__ import main


def call(capsys, *arguments):
    code = main([str(a) for a in arguments])
    return code, capsys.readouterr()


def test_bench_measures_every_stage_and_judges_its_own_cost(toy_bundle, capsys):
    code, output = call(capsys, "bench", "--bundle", toy_bundle, "--seconds", "0.2", "--json")
    result = json.loads(output.out)
    assert code == (0 if result["good"] else 1)
    stages = result["timing"]["stages"]
    assert result["good"] is (stages["own"]["p99_ns"] <= result["limit_own_p99_ns"])
    assert {stage["n"] for stage in stages.values()} == {result["ticks"]}


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--seconds", "-5"], "--seconds: is -5 s; give"),
        (["--seconds", "nan"], "--seconds: is nan s; give"),
        (["--dof", "2"], "has 1; leave --dof out"),
    ],
)
def test_bench_refuses_what_it_would_not_measure(toy_bundle, capsys, options, sentence):
    code, output = call(capsys, "bench", "--bundle", toy_bundle, *options)
    assert (code, sentence in output.err) == (2, True), output.err
