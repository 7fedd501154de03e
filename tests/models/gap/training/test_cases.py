"""Data sets with hidden effects: their draw, and the trials that they run."""

from types import SimpleNamespace

import numpy as np
import pytest

from firmware_py.core.errors import InputError
from models.gap.training import case_runs, cases
from models.gap.training.case_runs import hidden_trials, records_of, rig_of, run_cases
from models.gap.training.cases import (
    MOTIONS,
    PAYLOAD_SETS,
    HiddenCase,
    hidden_cases,
    motion_named,
    tuning_cases,
)
from models.rig.drawn import rig_named
from models.shared.catalogue import CATALOGUE, Row

COUNTS = {"usual": 12, "faint": 10, "nulls": 2, "pairs": 2, "outside": 3}


def test_faint_effects_are_fainter_than_usual_ones_and_each_is_another_one():
    drawn = list(hidden_cases("drawn_1", **COUNTS, seed=3, same_link=False))
    singles = [c for c in drawn if c.kind == "single"]
    names = [e for c in singles for e in c.hidden]
    sizes = [abs(v) / CATALOGUE[e].size for c in singles for e, v in c.hidden.items()]
    assert len(names) == len(set(names)) == 22 and len(drawn) == sum(COUNTS.values())
    assert all(0.5 <= s <= 2.0 for s in sizes[:12]) and all(s <= 1.05 for s in sizes[12:])
    assert min(sizes[12:]) < 0.5
    assert "cross_axis_coupling" not in names
    with_two = hidden_cases("drawn_1", 32, 0, 0, 0, 0, seed=3, same_link=True, joints=2)
    assert {e for c in with_two for e in c.hidden} == set(CATALOGUE)


@pytest.mark.slow
def test_strengths_are_negative_where_the_rig_allows_it():
    drawn = [c for k in range(30) for c in hidden_cases(f"drawn_{k}", 31, 0, 0, 0, 0, 1, True)]
    negative = {e for c in drawn for e, v in c.hidden.items() if v < 0}
    assert {"prebend", "sync_offset", "position_gain_change"} <= negative
    assert not negative & {"creep", "backlash", "unmodelled_payload", "coulomb_friction"}
    for case in drawn:
        rig_named(case.rig).hide(case.hidden)


def test_an_effect_that_is_added_leaves_the_other_cases_as_they_are(monkeypatch):
    def draw():
        return list(hidden_cases("drawn_7", 6, 0, 2, 0, 0, seed=3, same_link=False))

    before = draw()
    fewer = {name: row for name, row in CATALOGUE.items() if name not in before[0].hidden}
    monkeypatch.setattr(cases, "CATALOGUE", fewer)
    after = draw()
    assert after[:5] == before[1:6] and after[6:] == before[6:]
    monkeypatch.setattr(cases, "CATALOGUE", {"no_size": Row("mass", "kg", "of no known size")})
    assert not any(case.hidden for case in draw())


def test_the_link_of_a_case_is_another_one_unless_it_is_the_same():
    nominal = rig_named("default")
    for same_link in (False, True):
        (case,) = hidden_cases("default", 1, 0, 0, 0, 0, seed=3, same_link=same_link)
        assert any(rig_of(case)[n] != nominal[n] for n in case.nuisance) is not same_link
        assert rig_of(case)["sensor.frame_tilt_rad"] != 0.0


def test_cases_for_tuning_vary_link_joints_motion_and_payloads():
    drawn = [tuning_cases(number) for number in range(600, 640)]
    every = [case for of_rig in drawn for case in of_rig]
    assert {c.knowledge for c in every} == {"identified", "other motions", "other payloads"}
    assert {c.motion for c in every} == set(MOTIONS)
    assert all(c.kind == "null" for c in every if c.knowledge != "identified")
    assert sum(of_rig[0].joints == 2 for of_rig in drawn) == 10
    for joints in (1, 2):
        links = [bool(of_rig[0].nuisance) for of_rig in drawn if of_rig[0].joints == joints]
        assert sum(links) == len(links) / 2


@pytest.mark.parametrize("number", [21, 900])
def test_a_rig_for_tests_or_for_patterns_is_refused(number):
    with pytest.raises(InputError, match=f"drawn_{number}"):
        tuning_cases(number)


def test_trials_have_the_motion_and_payloads_of_the_case(monkeypatch):
    ran = []

    def stand_still(rig, conditions):  # a link that moves would take minutes
        ran.append(conditions)
        still = np.zeros((2, conditions.motion.dof))
        return SimpleNamespace(name="still", angle_rad=still, goal_rad=still)

    monkeypatch.setattr(case_runs, "run_case", stand_still)
    case = HiddenCase("null", {}, {}, 1, "default", 2, motion="triangle", payloads="between")
    hidden_trials(rig_of(case), case)
    assert {c.motion for c in ran} == {motion_named("triangle", 2)}
    assert [(c.payload_kg, c.trial) for c in ran] == [
        (payload_kg, trial) for payload_kg in PAYLOAD_SETS["between"] for trial in (1, 2)
    ]


@pytest.mark.slow
def test_a_case_with_a_record_is_not_run_again_and_a_failure_is_reported(tmp_path):
    done, fails = (HiddenCase("null", {}, {}, seed, "drawn_1") for seed in (1, 2))
    (tmp_path / "plants").mkdir()
    (tmp_path / "plants" / "drawn_1.json").write_text("damaged")
    path = case_runs.record_path(tmp_path, done)
    path.parent.mkdir()
    path.write_bytes(case_runs.msgspec.json.encode(case_runs.DataSetRecord(case=done)))
    assert run_cases([done, fails], tmp_path) == 1
    (trace,) = (tmp_path / "failures").glob("*.txt")
    assert "drawn_1.json" in trace.read_text()
    assert records_of([done, fails], tmp_path) == [case_runs.DataSetRecord(case=done)]
