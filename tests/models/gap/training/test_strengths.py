"""Error of the equations: what strengths are off by beyond chance is found, and chance is not."""

import msgspec
import numpy as np
import pytest

from models.gap.equation_error import EquationError, read_equation_error
from models.gap.training import strengths
from models.gap.training.strengths import (
    FoundStrength,
    deviations_left_out,
    fitted_error,
    found_strengths,
)

IN_USE = strengths.TABLE


def drawn(effect, equation, chance, count, seed=0):
    """Found strengths with an error of the equation and one by chance, as fractions."""
    rng = np.random.default_rng(seed)
    return [
        FoundStrength(
            rig=f"drawn_{k % 9}", effect=effect, found=1.0,
            hidden=1.0 + equation * rng.standard_normal() + chance * rng.standard_normal(),
            chance_error=chance,
        )
        for k in range(count)
    ]  # fmt: skip


@pytest.mark.parametrize("equation", [0.05, 0.2])
def test_the_error_beyond_chance_is_found_with_some_for_tails(equation):
    error = fitted_error(drawn("creep", equation, equation / 3, 2000), 0.5)
    assert equation < error.fraction("creep") < 1.5 * equation


def test_what_chance_explains_is_no_error_of_the_equation():
    error = fitted_error(drawn("creep", 0.0, 0.1, 2000), 0.5)
    assert error.fraction("creep") < 0.03


def test_few_strengths_of_an_effect_are_drawn_towards_its_port_and_none_are_the_port():
    rows = [*drawn("creep", 0.3, 0.05, 200), *drawn("hysteresis", 0.0, 0.05, 2)]
    error = fitted_error(rows, 0.5)
    assert 0.15 < error.fraction("hysteresis") < error.fraction("creep")
    assert error.fraction("prebend") == error.port["bend_torque"]
    assert error.fraction("backlash") == error.general


@pytest.mark.parametrize("seed", range(5))
def test_intervals_of_rigs_left_out_hold_what_they_say(seed):
    found = deviations_left_out(drawn("backlash", 0.15, 0.1, 360, seed), 0.5)
    assert 0.93 < np.mean([d.inside for d in found]) < 0.995


def result(rig="drawn_1", kind="single", named=("creep",)):
    return {
        "case": {"kind": kind, "rig": rig, "hidden": {"creep": 0.3}},
        "true": {"creep": 0.3},
        "estimates": {effect: [[0.5, 0.05, 0.1]] for effect in named},
        "equation_error": dict.fromkeys(named, 0.1),
    }


def test_strengths_are_changes_and_their_chance_is_told_from_the_equation():
    (row,) = found_strengths([result(), result(named=("backlash",)), result(kind="outside")])
    assert (row.found, row.hidden) == (pytest.approx(0.4), 0.3)
    assert row.chance_error == pytest.approx(0.03)


@pytest.fixture
def files(monkeypatch, tmp_path):
    """Files that the command writes, in place of the project's."""
    monkeypatch.setattr(strengths, "PATH", tmp_path / "equation_error.json")
    monkeypatch.setattr(strengths, "TABLE", tmp_path / "strengths.jsonl")
    (tmp_path / "strengths.jsonl").touch()
    return tmp_path


def test_rigs_for_tests_are_refused_and_nothing_is_written(monkeypatch, files, capsys):
    monkeypatch.setattr(strengths, "case_results", lambda run: {"a": result("drawn_900")})
    monkeypatch.setattr("sys.argv", ["strengths", "run"])
    with pytest.raises(SystemExit):
        strengths.main()
    assert "drawn_900 is for testing" in capsys.readouterr().err
    assert not (files / "equation_error.json").exists()
    assert not (files / "strengths.jsonl").read_bytes()


def test_the_errors_in_use_are_those_of_the_table(monkeypatch, files):
    (files / "strengths.jsonl").write_bytes(IN_USE.read_bytes())
    monkeypatch.setattr("sys.argv", ["strengths"])
    strengths.main()
    written = (files / "equation_error.json").read_bytes()
    assert msgspec.json.decode(written, type=EquationError) == read_equation_error()


def test_strengths_are_added_to_those_that_are_known_and_replace_the_same(monkeypatch, files):
    for rigs in (("drawn_1", "drawn_2"), ("drawn_2", "drawn_3")):
        found = {rig: result(rig) for rig in rigs}
        monkeypatch.setattr(strengths, "case_results", lambda run, found=found: found)
        monkeypatch.setattr("sys.argv", ["strengths", "run"])
        strengths.main()
    rows = msgspec.json.Decoder(FoundStrength).decode_lines(
        (files / "strengths.jsonl").read_bytes()
    )
    assert [row.rig for row in rows] == ["drawn_1", "drawn_2", "drawn_3"]
