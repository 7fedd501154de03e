"""What the head of a report says of its trials, for every origin that they can have."""

from dataclasses import replace

import msgspec
import pytest

from hil.report.build_inputs import read_build
from hil.report.report_origins import origin_table, report_notices, study_badges
from models.trials.origin import TrialOrigin

RIG, MEASURED = TrialOrigin("rig", "default", 4), TrialOrigin("measured", trials=2)
UNSTATED = TrialOrigin("")


@pytest.fixture(scope="module")
def inputs(build):
    return read_build(build)


def of_origins(inputs, of_study, of_evaluation):
    """The same build with trials of these origins."""
    study = inputs.studies[1]
    part = msgspec.structs.replace(study.training, origins=of_study)
    study = msgspec.structs.replace(study, training=part, tests={"trial_2": part})
    (title, evaluation), *_ = inputs.evaluations.items()
    evaluation = msgspec.structs.replace(evaluation, origins=of_evaluation)
    return replace(
        inputs, studies={1: study}, motions={"1DOF": study}, plant=None,
        evaluations={title: evaluation},
    )  # fmt: skip


@pytest.mark.parametrize(
    ("of_study", "of_evaluation", "label"),
    [
        ((RIG,), (RIG,), "Simulated"),
        ((MEASURED,), (MEASURED,), "Measured"),
        ((RIG,), (MEASURED,), "Simulated and measured"),
        ((UNSTATED,), (UNSTATED,), "Origin not stated"),
        ((RIG,), (UNSTATED,), "Origin not stated"),
    ],
)
def test_the_head_says_where_the_trials_come_from(inputs, of_study, of_evaluation, label):
    changed = of_origins(inputs, of_study, of_evaluation)
    trials, loops = report_notices(changed)
    assert trials.label == label
    assert loops.label == "Emulated"  # the loop never ran on a robot, whatever the trials are
    rows = {row[0].text: row[1].text for row in origin_table(changed).cells}
    assert rows["Control loop, sil_1dof"] == "Simulated"
    kinds = {RIG: "simulated", MEASURED: "measured", UNSTATED: "origin not stated"}
    study = kinds[of_study[0]]
    assert study_badges(changed.every_study) == {"1DOF": f"1DOF, {study}"}
    assert rows["Study, 1DOF"].lower() == study


def test_a_build_without_trials_claims_nothing_of_them(inputs):
    empty = replace(inputs, studies={}, motions={}, plant=None, evaluations={})
    assert [n.label for n in report_notices(empty)] == ["Emulated"]
    assert report_notices(replace(empty, loops=[])) == []
    assert origin_table(replace(empty, loops=[])) is None


def test_the_run_says_what_moved_its_servos(inputs):
    (row,) = [r for r in origin_table(inputs).cells if r[0].text.startswith("Control loop")]
    assert row[2].text == "emulated servos, the twin behind them"
