"""Slice of the gap benchmark: effects hidden in the rig are named with a plant identified on it."""

import json
from pathlib import Path

import pytest

from bench.gap.__main__ import run_benchmark
from bench.gap.cases import draw_cases
from bench.gap.score_summary import benchmark_figures
from firmware_py.motion import Motion
from models.gap.estimation.noise_floor_fit import with_noise_floor
from models.plant.identification.identification import identify
from models.plant.plant import read_plant
from models.rig.rig_parameters import read_parameters
from models.rig.study_protocol import run_case
from models.rig.trial_case import TrialCase
from models.trials.trial_files import TrialSet

PAYLOADS_KG = (0.0, 1.0, 2.0)
SINGLES, NULLS = 2, 1


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Directory of results: two effects, and a data set without any."""
    directory = tmp_path_factory.mktemp("slice")
    rig = read_parameters()
    own = [run_case(rig, TrialCase(Motion(), p, n, 1)) for p in PAYLOADS_KG for n in (1, 2)]
    trials = TrialSet(tuple(own))
    plant = with_noise_floor(identify(read_plant(), trials).plant, trials.trials)
    plant.write(directory / "plant.json")
    drawn = list(draw_cases(1, NULLS, 0, 0, seed=0))
    run_benchmark(drawn[:SINGLES] + drawn[-NULLS:], directory / "plant.json", directory / "out")
    return directory / "out"


def test_what_is_hidden_is_found_and_nothing_else(results):
    figures = benchmark_figures(results)
    assert figures["detected"]["fraction"] == 1.0
    assert figures["class"]["fraction"] == 1.0
    assert figures["nothing_beside"]["fraction"] == 1.0
    assert figures["false_alarms"]["fraction"] == 0.0
    assert figures["fraction_of_gap_removed"]["median"] > 0.85


def test_each_case_leaves_a_file_of_its_own_and_is_not_run_again(results):
    files = sorted(results.glob("*.json"))
    assert len(files) == SINGLES + NULLS
    before = {f: f.stat().st_mtime_ns for f in files}
    drawn = list(draw_cases(1, NULLS, 0, 0, seed=0))
    run_benchmark(drawn[:SINGLES], Path("no such plant"), results)
    assert {f: f.stat().st_mtime_ns for f in files} == before
    kinds = [json.loads(f.read_text())["case"]["kind"] for f in files]
    assert sorted(kinds) == ["null", "single", "single"]
