"""The peer beside the benchmark: its equations, its noise, what it names and what it lacks."""

import importlib
import json
import sys
from dataclasses import replace

import numpy as np
import pytest

from bench.gap import peer
from bench.gap.library import Equation, missing_in_equations
from bench.gap.scores import score_summary
from bench.gap.scores.score_summary import peer_comparison
from firmware_py.errors import InputError
from firmware_py.motion import Motion
from firmware_py.signals import PERIOD_S
from models.gap.residuals.fit_parameters import FitParameter
from models.plant.plant import read_plant
from models.plant.simulation.compiled_model import CompiledModel
from models.trials.trial import Trial, TrialMeta

REST_ROWS = 60
HIDDEN = {
    "dead_time": ("command", "dead_time_1_s", 0.03),
    "position_gain_change": ("command", "position_gain_change_1", 0.1),
    "load_offset": ("torque", "load_offset_1_nm", 3.0),
}


@pytest.fixture(scope="module")
def units():
    plant = read_plant().with_effects(*HIDDEN)
    return {unit: CompiledModel(plant.step_model(1, unit)) for unit in ("twin", "driven")}


@pytest.fixture(scope="module")
def trial():
    motion = Motion(period_s=2.6)
    goal = motion.table_rad(rest_samples=REST_ROWS)[:, 0]
    meta = TrialMeta(
        dof=1, payload_kg=1.0, pressure_pa=41300.0, trial=1, motion="sinusoid", source="test",
        period_s=motion.period_s, amplitude_rad=motion.amplitude_rad, base_offset_m=0.06,
        link_length_m=0.95, link_width_m=0.15, rest_samples=REST_ROWS,
    )  # fmt: skip
    return Trial("made", meta, {"time_s": PERIOD_S * np.arange(len(goal)), "goal_1_rad": goal})


@pytest.mark.parametrize("effect", HIDDEN)
def test_an_equation_misses_what_was_hidden_in_it(units, trial, effect):
    name, parameter, strength = HIDDEN[effect]
    hidden = [(FitParameter(effect, "effect", {parameter: 1.0}), strength)]
    measured, p = peer.simulated_signals(units["twin"], trial, hidden)
    seen = replace(trial, columns={**trial.columns, **measured})
    loop, _ = peer.simulated_signals(units["twin"], seen, [])
    link, _ = peer.simulated_signals(units["driven"], seen, [])
    twin, driven = ({s: measured[s] - y[s] for s in y} for y in (loop, link))
    found = missing_in_equations(seen, p, twin, driven)[name]
    column, missing = found.columns[effect][found.counts], found.missing[found.counts]
    estimate = column @ missing / (column @ column)
    assert abs(abs(estimate) / strength - 1) < 0.15
    assert np.mean((missing - estimate * column) ** 2) < 0.1 * np.mean(missing**2)


def made(rng, gain):
    """Four repetitions of one equation: noise of size one, and `gain` times a term."""
    drawn = {name: rng.standard_normal(400) for name in ("coulomb_friction", "load_offset")}
    counts = np.ones(400, bool)
    return [
        {"torque": Equation(gain * drawn["load_offset"] + rng.standard_normal(400), drawn, counts)}
        for _ in range(4)
    ]


def test_noise_is_what_differs_between_repetitions_of_one_payload(rng):
    rows = [t["torque"] for t in made(rng, 20.0)]
    assert peer.repetition_noise(rows, [0.0, 0.0, 1.0, 1.0]) == pytest.approx(1.0, rel=0.2)


def test_the_term_that_contributes_most_is_named_and_noise_is_not(rng):
    pytest.importorskip("pysindy")
    assert list(peer.contributions(made(rng, 20.0), [0.0] * 4)) == ["load_offset"]
    assert not peer.contributions(made(rng, 0.0), [0.0] * 4)


def test_without_the_package_one_sentence_says_how_to_get_it(monkeypatch, capsys, tmp_path):
    def missing(name):
        raise ModuleNotFoundError(name)

    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(InputError):
        peer.import_pysindy()
    monkeypatch.setattr(
        sys, "argv", ["peer", "--plant", str(tmp_path / "plant.json"), "--out", str(tmp_path)]
    )
    assert peer.main() == 2
    said = capsys.readouterr().err
    assert "pip install pysindy" in said and said.count("\n") == 1


def test_both_are_counted_on_the_cases_that_both_have(tmp_path, monkeypatch):
    def result(kind, hidden, named):
        verdict = "reduced" if named else "no gap"
        return {"case": {"kind": kind, "hidden": hidden}, "named": named, "verdict": verdict}

    own = {"e": result("null", {}, ["creep"])}  # the peer has not come to it yet
    (tmp_path / "peer").mkdir()

    single, pair = {"creep": 0.3}, {"creep": 0.3, "backlash": 0.01}
    for name, kind, hidden, ours, peers in (
        ("a", "single", single, ["creep"], ["backlash", "creep"]),
        ("b", "single", single, ["creep"], []),
        ("c", "pair", pair, ["creep"], ["backlash", "creep", "prebend"]),
        ("d", "null", {}, [], ["creep"]),
    ):
        own[name] = result(kind, hidden, ours)
        (tmp_path / "peer" / f"{name}.json").write_text(json.dumps(result(kind, hidden, peers)))
    monkeypatch.setattr(score_summary, "bench_results", lambda directory: own)
    figures = peer_comparison(tmp_path)
    counted = {
        who: [round(f["fraction"] * f["of"]) for f in rows.values()]
        for who, rows in figures.items()
    }
    assert counted == {"pysindy": [0, 0, 1, 1], "ours": [2, 2, 0, 0]}
    assert figures["pysindy"]["top_1_detected"]["of"] == 1


@pytest.fixture
def rng():
    return np.random.default_rng(7)
