"""Slice of the gap benchmark: effects hidden in the rig are named with a plant of that rig."""

import json

import pytest

from bench.gap.benchmark_run import run_benchmark
from bench.gap.cases import draw_cases
from bench.gap.scores.score_summary import benchmark_figures
from hil.campaign.case_worker import run_task

SINGLES, NULLS = 1, 1


class OwnProcess:
    """Engine that runs cases in this process."""

    shared = False

    def outcomes(self, tasks):
        yield from map(run_task, tasks)


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Directory of results: an effect, and a data set without any, with a plant of that rig.

    They run in this process: the tests take both cores already.
    """
    out = tmp_path_factory.mktemp("slice") / "out"
    drawn = list(draw_cases(1, NULLS, 0, 0, seed=0))
    run_benchmark(drawn[:SINGLES], None, out, OwnProcess())
    run_benchmark(drawn[-NULLS:], None, out, OwnProcess(), sealed=False)
    return out


def test_what_is_hidden_is_found_and_nothing_else(results):
    figures = benchmark_figures(results)
    assert figures["detected"]["fraction"] == 1.0
    assert figures["class_of_named"]["fraction"] == 1.0
    assert figures["nothing_beside"]["fraction"] == 1.0
    assert figures["false_alarms"]["fraction"] == 0.0
    # Most of it: this is one case, of friction whose level and speed make up for each other.
    assert figures["fraction_of_gap_removed"]["median"] > 0.5


def test_each_case_leaves_a_file_of_its_own_and_is_not_run_again(results):
    files = sorted((results / "results").rglob("*.json"))
    assert len(files) == SINGLES + NULLS
    before = {f: f.stat().st_mtime_ns for f in files}
    drawn = list(draw_cases(1, NULLS, 0, 0, seed=0))
    assert run_benchmark(drawn[:SINGLES], None, results).kept == SINGLES
    assert {f: f.stat().st_mtime_ns for f in files} == before
    kinds = [json.loads(f.read_text())["config"]["case"]["kind"] for f in files]
    assert sorted(kinds) == ["null", "single"]
