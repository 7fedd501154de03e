"""Cases for tuning: usual and faint effects, each of another name, and no rig for testing."""

import pytest

from models.gap.training.cases import TYPICAL, hidden_cases
from models.gap.training.tuning_cases import main

COUNTS = {"usual": 12, "faint": 10, "nulls": 2, "pairs": 2, "outside": 3}


def test_faint_effects_are_fainter_than_usual_ones_and_each_is_of_another_name():
    cases = list(hidden_cases("drawn_1", **COUNTS, seed=3, same_link=False))
    singles = [c for c in cases if c.kind == "single" and "current_saturation" not in c.hidden]
    names = [e for c in singles for e in c.hidden]
    sizes = [abs(v) / TYPICAL[e] for c in singles for e, v in c.hidden.items()]
    usual = sum(0.5 <= s <= 2.0 for s in sizes)
    assert len(names) == len(set(names)) and len(cases) == sum(COUNTS.values())
    assert all(0.2 <= s <= 2.0 for s in sizes) and usual >= COUNTS["usual"] - 1
    assert min(sizes) < 0.5


def test_the_own_link_changes_in_no_case():
    assert not any(c.nuisance for c in hidden_cases("drawn_1", **COUNTS, seed=3, same_link=True))


def test_two_joints_may_hide_the_coupling_of_their_planes():
    drawn = [hidden_cases("drawn_1", 26, 0, 0, 0, 0, s, True, joints=2) for s in range(2)]
    cases = [case for own in drawn for case in own]
    assert {case.joints for case in cases} == {2}
    assert any("cross_axis_coupling" in case.hidden for case in cases)
    assert all(
        case.joints == 1 for case in hidden_cases("drawn_1", **COUNTS, seed=3, same_link=True)
    )


def test_cases_may_be_drawn_from_some_effects_alone():
    cases = hidden_cases(
        "drawn_1", **COUNTS | {"pairs": 0}, seed=3, same_link=True, effects=["creep"]
    )
    hidden = [tuple(c.hidden) for c in cases]
    assert set(hidden) == {("creep",), ()} and hidden.count(()) == COUNTS["nulls"]


def test_a_rig_for_tests_is_refused(monkeypatch, capsys, tmp_path):
    given = ["tuning_cases", "--rigs", "drawn_901", "--out", str(tmp_path / "out")]
    monkeypatch.setattr("sys.argv", given)
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2 and "drawn_901 is for testing" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
