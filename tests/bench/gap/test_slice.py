"""Slice of the gap benchmark: an effect hidden in the rig is named with a plant of that rig."""

import json

import pytest

from bench.gap import rig_plants
from bench.gap.benchmark_run import run_benchmark
from bench.gap.cases import PAYLOAD_SETS, draw_cases
from bench.gap.scores.score_summary import benchmark_figures
from hil.campaign.case_worker import run_task

FEW_KG = (0.0, 2.0)


class OwnProcess:
    """Engine that runs cases in this process."""

    shared = False

    def outcomes(self, tasks):
        yield from map(run_task, tasks)


def first_case():
    return [next(draw_cases(1, 0, 0, 0, seed=0))]


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Directory of the result of one effect, with a plant of that rig.

    It runs in this process: the tests take both cores already. That nothing is named where nothing
    is hidden: `tests/models/gap/test_two_joints.py`, on the rig too. Two payloads in place of
    three, for the tests' time.
    """
    out = tmp_path_factory.mktemp("slice") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rig_plants, "PAYLOADS_KG", FEW_KG)
        patch.setitem(PAYLOAD_SETS, "study", FEW_KG)
        run_benchmark(first_case(), None, out, OwnProcess())
    return out


def test_what_is_hidden_is_found_and_nothing_else(results):
    figures = benchmark_figures(results)
    assert figures["detected"]["fraction"] == 1.0
    assert figures["class_of_named"]["fraction"] == 1.0
    assert figures["nothing_beside"]["fraction"] == 1.0
    # Most of it: this is one case, of friction whose level and speed make up for each other.
    assert figures["fraction_of_gap_removed"]["median"] > 0.5


def test_each_case_leaves_a_file_of_its_own_and_is_not_run_again(results):
    files = sorted((results / "results").rglob("*.json"))
    before = {f: f.stat().st_mtime_ns for f in files}
    assert run_benchmark(first_case(), None, results).kept == 1
    assert {f: f.stat().st_mtime_ns for f in files} == before
    kinds = [json.loads(f.read_text())["config"]["case"]["kind"] for f in files]
    assert kinds == ["single"]
