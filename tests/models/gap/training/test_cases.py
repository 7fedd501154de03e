"""Data sets with hidden effects: draw, trials, plants of their rigs, results."""

from types import SimpleNamespace

import numpy as np
import pytest

from models.gap.training import case_run, case_runs
from models.gap.training.__main__ import COMMANDS, main
from models.gap.training.case_run import rig_of, study_trials
from models.gap.training.case_runs import case_results, run_cases
from models.gap.training.cases import MOTIONS, PAYLOAD_SETS, HiddenCase, drawn_case, motion_named
from models.gap.training.rig_plants import plant_of_rig, plants_of_rigs
from models.rig.drawn import rig_named


def test_the_link_of_a_case_is_another_one_unless_it_is_the_same():
    hidden, nominal = [("creep", 1.0)], rig_named("default")
    for same_link in (False, True):
        case = drawn_case(np.random.default_rng(3), "single", hidden, "default", same_link)
        changed = [n for n in case.nuisance if rig_of(case)[n] != nominal[n]]
        assert bool(changed) is not same_link
        assert rig_of(case)["sensor.frame_tilt_rad"] != 0.0


@pytest.fixture
def ran(monkeypatch):
    """Conditions of the trials that were run; no link moves, which would take minutes."""
    ran = []

    def stand_still(rig, conditions):
        ran.append(conditions)
        still = np.zeros((2, conditions.motion.dof))
        return SimpleNamespace(name="still", angle_rad=still, goal_rad=still)

    monkeypatch.setattr(case_run, "run_case", stand_still)
    return ran


@pytest.mark.parametrize("name", sorted(MOTIONS))
def test_trials_follow_the_motion_that_is_asked_for(name, ran):
    study_trials(rig_named("default"), 1, 2, name)
    assert {c.motion for c in ran} == {motion_named(name, 2)}
    assert sorted({(c.payload_kg, c.trial) for c in ran}) == [
        (payload_kg, trial) for payload_kg in PAYLOAD_SETS["study"] for trial in (1, 2)
    ]


def test_a_rig_has_a_plant_for_each_motion_and_number_of_joints(tmp_path):
    names = {
        (1, "study"): "drawn_3.json", (2, "study"): "drawn_3_2dof.json",
        (1, "slow"): "drawn_3_slow.json", (2, "slow"): "drawn_3_2dof_slow.json",
    }  # fmt: skip
    for name in names.values():
        (tmp_path / name).touch()
    assert {k: plant_of_rig("drawn_3", tmp_path, *k).name for k in names} == names
    robots = [("drawn_3", *own) for own in names]
    assert plants_of_rigs(robots, tmp_path) == {r: tmp_path / names[r[1:]] for r in robots}


def test_a_case_with_a_result_is_not_run_again(tmp_path, monkeypatch):
    case = HiddenCase("null", {}, {}, 1, "drawn_1")
    monkeypatch.setattr(case_runs, "plants_of_rigs", lambda robots, _: dict.fromkeys(robots))
    file = case_runs.case_file(tmp_path, case)
    file.parent.mkdir()
    file.write_text('{"named": []}')
    assert run_cases([case], tmp_path) == 0
    assert case_results(tmp_path) == {file.stem: {"named": []}}


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help(command, capsys):
    with pytest.raises(SystemExit) as end:
        main([command, "--help"])
    assert end.value.code == 0
    assert f"models.gap.training {command}" in capsys.readouterr().out


def test_an_unknown_command_is_refused(capsys):
    assert main(["anything"]) == 2
    assert "own-error" in capsys.readouterr().out
